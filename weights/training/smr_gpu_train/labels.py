"""COCO folders: what they say is checked as a whole, and nothing is left out without a word. Needs the standard library alone.

A folder holds annotations.json and the pictures it names, beside it or in images/.
"""

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import Failure, counted, some
from .sensor import Rect, Sensor, Size, view

LABELS = "annotations.json"
MOST_CLASSES, LONGEST_NAME = 10, 64
MARGIN = 1.0  # pixels that a box may reach outside its picture, from rounding
ENDINGS = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}


@dataclass(frozen=True)
class Label:
    """A snap, as its annotation says."""

    category: str
    box: tuple[float, float, float, float]  # x1 y1 x2 y2, of the frame
    yaw: float | None  # degrees
    whole: bool | None


@dataclass(frozen=True)
class Picture:
    """A picture and its labels."""

    path: Path
    frame: Size
    part: Rect  # what the network sees
    mm_per_pixel: float
    conditions: dict[str, Any]
    labels: list[Label]


@dataclass
class Folder:
    """A folder that was found to be sound."""

    path: Path
    categories: list[str]
    pictures: list[Picture]
    remarks: list[str] = field(default_factory=list)


@dataclass
class Counts:
    """How much there is to learn from."""

    pictures: int
    bare: int  # without a snap
    snaps: dict[str, int]  # by class


@dataclass
class DataSet:
    """Folders, and what their labels are called."""

    folders: list[Folder]
    classes: list[str]
    directed: list[str]
    mix: list[Folder] = field(default_factory=list)  # further ones to learn from
    mix_share: float = 0.0  # of all views, that of `mix`
    held_out: list[Folder] = field(default_factory=list)  # nothing is learnt from these
    remarks: list[str] = field(default_factory=list)

    def counts(self, folders: list[Folder] | None = None) -> Counts:
        """Of these folders, or of all."""
        pictures = [picture for folder in (folders or self.folders + self.mix) for picture in folder.pictures]
        snaps = Counter(label.category.lower() for picture in pictures for label in picture.labels)
        return Counts(len(pictures), sum(not picture.labels for picture in pictures), {name: snaps[name.lower()] for name in self.classes})

    def summary(self) -> list[str]:
        """What there is to learn from, and what was left out or assumed, in lines."""
        lines = [self._line(self.folders)]
        if self.mix:
            lines.append(f"mixed in, {100 * self.mix_share:g} % of all views: {self._line(self.mix)}")
        return lines + self.remarks + [f"{folder.path}: {remark}" for folder in self.folders + self.mix for remark in folder.remarks]

    def _line(self, folders: list[Folder]) -> str:
        counts = self.counts(folders)
        snaps = ", ".join(f"{name} {count}" + (" (with a direction)" if name in self.directed else "") for name, count in counts.snaps.items())
        return f"{counted(counts.pictures, 'picture')}, {counts.bare} of them without a snap; {counted(sum(counts.snaps.values()), 'snap')}: {snaps}"


class Faults:
    """What is wrong with a file, by kind, each with what it is about."""

    def __init__(self) -> None:
        self.kinds: dict[str, list[str]] = {}

    def add(self, kind: str, about: str) -> None:
        self.kinds.setdefault(kind, []).append(about)

    def end(self, file: Path) -> None:
        """Raises what was found, in a line."""
        if self.kinds:
            raise Failure(f"{file}: " + "; ".join(f"{len(about)} {kind}: {some(about)}" for kind, about in self.kinds.items()))


def read_folders(option: str, paths: Sequence[Path], sensor: Sensor | None = None) -> list[Folder]:
    """The folders that an option names, each once.

    Raises `Failure` that names folders that are not there or hold no labels, else what is wrong in the first unsound one.
    """
    once: dict[Path, Path] = {}
    for path in paths:
        once.setdefault(path.resolve(), path)
    gone = [str(path) for path in once.values() if not path.is_dir()]
    if gone:
        raise Failure(f"{option}: expected folders, got {some(gone)}, which {'is' if len(gone) == 1 else 'are'} not there")
    bare = [str(path) for path in once.values() if not (path / LABELS).is_file()]
    if bare:
        raise Failure(f"{option}: expected folders with {LABELS} (COCO), got {some(bare)} without it")
    return [read_folder(path, sensor) for path in once.values()]


def read_folder(path: Path, sensor: Sensor | None = None) -> Folder:
    """A folder's pictures in the order of its file. Raises `Failure` with all that is wrong."""
    file = path / LABELS
    coco = _parsed(file)
    names = _categories(file, coco["categories"])
    faults, annotations = Faults(), _annotations(file, coco, names)
    pictures, assumed = [], Counter[tuple[Size, float]]()
    for image in coco["images"]:
        said = f"{image['file_name']}"
        size = _size(image)
        if size is None:
            faults.add("images without a width and a height above 0", said)
            continue
        place = picture_path(path, image["file_name"])
        if place is None:
            faults.add("pictures that are not there", said)
            continue
        gel = image.get("gel")
        try:
            window = Rect.read(gel)
            if gel is not None and window is None:
                raise ValueError(f"a gel of {gel}, expected x, y, width and height in pixels")
            mm = image.get("mm_per_pixel")
            seen = view(size, None if mm is None else float(mm), window, sensor)
        except (ValueError, TypeError) as error:
            faults.add("pictures whose scale or gel cannot be", f"{said} has {error}")
            continue
        except Failure as error:
            faults.add("pictures that are not the sensor's", f"{said} ({error})")
            continue
        if seen.assumed:
            assumed[size, seen.mm_per_pixel] += 1
        labels = annotations[image["id"]]
        for id_, label in labels:
            x1, y1, x2, y2 = label.box
            if x1 < -MARGIN or y1 < -MARGIN or x2 > size[0] + MARGIN or y2 > size[1] + MARGIN:
                faults.add("boxes outside their picture", f"{id_} ({x1:g}, {y1:g} to {x2:g}, {y2:g} in the {size[0]} x {size[1]} pixels of {said})")
        conditions = image.get("conditions")
        pictures.append(Picture(place, size, seen.part, seen.mm_per_pixel, conditions if isinstance(conditions, dict) else {}, [label for _, label in labels]))
    faults.end(file)
    folder = Folder(path, list(names.values()), pictures)
    for (size, mm), count in assumed.items():
        folder.remarks.append(f"{counted(count, 'picture')} of {size[0]} x {size[1]} pixels without a scale: {mm:.4f} mm a pixel assumed (mm_per_pixel in the labels or --sensor says it)")
    crowds = sum(bool(a.get("iscrowd")) for a in coco["annotations"])
    if crowds:
        folder.remarks.append(f"{counted(crowds, 'crowd')} left out")
    beside = sum(_outside(label.box, picture.part) for picture in pictures for label in picture.labels)
    if beside:
        folder.remarks.append(f"{counted(beside, 'box', 'boxes')} outside the gel left out")
    spare = _unlabelled(path, pictures)
    if spare:
        folder.remarks.append(f"{counted(len(spare), 'picture')} left out that {LABELS} does not name: {some(spare)}")
    return folder


def _parsed(file: Path) -> dict[str, list[dict[str, Any]]]:
    """COCO's three lists, of objects that have what they must."""
    try:
        coco = json.loads(file.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise Failure(f"{file}: expected COCO's JSON, got an error: {error}") from None
    wanted = {"images": ("id", "file_name"), "annotations": ("image_id", "category_id", "bbox"), "categories": ("id", "name")}
    faults = Faults()
    for name, keys in wanted.items():
        rows = coco.get(name) if isinstance(coco, dict) else None
        if not isinstance(rows, list):
            raise Failure(f"{file}: expected COCO's JSON with images, annotations and categories, got no list `{name}`")
        for i, row in enumerate(rows):
            lacks = [key for key in keys if not isinstance(row, dict) or row.get(key) is None]
            if lacks:
                faults.add(f"{name} without {', '.join(lacks)}", f"position {i}")
    faults.end(file)
    if not coco["images"]:
        raise Failure(f"{file}: expected at least one image, got none")
    for kind, key in (("images", "id"), ("images", "file_name"), ("categories", "id")):
        times = Counter(str(row[key]) for row in coco[kind])
        for each in (each for each, count in times.items() if count > 1):
            faults.add(f"{kind} that share their {key} with others", each)
    faults.end(file)
    return coco


def _categories(file: Path, rows: list[dict[str, Any]]) -> dict[int, str]:
    """Names by id."""
    faults = Faults()
    seen: dict[str, str] = {}
    for row in rows:
        name = row["name"]
        if not isinstance(name, str) or not name.strip():
            faults.add("categories without a name", f"id {row['id']}")
        elif len(name) > LONGEST_NAME:
            faults.add(f"categories with a name of more than {LONGEST_NAME} characters", name)
        elif name.lower() in seen:
            faults.add("categories of a name that another has, capitals apart", f"`{name}` and `{seen[name.lower()]}`")
        else:
            seen[name.lower()] = name
    faults.end(file)
    return {row["id"]: row["name"] for row in rows}


def _annotations(file: Path, coco: dict[str, list[dict[str, Any]]], names: dict[int, str]) -> dict[int, list[tuple[str, Label]]]:
    """Labels by the id of their image, each with its own id; without crowds."""
    found: dict[int, list[tuple[str, Label]]] = {image["id"]: [] for image in coco["images"]}
    faults = Faults()
    for i, row in enumerate(coco["annotations"]):
        said = f"annotation {row['id']}" if "id" in row else f"annotation at position {i}"
        if row["image_id"] not in found:
            faults.add("annotations of an image that is not there", f"{said} of image {row['image_id']}")
            continue
        if row["category_id"] not in names:
            faults.add("annotations of an unknown category", f"{said} of category {row['category_id']}")
            continue
        box = _box(row["bbox"])
        if box is None:
            faults.add("annotations without a bbox of finite numbers with width and height above 0", f"{said} with {row['bbox']}")
            continue
        yaw = row.get("yaw_deg")
        if yaw is not None and not _is_number(yaw):
            faults.add("annotations with a yaw_deg that is no number", f"{said} with {yaw}")
            continue
        if not row.get("iscrowd"):
            whole = row.get("whole")
            found[row["image_id"]].append((said, Label(names[row["category_id"]], box, yaw, None if whole is None else bool(whole))))
    faults.end(file)
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _box(bbox: Any) -> tuple[float, float, float, float] | None:
    if not isinstance(bbox, list) or len(bbox) != 4 or not all(map(_is_number, bbox)):
        return None
    x, y, width, height = bbox
    return (x, y, x + width, y + height) if width > 0 and height > 0 else None


def _size(image: dict[str, Any]) -> Size | None:
    width, height = (image.get(side, 0) for side in ("width", "height"))
    fits = _is_number(width) and _is_number(height) and min(width, height) >= 1
    return (int(width), int(height)) if fits else None


def _outside(box: tuple[float, float, float, float], part: Rect) -> bool:
    x1, y1, x2, y2 = box
    return x2 <= part.x or y2 <= part.y or x1 >= part.x + part.width or y1 >= part.y + part.height


def picture_path(folder: Path, name: str) -> Path | None:
    """A COCO file name is relative to the folder or to its images/; backslashes separate folders where no file has them in its name."""
    names = (name, name.replace("\\", "/"))
    places = (place / each for each in names for place in (folder, folder / "images"))
    return next((place for place in places if place.is_file()), None)


def _unlabelled(folder: Path, pictures: Iterable[Picture]) -> list[str]:
    """Pictures beside the labelled ones that no label names."""
    named = {picture.path.resolve() for picture in pictures}
    places = {picture.path.parent for picture in pictures}
    there = (file for place in sorted(places) for file in sorted(place.iterdir()) if file.suffix.lower() in ENDINGS)
    return [str(file.relative_to(folder)) for file in there if file.resolve() not in named]


def data_set(folders: list[Folder], classes: Sequence[str] | None = None, directed: Sequence[str] | None = None) -> DataSet:
    """Of these folders, with the classes in this order, or those of the labels in theirs.

    A class has a direction if `directed` names it, or, where nothing does, if any of its labels has a yaw.
    Raises `Failure` for labels of other classes, for classes that no label has, and for what a weight file cannot hold.
    """
    labels = [(folder, label) for folder in folders for picture in folder.pictures for label in picture.labels]
    counts = Counter(label.category.lower() for _, label in labels)
    if classes is None:
        order: dict[str, str] = {}
        for name in (name for folder in folders for name in folder.categories):
            order.setdefault(name.lower(), name)
        classes = [*order.values()]
        whence = "the labels' categories"
    else:
        whence = "--classes"
    check_classes(whence, classes)
    check_labelled(folders, classes)
    unseen = [name for name in classes if not counts[name.lower()]]
    if unseen:
        raise Failure(f"{whence}: expected snaps of every class, got none of {some(unseen)}" + ("; name the classes that there are by --classes" if whence != "--classes" and len(unseen) < len(classes) else ""))
    if directed is None:
        turned = {label.category.lower() for _, label in labels if label.yaw is not None}
        with_direction = [name for name in classes if name.lower() in turned]
    else:
        with_direction = [name for name in classes if name.lower() in {d.lower() for d in directed}]
        strange = [name for name in directed if name.lower() not in {c.lower() for c in classes}]
        if strange:
            raise Failure(f"--directed: expected some of {', '.join(classes)}, got {some(strange)}")
        without = [name for name in with_direction if not any(label.yaw is not None for _, label in labels if label.category.lower() == name.lower())]
        if without:
            raise Failure(f"--directed: expected labels with a yaw_deg, got none of {some(without)}")
    return DataSet(folders, [*classes], with_direction)


def check_classes(whence: str, classes: Sequence[str]) -> None:
    """Raises `Failure` for classes that no weight file can have."""
    if not 1 <= len(classes) <= MOST_CLASSES:
        raise Failure(f"{whence}: expected 1 to {MOST_CLASSES} classes, got {len(classes)}" + (f": {', '.join(classes)}" if classes else ""))
    unfit = [name for name in classes if not name.strip() or len(name) > LONGEST_NAME]
    if unfit:
        raise Failure(f"{whence}: expected names of 1 to {LONGEST_NAME} characters, got {', '.join(map(repr, unfit))}")
    times = Counter(name.lower() for name in classes)
    twice = [name for name in classes if times[name.lower()] > 1]
    if twice:
        raise Failure(f"{whence}: expected each class once, capitals apart, got {', '.join(twice)}")


def check_labelled(folders: Iterable[Folder], classes: Sequence[str]) -> None:
    """Raises `Failure` for labels whose category is none of these classes, whatever its capitals."""
    known = {name.lower() for name in classes}
    for folder in folders:
        other = Counter(label.category for picture in folder.pictures for label in picture.labels if label.category.lower() not in known)
        if other:
            names = ", ".join(f"`{name}` ({counted(count, 'snap')})" for name, count in other.items())
            raise Failure(f"{folder.path / LABELS}: expected labels of {', '.join(classes)}, got {names}")
