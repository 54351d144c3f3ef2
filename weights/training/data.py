"""COCO folders as small pictures, and batches of views of them.

A folder holds annotations.json and the pictures it names, frames of any size and scale.
Each is resized once, to the largest scale that training asks for; the copies lie in one
file of a cache folder, mapped into memory.
"""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from augment import jpeg, photometric
from truth import Truth

CLASSES = ("A", "B")
DIRECTED = ("A",)
PAPER_MM_PER_PIXEL = 0.04
# Times the network's scale, evenly on a logarithmic axis.
JITTER = 1.25
# Side of a step's views: one of these, or whole pictures in the rest of the steps.
WINDOWS = (128, 160, 192, 224, 256)
WHOLE_SHARE = 0.25
# Of a batch: each view brings as many regions, however small it is.
MOST_VIEWS = 24
# A cut part's upright box is its whole's clipped box only if the part stands upright or is round, or if little is cut.
LEFT_UPRIGHT, LEFT_SLANTED, UPRIGHT = 0.7, 0.9, 0.35


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

    def pick(self, which: np.ndarray) -> "Snaps":
        return Snaps(self.boxes[which], self.labels[which], self.yaw[which], self.whole[which])


@dataclass
class Entry:
    """One picture of a folder, its boxes in frame pixels."""

    name: str
    size: tuple[int, int]  # height, width
    mm_per_pixel: float
    conditions: dict
    snaps: Snaps


def read_coco(folder: Path) -> list[Entry]:
    """A folder's pictures in the order of its file; without a stated scale a frame is the paper's."""
    coco = json.loads((folder / "annotations.json").read_text())
    label = {c["id"]: CLASSES.index(c["name"].upper()) + 1 for c in coco["categories"] if c["name"].upper() in CLASSES}
    found: dict[int, list] = {image["id"]: [] for image in coco["images"]}
    for annotation in coco["annotations"]:
        if annotation["category_id"] in label and not annotation.get("iscrowd", 0):
            found[annotation["image_id"]].append(annotation)
    entries = []
    for image in coco["images"]:
        rows = found[image["id"]]
        boxes = np.array([r["bbox"] for r in rows], np.float32).reshape(-1, 4)
        boxes[:, 2:] += boxes[:, :2]
        labels = np.array([label[r["category_id"]] for r in rows], np.int64)
        degrees = [r.get("yaw_deg") if CLASSES[c - 1] in DIRECTED else None for r, c in zip(rows, labels)]
        yaw = np.radians(np.array([math.nan if d is None else d for d in degrees], np.float32))
        size = (image["height"], image["width"])
        # Old folders do not say; there a box at the edge belongs to a cut part.
        inside = (boxes > 1).all(axis=1) & (boxes < np.array([*size[::-1], *size[::-1]]) - 1).all(axis=1)
        whole = np.array([r.get("whole", bool(i)) for r, i in zip(rows, inside)], bool)
        mm = image.get("mm_per_pixel") or PAPER_MM_PER_PIXEL
        entries.append(Entry(image["file_name"], size, mm, image.get("conditions") or {}, Snaps(boxes, labels, yaw, whole)))
    return entries


def picture_path(folder: Path, name: str) -> Path:
    """A COCO file name is relative to the folder or to its images/."""
    return folder / name if (folder / name).exists() else folder / "images" / name


def content_key(files: list[Path], sizes: list[tuple[int, int]]) -> str:
    """A digest of what small pictures are made from: the bytes of each file, in order, and the sizes made of them."""
    whole = hashlib.blake2b(f"{sizes} uint8".encode(), digest_size=8)
    for file in files:
        with open(file, "rb") as picture:
            whole.update(hashlib.file_digest(picture, "blake2b").digest())
    return whole.hexdigest()


class Chunk:
    """One folder's pictures, [h, w, 3] in uint8 at `scales` pixels a millimetre, and their snaps in these pixels."""

    def __init__(self, folder: Path, pixels_per_mm: float, cache: Path):
        self.folder = folder
        entries = read_coco(folder)
        # No picture is enlarged: it would only take room.
        factors = [min(1.0, pixels_per_mm * e.mm_per_pixel) for e in entries]
        self.sizes = [(scaled(e.size[0], f), scaled(e.size[1], f)) for e, f in zip(entries, factors)]
        self.scales = [f / e.mm_per_pixel for e, f in zip(entries, factors)]
        self.starts = np.cumsum([0, *(3 * h * w for h, w in self.sizes)])
        key = content_key([picture_path(folder, e.name) for e in entries], self.sizes)
        file = cache / f"{folder.name}-{key}.npy"
        if not file.exists():
            self.resize_all(entries, file)
        self.pixels = np.load(file, mmap_mode="r")
        if len(self.pixels) != self.starts[-1]:
            raise SystemExit(f"{file}: expected {self.starts[-1]} bytes of pixels, got {len(self.pixels)}")
        self.snaps = []
        for entry, (h, w) in zip(entries, self.sizes):
            # Per axis: sizes are whole pixels.
            ratio = np.array([w / entry.size[1], h / entry.size[0]] * 2, np.float32)
            snaps = Snaps((entry.snaps.boxes * ratio).clip(0, [w, h, w, h]), entry.snaps.labels, entry.snaps.yaw, entry.snaps.whole)
            sides = snaps.boxes[:, 2:] - snaps.boxes[:, :2]
            self.snaps.append(snaps.pick(sides.min(axis=1, initial=np.inf) >= 2))

    def resize_all(self, entries: list[Entry], file: Path) -> None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        store = np.lib.format.open_memmap(part, "w+", np.uint8, (int(self.starts[-1]),))
        for i, (entry, (h, w)) in enumerate(zip(entries, self.sizes)):
            path = picture_path(self.folder, entry.name)
            pixels = read_picture(path)
            if pixels.shape[:2] != entry.size:
                raise SystemExit(f"{path}: expected {entry.size} pixels (height, width), got {pixels.shape[:2]}")
            small = np.asarray(Image.fromarray(pixels).resize((w, h), Image.Resampling.BILINEAR))
            store[self.starts[i] : self.starts[i + 1]] = small.reshape(-1)
        store.flush()
        part.rename(file)

    def __len__(self) -> int:
        return len(self.sizes)

    def picture(self, at: int) -> np.ndarray:
        return self.pixels[self.starts[at] : self.starts[at + 1]].reshape(*self.sizes[at], 3)


def orient(picture: np.ndarray, snaps: Snaps, mirror_x: bool, mirror_y: bool, transpose: bool) -> tuple[np.ndarray, Snaps]:
    """The eight flips and quarter turns: left for right, then top for bottom, then x for y."""
    height, width = picture.shape[:2]
    boxes, yaw = snaps.boxes, snaps.yaw
    if mirror_x:
        picture, boxes, yaw = picture[:, ::-1], boxes[:, [2, 1, 0, 3]] * [-1, 1, -1, 1] + [width, 0, width, 0], math.pi - yaw
    if mirror_y:
        picture, boxes, yaw = picture[::-1], boxes[:, [0, 3, 2, 1]] * [1, -1, 1, -1] + [0, height, 0, height], -yaw
    if transpose:
        picture, boxes, yaw = picture.transpose(1, 0, 2), boxes[:, [1, 0, 3, 2]], math.pi / 2 - yaw
    return picture, Snaps(boxes.astype(np.float32), snaps.labels, yaw.astype(np.float32), snaps.whole)


def cut(snaps: Snaps, x: int, y: int, width: int, height: int) -> tuple[Snaps, np.ndarray]:
    """The snaps that a crop at (x, y) leaves, in its own pixels, and the boxes [I, 4] of those that are to be ignored."""
    boxes = (snaps.boxes - np.array([x, y, x, y], np.float32)).clip(0, np.array([width, height] * 2, np.float32))
    area, seen = (np.prod(b[:, 2:] - b[:, :2], axis=1) for b in (snaps.boxes, boxes))
    left = seen / np.maximum(area, 1e-6)
    directed = np.isin(snaps.labels, [CLASSES.index(c) + 1 for c in DIRECTED])
    with np.errstate(invalid="ignore"):
        slanted = directed & ~(np.abs(np.sin(2 * snaps.yaw)) < UPRIGHT)  # an unknown direction too
    keep = left >= np.where(slanted, LEFT_SLANTED, LEFT_UPRIGHT)
    kept = Snaps(boxes, snaps.labels, snaps.yaw, snaps.whole & (left > 0.995)).pick(keep)
    return kept, boxes[(seen > 0) & ~keep]


def _place(picture: np.ndarray, snaps: Snaps, room: tuple[int, int], crop: tuple[int, int], rng: np.random.Generator) -> tuple[int, int]:
    """A random place (x, y) for a crop (height, width) in a picture of size `room`: mostly around some snap, or about what stands out."""
    span = np.array([room[1] - crop[1], room[0] - crop[0]])
    if not len(snaps.boxes) or rng.random() < 0.1:
        # Look-alikes carry no box: of three places the one with most contrast.
        step = max(1, round(picture.shape[0] / room[0] * 8))
        grey = picture[::step, ::step, 1]
        places = [tuple(int(v) for v in rng.integers(0, span + 1)) for _ in range(3)]
        size = [max(2, crop[i] * grey.shape[i] // room[i]) for i in (0, 1)]
        corners = [(y * grey.shape[0] // room[0], x * grey.shape[1] // room[1]) for x, y in places]
        spread = [float(grey[t : t + size[0], l : l + size[1]].std()) for t, l in corners]
        return places[int(np.argmax(spread))]
    best = None
    for _ in range(8):
        box = snaps.boxes[rng.integers(len(snaps.boxes))]
        low = np.clip(np.ceil(box[2:] - crop[::-1]), 0, span)
        high = np.clip(np.floor(box[:2]), low, span)
        if rng.random() < 0.15:  # let the crop cut it
            reach = 0.3 * (box[2:] - box[:2])
            low, high = np.clip(low - reach, 0, span), np.clip(high + reach, 0, span)
        x, y = (int(rng.integers(int(a), int(b) + 1)) for a, b in zip(low, high))
        lost = len(cut(snaps, x, y, crop[1], crop[0])[1])
        if best is None or lost < best[0]:
            best = (lost, x, y)
        if lost == 0:
            break
    return best[1], best[2]


def collate(views: list[tuple[Snaps, np.ndarray]]) -> Truth:
    """The snaps of a batch's views and what is to be ignored, padded to as many as the fullest has."""

    def padded(values: list[np.ndarray], value: float) -> Tensor:
        most = max(1, *map(len, values))
        rest = [(0, 0)] * (values[0].ndim - 1)
        return torch.from_numpy(np.stack([np.pad(v, [(0, most - len(v)), *rest], constant_values=value) for v in values]))

    snaps, ignored = zip(*views)
    boxes, labels, yaw, whole = (padded([getattr(s, name) for s in snaps], 0) for name in ("boxes", "labels", "yaw", "whole"))
    return Truth(boxes, labels, yaw, whole.float(), padded(ignored, 0))


class Sampler:
    """Batches of views. A step's batch depends on the seed and the step alone, once the folders are given."""

    def __init__(self, chunks: list[Chunk], pixels_per_mm: float, area: int, seed: int):
        self.chunks, self.pixels_per_mm, self.area, self.seed = chunks, pixels_per_mm, area, seed

    def _draw(self, rng: np.random.Generator) -> tuple[Chunk, int, tuple[int, int], bool]:
        """A picture, its size at a random scale, and whether it is to be turned on its side."""
        ends = np.cumsum([len(c) for c in self.chunks])
        index = int(rng.integers(ends[-1]))
        which = int(np.searchsorted(ends, index, side="right"))
        chunk, at = self.chunks[which], index - int(ends[which - 1] if which else 0)
        scale = self.pixels_per_mm * JITTER ** rng.uniform(-1, 1) / chunk.scales[at]
        height, width = (scaled(side, scale) for side in chunk.sizes[at])
        return chunk, at, (height, width), bool(rng.random() < 0.5)

    def batch(self, step: int) -> tuple[Tensor, Truth]:
        """Pixels [B, 3, h, w] in 0 to 255 and targets; h, w and B change from step to step, B * h * w is about `area`, or less where the views are small."""
        rng = np.random.default_rng([self.seed, step])
        whole = rng.random() < WHOLE_SHARE
        limit = 10**6 if whole else int(rng.choice(WINDOWS))
        first = self._draw(rng)
        window = tuple(min(whole_tiles(side), limit) for side in (first[2][::-1] if first[3] else first[2]))
        count = min(MOST_VIEWS, max(2, round(self.area / (window[0] * window[1]))))
        views = [first]
        while len(views) < count:
            # One that fills the window, or nearly: a smaller picture would be mostly padding.
            best, best_filled = None, 0.0
            for _ in range(50):
                view = self._draw(rng)
                size = view[2][::-1] if view[3] else view[2]
                ratios = [whole_tiles(side) / wanted for side, wanted in zip(size, window)]
                # Beside a whole picture others that are as nearly whole in its window.
                filled = min(min(r, 1 / r) for r in ratios) if whole else min(ratios)
                if filled > best_filled:
                    best, best_filled = view, filled
                if filled >= 1:
                    break
            views.append(best)
        pixels, targets = zip(*(self._view(v, window, rng) for v in views))
        return photometric(torch.stack(pixels) / 255, int(rng.integers(2**31))) * 255, collate(targets)

    def _view(self, view: tuple, window: tuple[int, int], rng: np.random.Generator) -> tuple[Tensor, tuple[Snaps, np.ndarray]]:
        chunk, at, (height, width), turned = view
        picture = chunk.picture(at)
        fx, fy = width / picture.shape[1], height / picture.shape[0]
        snaps = chunk.snaps[at]
        snaps = Snaps(snaps.boxes * np.array([fx, fy, fx, fy], np.float32), snaps.labels, snaps.yaw, snaps.whole)
        inner = window[::-1] if turned else window
        h, w = min(inner[0], height), min(inner[1], width)
        x, y = _place(picture, snaps, (height, width), (h, w), rng)
        snaps, ignored = cut(snaps, x, y, w, h)
        box = (x / fx, y / fy, (x + w) / fx, (y + h) / fy)
        small = np.asarray(Image.fromarray(picture).resize((w, h), Image.Resampling.BILINEAR, box=box))
        small = jpeg(small, rng)
        mirrors = rng.random(2) < 0.5
        none = Snaps(ignored, *(np.zeros(len(ignored), t) for t in (np.int64, np.float32, bool)))
        _, none = orient(small, none, *mirrors, turned)
        small, snaps = orient(small, snaps, *mirrors, turned)
        small = np.pad(small, [(0, window[0] - small.shape[0]), (0, window[1] - small.shape[1]), (0, 0)], mode="edge")
        return torch.from_numpy(np.ascontiguousarray(small)).permute(2, 0, 1).float(), (snaps, none.boxes)
