"""Parts: a folder's pictures made small, with their snaps, in one file.

Each picture is resized once, to the largest scale that training asks for.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from augment import jpeg
from data import read_coco, scaled

SNAPS = 8  # of one picture, at most; a picture with more is left out
# Training's scale varies about the network's by this factor.
JITTER = 1.25


@dataclass
class Part:
    """Small pictures of a folder, packed."""

    pixels: np.ndarray  # [sum of h * w, 3], uint8
    sizes: np.ndarray  # [P, 2], height and width
    scales: np.ndarray  # [P], pixels a millimetre
    snaps: np.ndarray  # [P, SNAPS, 7]: box, label (0: none), yaw in radians or NaN, whole

    def save(self, file: Path) -> None:
        part = file.with_suffix(".part")
        with open(part, "wb") as out:
            np.savez(out, **{name: getattr(self, name) for name in Part.__dataclass_fields__})
        part.rename(file)

    @staticmethod
    def load(file: Path) -> "Part":
        with np.load(file) as saved:
            return Part(*(saved[name] for name in Part.__dataclass_fields__))


def pack(folder: Path, pixels_per_mm: float, seed: int) -> Part:
    """A COCO folder's pictures at the largest scale that training asks for, some of them through JPEG."""
    rng = np.random.default_rng(seed)
    pixels, sizes, scales, snaps = [], [], [], []
    for entry in read_coco(folder):
        factor = min(1.0, pixels_per_mm * JITTER * entry.mm_per_pixel)
        h, w = (scaled(side, factor) for side in entry.size)
        ratio = np.array([w / entry.size[1], h / entry.size[0]] * 2, np.float32)
        boxes = (entry.snaps.boxes * ratio).clip(0, [w, h, w, h])
        wide = (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf) >= 2
        if wide.sum() > SNAPS:
            continue
        small = Image.fromarray(entry.pixels()).resize((w, h), Image.Resampling.BILINEAR)
        table = np.zeros((SNAPS, 7), np.float32)
        found = np.column_stack([boxes, entry.snaps.labels, entry.snaps.yaw, entry.snaps.whole])[wide]
        table[: len(found)] = found
        pixels.append(jpeg(np.asarray(small), rng).reshape(-1, 3))
        sizes.append((h, w))
        scales.append(factor / entry.mm_per_pixel)
        snaps.append(table)
    if not pixels:
        raise SystemExit(f"{folder}: expected pictures with at most {SNAPS} snaps, got none")
    return Part(np.concatenate(pixels), np.array(sizes), np.array(scales, np.float32), np.stack(snaps))


def cached(folder: Path, pixels_per_mm: float, cache: Path) -> Part:
    """A folder's part, kept in `cache` and made anew when its pictures or labels are others."""
    key = content_key(folder, pixels_per_mm)
    file = cache / f"{folder.name}-{key}.npz"
    if not file.exists():
        cache.mkdir(parents=True, exist_ok=True)
        pack(folder, pixels_per_mm, int(key, 16)).save(file)
    return Part.load(file)


def content_key(folder: Path, pixels_per_mm: float) -> str:
    """A digest of what a part is made from: the scale, the labels, and the bytes of each picture in their order."""
    whole = hashlib.blake2b(f"{pixels_per_mm}".encode(), digest_size=8)
    for file in (folder / "annotations.json", *(entry.path for entry in read_coco(folder))):
        with open(file, "rb") as opened:
            whole.update(hashlib.file_digest(opened, "blake2b").digest())
    return whole.hexdigest()
