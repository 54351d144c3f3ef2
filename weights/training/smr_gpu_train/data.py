"""Frames of any size and scale as the network reads them."""

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor


def resize(pixels: Tensor, size: tuple[int, int]) -> Tensor:
    """[3, H, W] to [3, *size], bilinear with antialiasing (a triangle filter as wide as the scale, as Pillow's), without rounding."""
    return F.interpolate(pixels[None], size, mode="bilinear", antialias=True, align_corners=False)[0]


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
    shift, spread = (torch.tensor(v, dtype=pixels.dtype, device=pixels.device).view(3, 1, 1) for v in (mean, std))
    return (pixels / 255 - shift) / spread
