"""Pictures with their snaps as arrays, read by the program's rules."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from .errors import Failure
from .labels import Folder, Picture

FORMATS = ("PNG", "JPEG", "BMP", "TIFF")
DEPTHS = {"I;16", "I;16L", "I;16B", "I;16N"}


def from_16(values: np.ndarray) -> np.ndarray:
    """Values of 16 bits in 8, rounded."""
    return ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)


def read_picture(path: Path) -> np.ndarray:
    """[H, W, 3] in uint8, upright by its EXIF data; grey is repeated, transparency left out. Raises `Failure`."""
    try:
        data = path.read_bytes()
        if data[:4] == b"\x89PNG" and data[24:25] == b"\x10":
            return _deep_png(data)
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            if image.mode in DEPTHS:
                grey = from_16(np.asarray(ImageOps.exif_transpose(image)))
                return np.repeat(grey[:, :, None], 3, axis=2)
            deep = image.format == "TIFF" and max(np.atleast_1d(image.tag_v2.get(258, 8))) > 8  # type: ignore[attr-defined]
            if deep or image.mode in ("I", "F"):
                raise Failure(f"{path}: expected 8 bits a channel, or 16 in a PNG or a grey TIFF, got {image.format} of {image.mode}")
            return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except (OSError, ValueError, RuntimeError, SyntaxError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise Failure(f"{path}: expected a PNG, JPEG, BMP or TIFF, got {type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'nothing'}") from None


def _deep_png(data: bytes) -> np.ndarray:
    """A PNG of 16 bits a channel, of which Pillow keeps the upper 8 unrounded."""
    import torch
    from torchvision.io import ImageReadMode, decode_png

    read = decode_png(torch.frombuffer(bytearray(data), dtype=torch.uint8), ImageReadMode.UNCHANGED, apply_exif_orientation=True)
    pixels = from_16(read.numpy()).transpose(1, 2, 0)
    return np.ascontiguousarray(pixels[:, :, :3] if pixels.shape[2] >= 3 else pixels[:, :, :1].repeat(3, axis=2))


@dataclass
class Snaps:
    """The snaps of one picture."""

    boxes: np.ndarray  # [K, 4], x1 y1 x2 y2
    labels: np.ndarray  # [K], a class's number, from 1
    yaw: np.ndarray  # [K], radians as in pose.py, NaN where there is no direction
    whole: np.ndarray  # [K], not cut by the picture's edge


@dataclass
class Entry:
    """One picture of a folder; all but `frame` is of what the network sees of it, boxes too."""

    path: Path
    frame: tuple[int, int]  # height, width
    corner: tuple[int, int]  # x, y of the gel
    size: tuple[int, int]  # height, width
    mm_per_pixel: float
    conditions: dict[str, Any]
    snaps: Snaps

    def pixels(self) -> np.ndarray:
        """[H, W, 3] of the gel, in uint8."""
        picture = read_picture(self.path)
        if picture.shape[:2] != self.frame:
            raise Failure(f"{self.path}: expected {self.frame} pixels (height, width) as labelled, got {picture.shape[:2]}")
        (x, y), (height, width) = self.corner, self.size
        return picture[y : y + height, x : x + width]


def entries(folder: Folder, classes: Sequence[str], directed: Sequence[str]) -> list[Entry]:
    """A folder's pictures in its order; its labels are of these classes."""
    return [entry(picture, classes, directed) for picture in folder.pictures]


def entry(picture: Picture, classes: Sequence[str], directed: Sequence[str]) -> Entry:
    number = {name.lower(): i for i, name in enumerate(classes, start=1)}
    left, top, width, height = picture.part
    boxes = np.array([label.box for label in picture.labels], np.float32).reshape(-1, 4)
    boxes = (boxes - [left, top] * 2).clip(0, [width, height] * 2).astype(np.float32)
    labels = np.array([number[label.category.lower()] for label in picture.labels], np.int64)
    degrees = [label.yaw if classes[c - 1] in directed else None for label, c in zip(picture.labels, labels)]
    yaw = np.radians(np.array([math.nan if d is None else d for d in degrees], np.float32))
    # Where nobody says so, a box at the edge belongs to a cut part.
    from_edge = np.minimum(boxes, np.array([width, height] * 2) - boxes).min(axis=1, initial=math.inf)
    whole = np.array([edge > 1 if label.whole is None else label.whole for label, edge in zip(picture.labels, from_edge)], np.bool_)
    keep = (boxes[:, 2:] > boxes[:, :2]).all(axis=1)
    snaps = Snaps(boxes[keep], labels[keep], yaw[keep], whole[keep])
    return Entry(picture.path, picture.frame[::-1], (left, top), (height, width), picture.mm_per_pixel, picture.conditions, snaps)
