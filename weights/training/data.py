"""COCO folders, frames of any size and scale, and pictures as the network reads them.

A folder holds annotations.json and the pictures it names.
"""

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

CLASSES = ("A", "B")
DIRECTED = ("A",)
PAPER_MM = 40.0  # along the gel's shorter side, of a picture whose label says nothing


def resize(pixels: Tensor, size: tuple[int, int]) -> Tensor:
    """[3, H, W] to [3, *size], bilinear with antialiasing (a triangle filter as wide as the scale, as Pillow's), without rounding."""
    return F.interpolate(pixels[None], size, mode="bilinear", antialias=True, align_corners=False)[0]


def read_picture(path: Path) -> np.ndarray:
    """[H, W, 3] in uint8."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def resize_square(pixels: np.ndarray, size: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, float, tuple[int, int]]:
    """The square centre crop resized to [3, size, size] (0 to 255), picture pixels a pixel, and the crop's corner."""
    height, width = pixels.shape[:2]
    side = min(height, width)
    left, top = (width - side) // 2, (height - side) // 2
    square = torch.from_numpy(pixels[top : top + side, left : left + side].copy()).permute(2, 0, 1).to(dtype)
    return resize(square, (size, size)), side / size, (left, top)


def scaled(side: int, scale: float) -> int:
    """A side's length in pixels after resizing."""
    return max(1, round(side * scale))


def whole_tiles(side: int) -> int:
    """Up to the next multiple of 32."""
    return -(-side // 32) * 32


def network_input(pixels: np.ndarray, scale: float) -> tuple[Tensor, tuple[float, float]]:
    """A frame [H, W, 3] as the network reads it, [3, h, w] (0 to 255), and frame pixels a pixel along x and y.

    Resized by `scale` to whole pixels, then its right and lower edges repeated up to multiples of 32.
    """
    height, width = pixels.shape[:2]
    h, w = scaled(height, scale), scaled(width, scale)
    picture = resize(torch.from_numpy(pixels.copy()).permute(2, 0, 1).float(), (h, w))
    pad = (0, whole_tiles(w) - w, 0, whole_tiles(h) - h)
    return F.pad(picture[None], pad, mode="replicate")[0], (width / w, height / h)


def normalise(pixels: Tensor, mean: list[float], std: list[float]) -> Tensor:
    """0 to 255 to the network's input; [.., 3, H, W]."""
    mean, std = (torch.tensor(v, dtype=pixels.dtype, device=pixels.device).view(3, 1, 1) for v in (mean, std))
    return (pixels / 255 - mean) / std


@dataclass
class Snaps:
    """The snaps of one picture."""

    boxes: np.ndarray  # [K, 4], x1 y1 x2 y2
    labels: np.ndarray  # [K], A is 1 and B is 2
    yaw: np.ndarray  # [K], radians as in pose.py, NaN where there is no direction
    whole: np.ndarray  # [K], not cut by the picture's edge


@dataclass
class Entry:
    """One picture of a folder; all but `frame` is of its gel alone, boxes too."""

    path: Path
    frame: tuple[int, int]  # height, width
    corner: tuple[int, int]  # x, y of the gel
    size: tuple[int, int]  # height, width
    mm_per_pixel: float
    conditions: dict
    snaps: Snaps

    def pixels(self) -> np.ndarray:
        """[H, W, 3] of the gel, in uint8."""
        picture = read_picture(self.path)
        if picture.shape[:2] != self.frame:
            raise SystemExit(f"{self.path}: expected {self.frame} pixels (height, width), got {picture.shape[:2]}")
        (x, y), (height, width) = self.corner, self.size
        return picture[y : y + height, x : x + width]


def stated(image: dict, sizes: set[tuple[int, int]]) -> tuple[float, list[int]]:
    """A picture's millimetres a pixel and its gel (x, y, width, height), by the program's rules; what is assumed is said once a size."""
    size = width, height = image["width"], image["height"]
    mm = image.get("mm_per_pixel")
    times = height / 1200
    papers = abs(width - 1920 * times) <= 0.01 * width and (mm is None or abs(mm * times / 0.04 - 1) <= 0.25)
    gel = [0, 0, *size]
    if image.get("gel"):
        gel = [image["gel"][side] for side in ("x", "y", "width", "height")]
    elif papers:  # the middle square of the paper's frame
        left, top, right, bottom = (round(edge * times) for edge in (460, 100, 1460, 1100))
        gel = [left, top, right - left, bottom - top]
    if mm is None:
        mm = PAPER_MM / min(gel[2:])
        if size not in sizes:
            print(f"{image['file_name']}: no mm_per_pixel in its label, {mm:.4f} assumed for {size[0]} x {size[1]} pixels", file=sys.stderr)
            sizes.add(size)
    return mm, gel


def read_coco(folder: Path) -> list[Entry]:
    """A folder's pictures in the order of its file."""
    coco = json.loads((folder / "annotations.json").read_text(encoding="utf-8-sig"))
    label = {c["id"]: CLASSES.index(c["name"].upper()) + 1 for c in coco["categories"] if c["name"].upper() in CLASSES}
    found: dict[int, list] = {image["id"]: [] for image in coco["images"]}
    for annotation in coco["annotations"]:
        if annotation["category_id"] in label and not annotation.get("iscrowd", 0):
            found[annotation["image_id"]].append(annotation)
    entries, sizes = [], set()
    for image in coco["images"]:
        mm, (left, top, width, height) = stated(image, sizes)
        rows = found[image["id"]]
        boxes = np.array([r["bbox"] for r in rows], np.float32).reshape(-1, 4)
        boxes[:, 2:] += boxes[:, :2]
        boxes = (boxes - [left, top] * 2).clip(0, [width, height] * 2).astype(np.float32)
        labels = np.array([label[r["category_id"]] for r in rows], np.int64)
        degrees = [r.get("yaw_deg") if CLASSES[c - 1] in DIRECTED else None for r, c in zip(rows, labels)]
        yaw = np.radians(np.array([math.nan if d is None else d for d in degrees], np.float32))
        size, frame = (height, width), (image["height"], image["width"])
        # Old folders do not say; there a box at the edge belongs to a cut part.
        inside = (boxes > 1).all(axis=1) & (boxes < np.array([*size[::-1], *size[::-1]]) - 1).all(axis=1)
        whole = np.array([r.get("whole", bool(i)) for r, i in zip(rows, inside)], bool)
        path = picture_path(folder, image["file_name"])
        entries.append(Entry(path, frame, (left, top), size, mm, image.get("conditions") or {}, Snaps(boxes, labels, yaw, whole)))
    return entries


def picture_path(folder: Path, name: str) -> Path:
    """A COCO file name is relative to the folder or to its images/; backslashes separate folders where no file has them in its name."""
    names = (name, name.replace("\\", "/"))
    places = [place / each for each in names for place in (folder, folder / "images")]
    return next((place for place in places if place.exists()), folder / "images" / name)
