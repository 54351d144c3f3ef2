"""COCO folders as small pictures in memory, and batches of them with augmentation.

A folder holds annotations.json and the pictures it names. A picture is cropped
to its central square and resized once; the copy is kept in a cache folder.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

CLASSES = ("A", "B")


def load_picture(path: Path, size: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, float, tuple[int, int]]:
    """The square centre crop resized to [3, size, size] (0 to 255), picture pixels a pixel, and the crop's corner.

    The resize is bilinear with antialiasing (a triangle filter as wide as the
    scale, as Pillow's) from float values, without rounding afterwards.
    """
    with Image.open(path) as image:
        return resize_square(np.asarray(image.convert("RGB")), size, dtype)


def resize_square(pixels: np.ndarray, size: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, float, tuple[int, int]]:
    """As `load_picture`, from a picture [H, W, 3] in uint8."""
    height, width = pixels.shape[:2]
    side = min(height, width)
    left, top = (width - side) // 2, (height - side) // 2
    square = torch.from_numpy(pixels[top : top + side, left : left + side].copy())
    square = square.permute(2, 0, 1)[None].to(dtype)
    resized = F.interpolate(square, (size, size), mode="bilinear", antialias=True, align_corners=False)[0]
    return resized, side / size, (left, top)


def normalise(pixels: Tensor, mean: list[float], std: list[float]) -> Tensor:
    """0 to 255 to the network's input; [.., 3, H, W]."""
    mean, std = (torch.tensor(v, dtype=pixels.dtype, device=pixels.device).view(3, 1, 1) for v in (mean, std))
    return (pixels / 255 - mean) / std


def read_coco(folder: Path) -> list[tuple[str, list[tuple[int, list[float]]]]]:
    """Each picture's file name and its (class, [x, y, w, h]) list, in the order of the file; A is 1 and B is 2."""
    coco = json.loads((folder / "annotations.json").read_text())
    label = {c["id"]: CLASSES.index(c["name"].upper()) + 1 for c in coco["categories"] if c["name"].upper() in CLASSES}
    found: dict[int, list] = {image["id"]: [] for image in coco["images"]}
    for annotation in coco["annotations"]:
        if annotation["category_id"] in label and not annotation.get("iscrowd", 0):
            found[annotation["image_id"]].append((label[annotation["category_id"]], annotation["bbox"]))
    return [(image["file_name"], found[image["id"]]) for image in coco["images"]]


def picture_path(folder: Path, name: str) -> Path:
    """A COCO file name is relative to the folder or to its images/."""
    return folder / name if (folder / name).exists() else folder / "images" / name


def content_key(files: list[Path], size: int) -> str:
    """A digest of what small pictures are made from: the bytes of each file, in order, and the size."""
    whole = hashlib.blake2b(f"{size} float16".encode(), digest_size=8)
    for file in files:
        with open(file, "rb") as picture:
            whole.update(hashlib.file_digest(picture, "blake2b").digest())
    return whole.hexdigest()


class Chunk:
    """One folder in memory: pictures float16 [N, S, S, 3] in 0 to 255, and boxes and labels a picture, in resized pixels."""

    def __init__(self, folder: Path, size: int, cache: Path):
        self.folder = folder
        entries = read_coco(folder)
        file = cache / f"{folder.name}-{content_key([picture_path(folder, name) for name, _ in entries], size)}.npz"
        if file.exists():
            with np.load(file) as saved:
                self.pictures, self.geometry = saved["pictures"], saved["geometry"]
        else:
            loaded = [load_picture(picture_path(folder, name), size) for name, _ in entries]
            self.pictures = np.stack([p.half().permute(1, 2, 0).numpy() for p, _, _ in loaded])
            self.geometry = np.array([[scale, *corner] for _, scale, corner in loaded], np.float64)
            cache.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(".part.npz")
            np.savez(part, pictures=self.pictures, geometry=self.geometry)
            part.rename(file)
        self.boxes, self.labels = [], []
        for (_, found), (scale, left, top) in zip(entries, self.geometry):
            boxes = np.array([[x, y, x + w, y + h] for _, (x, y, w, h) in found], np.float32).reshape(-1, 4)
            boxes = ((boxes - np.array([left, top, left, top])) / scale).clip(0, size)
            keep = (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf) >= 2
            self.boxes.append(boxes[keep].astype(np.float32))
            self.labels.append(np.array([label for label, _ in found], np.int64)[keep])

    def __len__(self) -> int:
        return len(self.pictures)


def _orient(picture: np.ndarray, boxes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One of the eight flips and quarter turns."""
    size = picture.shape[0]
    if rng.random() < 0.5:
        picture, boxes = picture[:, ::-1], boxes[:, [2, 1, 0, 3]] * [-1, 1, -1, 1] + [size, 0, size, 0]
    if rng.random() < 0.5:
        picture, boxes = picture[::-1], boxes[:, [0, 3, 2, 1]] * [1, -1, 1, -1] + [0, size, 0, size]
    if rng.random() < 0.5:
        picture, boxes = picture.transpose(1, 0, 2), boxes[:, [1, 0, 3, 2]]
    return picture, boxes.astype(np.float32)


def _cut(boxes: np.ndarray, x: int, y: int, crop: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes clipped to a crop at (x, y), which of them lie whole in it, and which are cut by it."""
    corner = np.array([x, y, x, y], np.float32)
    clipped = (boxes - corner).clip(0, crop)
    seen = np.prod((clipped[:, 2:] - clipped[:, :2]).clip(min=0), axis=1)
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    whole = seen > 0.999 * area
    return clipped.astype(np.float32), whole, (seen > 0) & ~whole


def _crop(boxes: np.ndarray, size: int, crop: int, rng: np.random.Generator) -> tuple[int, int]:
    """A random place for the crop: nine times in ten around some snap, cutting as few others as eight tries allow."""
    aim = len(boxes) > 0 and rng.random() < 0.9
    best = None
    for _ in range(8):
        low, high = np.zeros(2), np.full(2, size - crop, np.float64)
        if aim:
            box = boxes[rng.integers(len(boxes))]
            low = np.clip(np.ceil(box[2:] - crop), 0, size - crop)
            high = np.clip(np.floor(box[:2]), low, size - crop)
        x, y = (int(rng.integers(int(a), int(b) + 1)) for a, b in zip(low, high))
        cuts = int(_cut(boxes, x, y, crop)[2].sum())
        if best is None or cuts < best[0]:
            best = (cuts, x, y)
        if cuts == 0:
            break
    return best[1], best[2]


def _photometric(x: Tensor, rng: np.random.Generator) -> Tensor:
    """Random exposure, colour, gamma, contrast, uneven light, defocus and noise; x is [B, 3, S, S] in 0 to 1."""
    batch, _, size, _ = x.shape

    def per(spread: float, *shape: int) -> Tensor:
        return torch.from_numpy(rng.normal(0, spread, (batch, *shape)).astype(np.float32))

    x = x.clamp(1e-3, 1) ** per(0.12, 1, 1, 1).exp()
    mean = x.mean(dim=(2, 3), keepdim=True)
    x = (x - mean) * per(0.2, 1, 1, 1).exp() + mean
    light = per(0.06, 3, 1, 1) + per(0.12, 1, 1, 1) + F.interpolate(per(0.05, 3, 4, 4), (size, size), mode="bicubic")
    x = x * light.exp()
    for i in range(batch):
        if rng.random() < 0.1:
            x[i] = x[i, torch.from_numpy(rng.permutation(3))]
        if rng.random() < 0.05:
            x[i] = x[i].mean(dim=0, keepdim=True)
        if rng.random() < 0.15:
            sigma = rng.uniform(0.3, 0.7)
            kernel = torch.exp(-torch.arange(-2, 3, dtype=torch.float32) ** 2 / (2 * sigma**2))
            kernel = kernel / kernel.sum()
            x[i] = F.conv2d(x[i][:, None], torch.outer(kernel, kernel)[None, None], padding=2)[:, 0]
    noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(int(rng.integers(2**31))))
    return (x + noise * torch.from_numpy(rng.uniform(0, 0.004, (batch, 1, 1, 1)).astype(np.float32))).clamp(0, 1)


def batch_at(chunks: list[Chunk], step: int, seed: int, batch: int, crop: int) -> tuple[Tensor, list[dict]]:
    """The batch of a step, the same whenever it is asked for: pixels [B, 3, crop, crop] in 0 to 255, and targets."""
    rng = np.random.default_rng([seed, step])
    ends = np.cumsum([len(c) for c in chunks])
    pixels, targets = [], []
    for index in rng.integers(ends[-1], size=batch):
        which = int(np.searchsorted(ends, index, side="right"))
        chunk, at = chunks[which], int(index - (ends[which - 1] if which else 0))
        picture, boxes = _orient(chunk.pictures[at], chunk.boxes[at], rng)
        labels = chunk.labels[at]
        size = picture.shape[0]
        ignored = np.zeros((0, 4), np.float32)
        if crop < size:
            x, y = _crop(boxes, size, crop, rng)
            picture = picture[y : y + crop, x : x + crop]
            clipped, whole, cut = _cut(boxes, x, y, crop)
            boxes, labels, ignored = clipped[whole], labels[whole], clipped[cut]
        pixels.append(torch.from_numpy(np.ascontiguousarray(picture)).permute(2, 0, 1).float() / 255)
        targets.append({"boxes": torch.from_numpy(boxes), "labels": torch.from_numpy(labels), "ignored": torch.from_numpy(ignored)})
    return _photometric(torch.stack(pixels), rng) * 255, targets
