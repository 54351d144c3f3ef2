"""Changes of a picture's look, not of what it shows: wider than any one renderer, so that no renderer's look is learnt."""

import io

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor


def jpeg(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sometimes through JPEG; [h, w, 3] in uint8."""
    if rng.random() >= 0.12:
        return picture
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=int(rng.integers(35, 95)))
    return np.asarray(Image.open(file).convert("RGB"))


def _blurred(x: Tensor, sigma: float) -> Tensor:
    """A Gaussian along y and x; [3, H, W]."""
    reach = max(1, int(3 * sigma + 0.5))
    kernel = torch.exp(-(torch.arange(-reach, reach + 1, dtype=torch.float32) ** 2) / (2 * sigma**2))
    kernel = kernel / kernel.sum()
    x = F.pad(x[:, None], (reach, reach, reach, reach), mode="replicate")
    return F.conv2d(F.conv2d(x, kernel.view(1, 1, -1, 1)), kernel.view(1, 1, 1, -1))[:, 0]


def _field(rng: np.random.Generator, channels: int, cell: int, height: int, width: int) -> Tensor:
    """Smooth noise of unit variance at its nodes, one every `cell` pixels: [channels, H, W]."""
    nodes = rng.normal(0, 1, (1, channels, height // cell + 2, width // cell + 2)).astype(np.float32)
    return F.interpolate(torch.from_numpy(nodes), (height, width), mode="bicubic")[0]


def _dots(rng: np.random.Generator, height: int, width: int) -> Tensor:
    """Opacity [1, H, W] of printed markers, on a bent and turned grid or strewn, 2 to 9 pixels wide."""
    radius = rng.uniform(1.0, 4.5)
    if rng.random() < 0.75:
        pitch, turn = rng.uniform(max(8.0, 3.2 * radius), 34), rng.uniform(0, np.pi / 2)
        count = int(max(height, width) / pitch) + 2
        u, v = np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1))
        grid = np.stack([u.ravel(), v.ravel()], 1) * pitch + rng.uniform(0, pitch, 2)
        turned = grid @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        at = turned + [width / 2, height / 2] + rng.normal(0, 0.04 * pitch, turned.shape)
    else:
        at = rng.uniform(0, 1, (int(rng.integers(1, 25)), 2)) * [width, height]
    at = at[((at > -5) & (at < np.array([width, height]) + 5)).all(axis=1)]
    reach = int(radius + 2)
    opacity = np.zeros((height + 2 * reach + 12, width + 2 * reach + 12), np.float32)
    near = np.arange(-reach, reach + 1)
    for x, y in at:
        cx, cy = int(np.floor(x)), int(np.floor(y))
        distance = np.hypot(near[None, :] - (x - cx), near[:, None] - (y - cy))
        stamp = np.clip(radius + 0.5 - distance, 0, 1)
        part = opacity[cy + 6 : cy + 7 + 2 * reach, cx + 6 : cx + 7 + 2 * reach]
        np.maximum(part, stamp, out=part)
    return torch.from_numpy(opacity[None, 6 + reach : 6 + reach + height, 6 + reach : 6 + reach + width])


def photometric(x: Tensor, rng: np.random.Generator) -> Tensor:
    """Random light, colour, contrast, focus, markers and noise, each picture's as strong as a draw; x is [B, 3, H, W] in 0 to 1."""
    batch, _, height, width = x.shape
    strength = rng.uniform(0.1, 1, batch)

    def per(spread: float, *shape: int) -> Tensor:
        draws = rng.normal(0, spread, (batch, *shape)) * strength.reshape(batch, *(1 for _ in shape))
        return torch.from_numpy(draws.astype(np.float32))

    x = x.clamp(1e-3, 1) ** per(0.2, 1, 1, 1).exp()
    # Contrast of what is smaller than 2 mm against what is larger, then of the whole.
    low = F.interpolate(F.avg_pool2d(x, 16, ceil_mode=True, count_include_pad=False), (height, width), mode="bilinear")
    x = low + (x - low) * per(0.3, 1, 1, 1).exp().clamp(0.6, 2.5)
    mean = x.mean(dim=(2, 3), keepdim=True)
    x = (x - mean) * per(0.25, 1, 1, 1).exp() + mean
    x = x * (per(0.12, 3, 1, 1) + per(0.18, 1, 1, 1)).exp()
    for i in range(batch):
        if rng.random() < strength[i]:
            x[i] = _one(x[i], rng, height, width)
    noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(int(rng.integers(2**31))))
    # Less where there is less light: it would hide what a dark picture shows.
    grain = torch.from_numpy((rng.uniform(0, 1, (batch, 1, 1, 1)) ** 4 * 0.06).astype(np.float32))
    return (x + noise * grain * x.mean(dim=(1, 2, 3), keepdim=True)).clamp(0, 1)


def _one(x: Tensor, rng: np.random.Generator, height: int, width: int) -> Tensor:
    """What only some pictures get; [3, H, W]."""
    colour = rng.random()
    if colour < 0.25:
        x = x[torch.from_numpy(rng.permutation(3))]
    elif colour < 0.4:
        grey = x.mean(dim=0, keepdim=True) if rng.random() < 0.5 else x[int(rng.integers(3))][None]
        x = grey * torch.from_numpy(rng.uniform(0.6, 1.1, (3, 1, 1)).astype(np.float32))
    elif colour < 0.65:
        # Lights of other colours: each channel a mixture of the three that keeps its mean level.
        mix = np.eye(3) + rng.normal(0, 0.35, (3, 3))
        mix = torch.from_numpy((mix / np.maximum(mix.sum(axis=1, keepdims=True), 0.4)).astype(np.float32))
        x = torch.einsum("cd,dhw->chw", mix, x)
    if rng.random() < 0.5:
        x = x * (_field(rng, 3, max(height, width) // 3, height, width) * rng.uniform(0, 0.15)).exp()
    if rng.random() < 0.3:
        x = x * (1 + _field(rng, 1, int(rng.integers(2, 9)), height, width) * rng.uniform(0, 0.06))
    if rng.random() < 0.2:
        dots = _dots(rng, height, width)
        ink = torch.from_numpy(rng.uniform(0, 0.25, (3, 1, 1)).astype(np.float32)) if rng.random() < 0.85 else torch.tensor(rng.uniform(0.75, 1), dtype=torch.float32)
        x = torch.lerp(x, ink.expand_as(x), dots * rng.uniform(0.5, 1))
    if rng.random() < 0.3:
        x = _blurred(x, rng.uniform(0.3, 1.1))
    return x
