"""Changes of a picture's look, not of what it shows: wider than any one renderer, so that no renderer's look is learnt."""

import io
import math

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

JPEG_SHARE = 0.12


def jpeg(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sometimes through JPEG; [h, w, 3] in uint8."""
    if rng.random() >= JPEG_SHARE:
        return picture
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=int(rng.integers(35, 95)))
    return np.asarray(Image.open(file).convert("RGB"))


class Draws:
    """One number a picture, [B, 1, 1, 1], or a block of `shape` in place of the ones."""

    def __init__(self, batch: int, generator: torch.Generator):
        self.batch, self.generator = batch, generator

    def uniform(self, low: float = 0.0, high: float = 1.0, shape: tuple = (1, 1, 1)) -> Tensor:
        drawn = torch.rand(self.batch, *shape, generator=self.generator, device=self.generator.device)
        return low + (high - low) * drawn

    def normal(self, spread: float = 1.0, shape: tuple = (1, 1, 1)) -> Tensor:
        return spread * torch.randn(self.batch, *shape, generator=self.generator, device=self.generator.device)

    def often(self, share: float | Tensor) -> Tensor:
        """True in that share of the pictures."""
        return self.uniform() < share

    def field(self, channels: int, cell: int, height: int, width: int) -> Tensor:
        """Smooth noise of unit variance at its nodes, one every `cell` pixels: [B, channels, H, W]."""
        nodes = self.normal(1.0, (channels, height // cell + 2, width // cell + 2))
        return F.interpolate(nodes, (height, width), mode="bicubic")


def _colours(draw: Draws) -> Tensor:
    """A mixture of the channels for each picture, [B, 3, 3]; that of most is the identity."""
    which = draw.uniform(shape=(1, 1))
    identity = torch.eye(3, device=which.device).expand(draw.batch, 3, 3)
    exchanged = identity.gather(1, draw.uniform(shape=(3,)).argsort(dim=1)[:, :, None].expand(-1, -1, 3))
    # One channel, or the mean of all, in a tint.
    one = identity.gather(1, (3 * draw.uniform(shape=(1, 1))).long().expand(-1, -1, 3))
    grey = one.where(draw.uniform(shape=(1, 1)) < 0.5, 1 / 3) * draw.uniform(0.6, 1.1, (3, 1))
    # Lights of other colours: each channel a mixture of the three that keeps its mean level.
    mixed = identity + draw.normal(0.35, (3, 3))
    mixed = mixed / mixed.sum(dim=2, keepdim=True).clamp(min=0.4)
    return exchanged.where(which < 0.25, grey.where(which < 0.4, mixed.where(which < 0.65, identity)))


def _dots(draw: Draws, height: int, width: int) -> Tensor:
    """Opacity [B, 1, H, W] of printed markers, on a turned grid or strewn, 2 to 9 pixels wide."""
    radius, turn = draw.uniform(1.0, 4.5), draw.uniform(0, math.pi / 2)
    strewn = draw.often(0.25)
    low = (3.2 * radius).clamp(min=8.0)
    pitch = (low + draw.uniform() * (34 - low).clamp(min=0)).where(~strewn, draw.uniform(40, 120))
    device = radius.device
    x = torch.arange(width, device=device).view(1, 1, 1, -1) - width / 2
    y = torch.arange(height, device=device).view(1, 1, -1, 1) - height / 2
    u = (x * turn.cos() + y * turn.sin()) / pitch + draw.uniform()
    v = (y * turn.cos() - x * turn.sin()) / pitch + draw.uniform()
    cell = torch.cat([u.floor(), v.floor()], dim=1)
    # Each cell's dot lies off its middle by two numbers that the cell's place gives; strewn ones far, and within the cell.
    seed = 12.9898 * cell[:, :1] + 78.233 * cell[:, 1:] + 1000 * draw.uniform()
    off = torch.cat([(seed.sin() * 43758.5).frac(), ((seed + 1.7).sin() * 24634.6).frac()], dim=1)
    spread = (0.5 - radius / pitch - 1 / pitch).clamp(min=0).where(strewn, 0.07)
    distance = (torch.cat([u, v], dim=1) - cell - 0.5 - spread * off).square().sum(dim=1, keepdim=True).sqrt() * pitch
    return (radius + 0.5 - distance).clamp(0, 1)


def _blurred(x: Tensor, sigma: Tensor) -> Tensor:
    """A Gaussian of each picture's own sigma [B, 1, 1, 1], at most 1.1, along y and x."""
    reach = 3
    height, width = x.shape[2:]
    kernel = [torch.exp(-(i**2) / (2 * sigma**2)) for i in range(-reach, reach + 1)]
    total = sum(kernel)
    padded = F.pad(x, (0, 0, reach, reach), mode="replicate")
    x = sum(k / total * padded[:, :, i : i + height] for i, k in enumerate(kernel))  # type: ignore[assignment]
    padded = F.pad(x, (reach, reach, 0, 0), mode="replicate")
    return sum(k / total * padded[:, :, :, i : i + width] for i, k in enumerate(kernel))  # type: ignore[return-value]


def photometric(x: Tensor, seed: int) -> Tensor:
    """Random light, colour, contrast, focus, markers and noise, each picture's as strong as a draw; x is [B, 3, H, W] in 0 to 1."""
    height, width = x.shape[2:]
    draw = Draws(len(x), torch.Generator(x.device).manual_seed(seed))
    strength = draw.uniform(0.1, 1)

    def per(spread: float, channels: int = 1) -> Tensor:
        return draw.normal(spread, (channels, 1, 1)) * strength

    x = x.clamp(1e-3, 1) ** per(0.2).exp()
    # Contrast of what is smaller than 2 mm against what is larger, then of the whole.
    low = F.interpolate(F.avg_pool2d(x, 16, ceil_mode=True, count_include_pad=False), (height, width), mode="bilinear")
    x = low + (x - low) * per(0.3).exp().clamp(0.6, 2.5)
    mean = x.mean(dim=(2, 3), keepdim=True)
    x = (x - mean) * per(0.25).exp() + mean
    x = x * (per(0.12, 3) + per(0.18)).exp()
    # What only some pictures get.
    some = draw.often(strength)
    x = torch.einsum("bcd,bdhw->bchw", _colours(draw), x).where(some, x)
    uneven = draw.field(3, max(height, width) // 3, height, width) * draw.uniform(0, 0.15)
    x = x * uneven.where(some & draw.often(0.5), 0.0).exp()
    cell = 2 + int(torch.randint(7, (), generator=torch.Generator().manual_seed(seed)))
    mottle = draw.field(1, cell, height, width) * draw.uniform(0, 0.06)
    x = x * (1 + mottle.where(some & draw.often(0.3), 0.0))
    ink = draw.uniform(0, 0.25, (3, 1, 1)).where(draw.often(0.85), draw.uniform(0.75, 1))
    opacity = _dots(draw, height, width) * draw.uniform(0.5, 1)
    x = torch.lerp(x, ink.expand_as(x), opacity.where(some & draw.often(0.2), 0.0).expand_as(x))
    x = _blurred(x, draw.uniform(0.3, 1.1)).where(some & draw.often(0.3), x)
    # Less where there is less light: it would hide what a dark picture shows.
    noise = torch.randn(x.shape, generator=draw.generator, device=x.device)
    return (x + noise * draw.uniform() ** 4 * 0.06 * x.mean(dim=(1, 2, 3), keepdim=True)).clamp(0, 1)
