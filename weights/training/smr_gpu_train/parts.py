"""Parts: a folder's pictures made small, with their snaps, in one file.

Each picture is resized once, to the largest scale that training asks for.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from .augment import jpeg
from .data import scaled
from .files import whole
from .labels import Folder
from .pictures import Entry, entries

SNAPS = 8  # rows of one picture, or more where some picture has more
NARROWEST = 2  # pixels of a small picture: what is narrower teaches nothing
# Training's scale varies about the network's by this factor.
JITTER = 1.25


@dataclass
class Part:
    """Small pictures of a folder, packed."""

    pixels: np.ndarray  # [sum of h * w, 3], uint8
    sizes: np.ndarray  # [P, 2], height and width
    scales: np.ndarray  # [P], pixels a millimetre
    snaps: np.ndarray  # [P, at least SNAPS, 7]: box, label (0: none), yaw in radians or NaN, whole

    def save(self, file: Path) -> None:
        with whole(file) as part, open(part, "wb") as out:
            np.savez(out, **{name: getattr(self, name) for name in Part.__dataclass_fields__})

    @staticmethod
    def load(file: Path) -> "Part":
        with np.load(file) as saved:
            return Part(*(saved[name] for name in Part.__dataclass_fields__))


def pack(pictures: list[Entry], pixels_per_mm: float, seed: int) -> Part:
    """Pictures at the largest scale that training asks for, some of them through JPEG."""
    rng = np.random.default_rng(seed)
    pixels, sizes, scales, tables = [], [], [], []
    rows = max([SNAPS, *(len(entry.snaps.labels) for entry in pictures)])
    for entry in pictures:
        factor = min(1.0, pixels_per_mm * JITTER * entry.mm_per_pixel)
        h, w = (scaled(side, factor) for side in entry.size)
        boxes = small_boxes(entry, factor)
        wide = is_wide(boxes)
        small = Image.fromarray(entry.pixels()).resize((w, h), Image.Resampling.BILINEAR)
        table = np.zeros((rows, 7), np.float32)
        found = np.column_stack([boxes, entry.snaps.labels, entry.snaps.yaw, entry.snaps.whole])[wide]
        table[: len(found)] = found
        pixels.append(jpeg(np.asarray(small), rng).reshape(-1, 3))
        sizes.append((h, w))
        scales.append(factor / entry.mm_per_pixel)
        tables.append(table)
    return Part(np.concatenate(pixels), np.array(sizes), np.array(scales, np.float32), np.stack(tables))


def small_boxes(entry: Entry, factor: float) -> np.ndarray:
    """The boxes of a picture that is made small, [K, 4]."""
    h, w = (scaled(side, factor) for side in entry.size)
    ratio = np.array([w / entry.size[1], h / entry.size[0]] * 2, np.float32)
    return (entry.snaps.boxes * ratio).clip(0, [w, h, w, h])


def is_wide(boxes: np.ndarray) -> np.ndarray:
    """Which boxes of a small picture there is something to learn from."""
    return (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf) >= NARROWEST


def narrow(pictures: list[Entry], pixels_per_mm: float) -> int:
    """How many boxes are too narrow."""
    return sum(int((~is_wide(small_boxes(e, min(1.0, pixels_per_mm * JITTER * e.mm_per_pixel)))).sum()) for e in pictures)


def cached(folder: Folder, classes: Sequence[str], directed: Sequence[str], pixels_per_mm: float, cache: Path) -> tuple[Part, str]:
    """A folder's part, kept in `cache` and made anew when its pictures or labels are others; and the key of its content."""
    pictures = entries(folder, classes, directed)
    key = content_key(pictures, pixels_per_mm, [*classes, "", *directed])
    file = cache / f"{folder.path.resolve().name}-{key}.npz"
    if not file.exists():
        pack(pictures, pixels_per_mm, int(key, 16)).save(file)
    return Part.load(file), key


def content_key(pictures: list[Entry], pixels_per_mm: float, names: list[str]) -> str:
    """A digest of what a part is made from: the scale, the classes, the labels and the bytes of each picture in their order."""
    whole = hashlib.blake2b(f"{pixels_per_mm} {names}".encode(), digest_size=8)
    for entry in pictures:
        whole.update(f"{entry.frame} {entry.corner} {entry.size} {entry.mm_per_pixel}".encode())
        for values in (entry.snaps.boxes, entry.snaps.labels, entry.snaps.yaw, entry.snaps.whole):
            whole.update(values.tobytes())
        with open(entry.path, "rb") as opened:
            whole.update(hashlib.file_digest(opened, "blake2b").digest())
    return whole.hexdigest()
