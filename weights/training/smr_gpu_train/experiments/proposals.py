"""Regions from selective search (Uijlings et al. 2013), by OpenCV's contrib package, and views that carry them."""

import ctypes
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .. import boxes as bx
from ..data import network_input
from ..errors import NotInstalled
from ..files import whole
from ..parts import content_key
from ..pictures import Entry
from ..pool import Pool, orient
from ..truth import Truth
from .models import SCALE_PER_MM, Proposals

NARROWEST = 4  # pixels of the network's input


@dataclass
class Searched:
    boxes: Tensor  # [pictures, P, 4], shares of the picture's sides, without area where a picture has fewer
    seconds: float  # a picture, on one thread

    def each(self) -> list[Tensor]:
        """[P, 4] of each picture."""
        return [boxes[bx.area(boxes) > 0] for boxes in self.boxes]


def search(picture: np.ndarray, mode: str) -> np.ndarray:
    """Boxes [P, 4] in pixels of a picture [H, W, 3] in uint8 RGB, in the search's order; the picture itself if nothing else is found.

    The search ranks its boxes by C's rand(), which is begun anew: the same picture gives the same boxes.
    """
    try:
        import cv2
    except ModuleNotFoundError:
        raise NotInstalled("cv2 is not installed: pip install 'weights/training[experiments]'") from None
    cv2.setNumThreads(1)
    method = cv2.ximgproc.segmentation.createSelectiveSearchSegmentation()
    method.setBaseImage(np.ascontiguousarray(picture[:, :, ::-1]))
    method.switchToSelectiveSearchFast() if mode == "fast" else method.switchToSelectiveSearchQuality()
    ctypes.CDLL(None).srand(1)
    found = np.asarray(method.process(), np.float32).reshape(-1, 4)
    found = found[found[:, 2:].min(axis=1, initial=np.inf) >= NARROWEST]
    boxes = np.concatenate([found[:, :2], found[:, :2] + found[:, 2:]], axis=1)
    return boxes if len(boxes) else np.array([[0, 0, picture.shape[1], picture.shape[0]]], np.float32)


def _of_picture(entry: Entry, mode: str) -> tuple[np.ndarray, float]:
    """Its boxes as shares of its sides, and the seconds that they took."""
    began = time.process_time()
    pixels, (x, y) = network_input(entry.pixels(), SCALE_PER_MM * entry.mm_per_pixel)
    boxes = search(pixels.permute(1, 2, 0).round().byte().numpy(), mode)
    height, width = entry.size
    return (boxes * np.array([x, y, x, y]) / [width, height, width, height]).clip(0, 1), time.process_time() - began


def searched(pictures: list[Entry], mode: str, cache: Path, workers: int = 1) -> Searched:
    """Those of each picture at the network's scale, kept in `cache` by the pictures' content."""
    file = cache / f"search-{mode}-{content_key(pictures, SCALE_PER_MM, [mode])}.npz"
    if not file.exists():
        # New processes, as a card's driver does not live through a fork.
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), torch.set_num_threads, (1,)) as pool:
            found = [*(pool.map if workers > 1 else map)(partial(_of_picture, mode=mode), pictures)]
        rows = [boxes for boxes, _ in found]
        seconds = sum(taken for _, taken in found) / max(1, len(pictures))
        table = np.zeros((len(rows), max(map(len, rows)), 4), np.float32)
        for i, row in enumerate(rows):
            table[i, : len(row)] = row
        with whole(file) as part, open(part, "wb") as out:
            np.savez(out, boxes=table, seconds=seconds)
    with np.load(file) as saved:
        return Searched(torch.from_numpy(saved["boxes"]), float(saved["seconds"]))


class Views(Pool):
    """A pool whose views may carry their pictures' regions, cut and turned as the views are."""

    regions: Tensor | None = None  # [pictures, P, 4], as Searched.boxes
    seen: Truth | None = None

    def _pixels(self, index: Tensor, corner: Tensor, crop: Tensor, factor: Tensor, mirror: Tensor, turned: Tensor, window: tuple[int, int]) -> Tensor:
        if self.regions is not None:
            size = (factor * self.sizes[index]).flip(-1)
            boxes = self.regions[index] * torch.cat([size, size], dim=1)[:, None] - torch.cat([corner, corner], dim=1)[:, None]
            boxes = boxes.clamp(min=0).minimum(torch.cat([crop, crop], dim=1)[:, None])
            there = (boxes[..., 2:] - boxes[..., :2]).amin(dim=2) >= NARROWEST
            none = torch.zeros_like(boxes[..., 0])
            self.seen = orient(boxes, there.long(), none, none, there, torch.zeros_like(there), crop, mirror, turned)
        return super()._pixels(index, corner, crop, factor, mirror, turned, window)

    def views(self, step: int, area: int, seed: int) -> tuple[Tensor, Truth, Proposals | None]:
        pixels, truth = self.batch(step, area, seed)
        return pixels, truth, None if self.seen is None else (self.seen.boxes, self.seen.labels > 0)
