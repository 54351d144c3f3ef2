"""Which labelled pictures are held out, by their bytes: OUT/split.json. Needs the standard library alone.

Of pictures in the order of their classes, and within these of a digest of their bytes, every so-manieth is held out: each
class alike, whatever files are called, and pictures of the same bytes together.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from .errors import Failure, counted, some
from .files import whole
from .labels import Folder, Picture

FILE = "split.json"
FEW = 5  # pictures, of which none needs to be held out


def digest(picture: Picture) -> str:
    """Of the file's bytes."""
    with open(picture.path, "rb") as opened:
        return hashlib.file_digest(opened, "blake2b").hexdigest()[:32]


def hold_out(folders: Sequence[Folder], share: float) -> tuple[list[Folder], list[Folder], list[str]]:
    """What is left to learn from, what is held out, and remarks. The last picture of a class is never held out."""
    keys = {picture.path: digest(picture) for folder in folders for picture in folder.pictures}
    shown: dict[str, set[str]] = {}
    for picture in (picture for folder in folders for picture in folder.pictures):
        shown.setdefault(keys[picture.path], set()).update(label.category.lower() for label in picture.labels)
    order = sorted(shown, key=lambda key: (sorted(shown[key]), key))
    count = min(len(order) - 1, max(round(share * len(order)), len(order) >= FEW))
    left, held = Counter(name for names in shown.values() for name in names), set[str]()
    for key in (order[int((i + 0.5) * len(order) / count)] for i in range(count)):
        if all(left[name] > 1 for name in shown[key]):
            left.subtract(shown[key])
            held.add(key)
    kept, away = (
        [part for folder in folders if (part := replace(folder, pictures=[p for p in folder.pictures if (keys[p.path] in held) == out])).pictures] for out in (False, True)
    )
    seen = {name for key in held for name in shown[key]}
    unseen = sorted({name.lower(): name for folder in folders for name in folder.categories if left[name.lower()] and name.lower() not in seen}.values())
    pictures, out = (sum(len(folder.pictures) for folder in side) for side in (folders, away))
    remarks = [f"{out} of {counted(pictures, 'picture')} held out"]
    if unseen:
        remarks.append(f"no picture of {', '.join(unseen)} is held out: too few show it")
    return kept, away, remarks


def save(out: Path, share: float, held: Sequence[Folder]) -> None:
    """Lists what is held out, in OUT/split.json."""
    files = [{"file": str(picture.path), "blake2b": digest(picture)} for folder in held for picture in folder.pictures]
    with whole(out / FILE) as part:
        part.write_text(json.dumps({"share": share, "held_out": files}, indent=1) + "\n", encoding="utf-8")


def held_out(option: str, file: Path, folders: Sequence[Folder]) -> list[Folder]:
    """What of these folders a split has held out, wherever it lies now. Raises `Failure` where some of it is not among them."""
    try:
        rows = json.loads(file.read_text(encoding="utf-8"))["held_out"]
        wanted = {row["blake2b"]: row["file"] for row in rows}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise Failure(f"--split: {file}: expected the {FILE} of a run, got {type(error).__name__}") from None
    found = [(picture, digest(picture)) for folder in folders for picture in folder.pictures]
    missing = [wanted[key] for key in wanted.keys() - {key for _, key in found}]
    if not wanted:
        raise Failure(f"--split: {file} lists no picture that is held out")
    if missing:
        raise Failure(f"--split: expected {option} to have the {counted(len(wanted), 'picture')} that {file} lists, got none like {some(sorted(missing))}")
    own = {picture.path for picture, key in found if key in wanted}
    parts = [replace(folder, pictures=[picture for picture in folder.pictures if picture.path in own]) for folder in folders]
    return [part for part in parts if part.pictures]
