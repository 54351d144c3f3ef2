"""Boxes: anchors, the box coder and RoIAlign, all by torchvision's conventions.

A box is (x1, y1, x2, y2) in input pixels.
"""

import math

import torch
from torch import Tensor

# dw and dh are clamped above here, so that exp() cannot overflow.
SCALE_CLAMP = math.log(1000.0 / 16)
RPN_WEIGHTS = (1.0, 1.0, 1.0, 1.0)
ROI_WEIGHTS = (10.0, 10.0, 5.0, 5.0)


def cell_anchors(sizes: list[float], ratios: list[float]) -> Tensor:
    """The anchors of one cell, [len(ratios) * len(sizes), 4], ratio-major.

    As torchvision's AnchorGenerator: a ratio is height over width, an anchor's
    area is size squared, and the corners are rounded half to even.
    """
    size = torch.tensor(sizes, dtype=torch.float64)
    h_ratio = torch.tensor(ratios, dtype=torch.float64).sqrt()
    w = (1.0 / h_ratio)[:, None] * size[None, :]
    h = h_ratio[:, None] * size[None, :]
    w, h = w.flatten(), h.flatten()
    return (torch.stack([-w, -h, w, h], dim=1) / 2).round()


def grid_anchors(cells: Tensor, height: int, width: int, stride: int) -> Tensor:
    """All anchors of a map, [height * width * A, 4], in the order (y, x, anchor).

    Cell (y, x) is centred at (x * stride, y * stride), without half a stride.
    """
    x = torch.arange(width, dtype=cells.dtype, device=cells.device) * stride
    y = torch.arange(height, dtype=cells.dtype, device=cells.device) * stride
    yy, xx = torch.meshgrid(y, x, indexing="ij")
    shift = torch.stack([xx, yy, xx, yy], dim=-1).reshape(-1, 1, 4)
    return (shift + cells).reshape(-1, 4)


def _centre_form(boxes: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    w = boxes[..., 2] - boxes[..., 0]
    h = boxes[..., 3] - boxes[..., 1]
    return boxes[..., 0] + 0.5 * w, boxes[..., 1] + 0.5 * h, w, h


def encode(truth: Tensor, reference: Tensor, weights: tuple) -> Tensor:
    """The deltas (dx, dy, dw, dh) that take `reference` to `truth`."""
    tx, ty, tw, th = _centre_form(truth)
    rx, ry, rw, rh = _centre_form(reference)
    return torch.stack(
        [
            weights[0] * (tx - rx) / rw,
            weights[1] * (ty - ry) / rh,
            weights[2] * torch.log(tw / rw),
            weights[3] * torch.log(th / rh),
        ],
        dim=-1,
    )


def decode(deltas: Tensor, reference: Tensor, weights: tuple) -> Tensor:
    """The inverse of `encode`, with dw and dh clamped above at ln(1000/16)."""
    rx, ry, rw, rh = _centre_form(reference)
    dx, dy, dw, dh = (deltas[..., i] / weights[i] for i in range(4))
    x, y = dx * rw + rx, dy * rh + ry
    w = torch.exp(dw.clamp(max=SCALE_CLAMP)) * rw
    h = torch.exp(dh.clamp(max=SCALE_CLAMP)) * rh
    return torch.stack([x - 0.5 * w, y - 0.5 * h, x + 0.5 * w, y + 0.5 * h], dim=-1)


def _bin_weights(low: Tensor, high: Tensor, cells: int, bins: int, samples: int) -> Tensor:
    """How much each of `cells` grid cells weighs in each bin of [low, high]: [R, bins, cells]."""
    points = torch.arange(bins * samples, device=low.device, dtype=low.dtype) + 0.5
    at = low[:, None] + (high - low)[:, None] * points / (bins * samples)
    inside = (at >= -1.0) & (at <= cells)
    at = at.clamp(0, cells - 1)
    grid = torch.arange(cells, device=low.device, dtype=low.dtype)
    tent = (1 - (at[:, :, None] - grid).abs()).clamp(min=0) * inside[:, :, None]
    return tent.view(-1, bins, samples, cells).mean(dim=2)


def roi_align_dense(features: Tensor, boxes: Tensor, scale: float, bins: int = 7, samples: int = 2) -> Tensor:
    """RoIAlign (aligned=True) of boxes [B, R, 4] as two matrix products, [B * R, C, bins, bins].

    Bilinear sampling is separable, so a bin is Wy * F * Wx^T. On a CPU this trains
    several times faster than torchvision.ops.roi_align, whose backward is serial;
    test_model.py holds the two to the same numbers.
    """
    batch, channels, height, width = features.shape
    count = boxes.shape[1]
    flat = boxes.reshape(-1, 4).float() * scale - 0.5
    wy = _bin_weights(flat[:, 1], flat[:, 3], height, bins, samples).to(features.dtype)
    wx = _bin_weights(flat[:, 0], flat[:, 2], width, bins, samples).to(features.dtype)
    maps = features.permute(0, 2, 3, 1).reshape(batch, height, width * channels)
    strips = torch.bmm(wy.reshape(batch, count * bins, height), maps).view(batch * count, bins, width, channels)
    return torch.matmul(wx[:, None], strips).permute(0, 3, 1, 2)


def rows(values: Tensor, which: Tensor) -> Tensor:
    """values[b, which[b, k]]: of [B, N, ...] the rows [B, K]."""
    return values.gather(1, which.view(*which.shape, *(1 for _ in values.shape[2:])).expand(*which.shape, *values.shape[2:]))


def area(boxes: Tensor) -> Tensor:
    return (boxes[..., 2:] - boxes[..., :2]).prod(dim=-1)


def intersection(a: Tensor, b: Tensor) -> Tensor:
    """Areas [B, K, N] that boxes [B, K, 4] share with boxes [B, N, 4]."""
    low = torch.maximum(a[:, :, None, :2], b[:, None, :, :2])
    high = torch.minimum(a[:, :, None, 2:], b[:, None, :, 2:])
    return (high - low).clamp(min=0).prod(dim=3)


def iou(a: Tensor, b: Tensor) -> Tensor:
    """torchvision.ops.box_iou of each picture: [B, K, N]."""
    shared = intersection(a, b)
    return shared / (area(a)[:, :, None] + area(b)[:, None, :] - shared).clamp(min=1e-6)
