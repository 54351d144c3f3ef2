"""Small pictures in a device's memory, and batches of views of them, drawn and cut there at once.

A `Pool` takes parts up while it is in use. A batch depends on the pool, the step and the seed alone.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from . import boxes as bx
from .augment import photometric
from .config import Config
from .parts import JITTER, SNAPS, Part
from .truth import Truth

# Side of a step's views: one of these, down to the smallest part of a picture that the program looks at, or whole pictures in the rest of the steps.
WINDOWS = (64, 96, 128, 160, 192, 224, 256)
WHOLE_SHARE = 0.25
# Sides of whole pictures' windows, height and width or the other way round; each shape is one that a card must learn to compute.
WHOLE = ((320, 320), (384, 384), (256, 256), (256, 320), (192, 256), (320, 416), (160, 192))
MOST_VIEWS = 192
AREA = 12 * 192 * 192  # pixels of a batch for a few cores
CANDIDATES, TRIALS, PLACES = 24, 8, 3
# A cut part's upright box is its whole's clipped box only if the part stands upright or is round, or if little is cut.
LEFT_UPRIGHT, LEFT_SLANTED, UPRIGHT = 0.7, 0.9, 0.35


def cut(boxes: Tensor, labels: Tensor, yaw: Tensor, directed: Tensor, corner: Tensor, crop: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Boxes in the pixels of crops (w, h) at corners (x, y), which are kept, which are to be ignored, and which are uncut; `directed` [classes + 1] says which labels have a direction."""
    moved = (boxes - torch.cat([corner, corner], dim=-1)).clamp(min=0).minimum(torch.cat([crop, crop], dim=-1))
    area, seen = (bx.area(b) for b in (boxes, moved))
    left = seen / area.clamp(min=1e-6)
    slanted = directed[labels] & ~((2 * yaw).sin().abs() < UPRIGHT)  # an unknown direction too
    keep = (left >= torch.where(slanted, LEFT_SLANTED, LEFT_UPRIGHT)) & (labels > 0)
    return moved, keep, (seen > 0) & ~keep & (labels > 0), left > 0.995


def orient(boxes: Tensor, labels: Tensor, yaw: Tensor, whole: Tensor, keep: Tensor, ignored: Tensor, crop: Tensor, mirror: Tensor, turned: Tensor) -> Truth:
    """The crops' snaps, flipped and turned as their pixels: left for right, then top for bottom, then x for y."""
    width, height = crop[:, None, 0], crop[:, None, 1]
    x1, y1, x2, y2 = boxes.unbind(dim=-1)
    across, down, side = mirror[:, :1], mirror[:, 1:], turned[:, None]
    x1, x2, yaw = (width - x2).where(across, x1), (width - x1).where(across, x2), (torch.pi - yaw).where(across, yaw)
    y1, y2, yaw = (height - y2).where(down, y1), (height - y1).where(down, y2), (-yaw).where(down, yaw)
    boxes = torch.stack([y1, x1, y2, x2], dim=-1).where(side[..., None], torch.stack([x1, y1, x2, y2], dim=-1))
    yaw = (torch.pi / 2 - yaw).where(side, yaw)
    return Truth(boxes.where(keep[..., None], 0.0), labels.where(keep, 0), yaw, whole, boxes.where(ignored[..., None], 0.0))


class Pool:
    """Pictures of all parts so far."""

    def __init__(self, config: Config, room: int, device: str, snaps: int = SNAPS):
        """`room` is for so many pixels, `snaps` for so many of a picture."""
        self.pixels_per_mm, self.device = config.pixels_per_mm, device
        self.directed = torch.tensor([False, *(name in config.directed for name in config.classes)], device=device)
        self.pixels = torch.empty(room, 3, dtype=torch.uint8, device=device)
        self.used = 0
        self.starts = torch.empty(0, dtype=torch.long, device=device)
        self.sizes = torch.empty(0, 2, device=device)
        self.scales = torch.empty(0, device=device)
        self.snaps = torch.empty(0, snaps, 7, device=device)
        self.own, self.share = 0, 0.0  # the pictures before those that are mixed in, and the share of views that these have

    @classmethod
    def of(cls, parts: Sequence[Part], config: Config, device: str, mix: Sequence[Part] = (), share: float = 0.0) -> "Pool":
        """Of these parts, with room for them and no more; views of those of `mix` are this share of all, however many pictures there are."""
        snaps = max([SNAPS, *(part.snaps.shape[1] for part in (*parts, *mix))])
        pool = cls(config, sum(len(part.pixels) for part in (*parts, *mix)), device, snaps)
        for part in parts:
            pool.add(part)
        pool.own, pool.share = len(pool), share if mix else 0.0
        for part in mix:
            pool.add(part)
        return pool

    def __len__(self) -> int:
        return len(self.starts)

    def add(self, part: Part) -> bool:
        """False if there is no room left."""
        count = len(part.pixels)
        if self.used + count > len(self.pixels):
            return False
        self.pixels[self.used : self.used + count] = torch.from_numpy(part.pixels).to(self.device)
        starts = self.used + np.cumsum([0, *part.sizes.prod(axis=1)[:-1]])
        more = {"starts": starts, "sizes": part.sizes, "scales": part.scales, "snaps": np.pad(part.snaps, ((0, 0), (0, self.snaps.shape[1] - part.snaps.shape[1]), (0, 0)))}
        for name, values in more.items():
            have = getattr(self, name)
            setattr(self, name, torch.cat([have, torch.from_numpy(values).to(self.device, have.dtype)]))
        self.used += count
        return True

    def _integers(self, low: Tensor, high: Tensor, generator: torch.Generator) -> Tensor:
        """Uniform whole numbers from low to high, both included."""
        drawn = torch.rand(low.shape, generator=generator, device=self.device)
        return (low + (drawn * (high - low + 1)).floor()).minimum(high)

    def _choose(self, count: int, window: tuple[int, int], whole: bool, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Pictures [B], their sizes [B, 2] at a random scale, and which are to be turned on their side; such as fill the window."""
        shape = (count, CANDIDATES)
        if self.share:
            # First what a view is of: all its candidates are then of that, so filling the window changes no share.
            mixed = torch.rand(count, 1, generator=generator, device=self.device) < self.share
            low, high = (torch.where(mixed, those, these).expand(shape) for these, those in ((0, self.own), (self.own - 1, len(self) - 1)))
            index = self._integers(low, high, generator).long()
        else:
            index = torch.randint(len(self), shape, generator=generator, device=self.device)
        power = torch.rand(shape, generator=generator, device=self.device) * 2 - 1
        scale = self.pixels_per_mm * JITTER**power / self.scales[index]
        sizes = (self.sizes[index] * scale[..., None]).round().clamp(min=1)
        turned = torch.rand(shape, generator=generator, device=self.device) < 0.5
        seen = sizes.flip(-1).where(turned[..., None], sizes)
        ratios = (seen / 32).ceil() * 32 / torch.tensor(window, device=self.device)
        # Whole pictures that are nearly whole in the window; else such as fill it.
        filled = (ratios.minimum(1 / ratios) if whole else ratios.clamp(max=1)).amin(dim=-1)
        best = filled.argmax(dim=1, keepdim=True)  # the first of the best
        return index.gather(1, best)[:, 0], bx.rows(sizes, best)[:, 0], turned.gather(1, best)[:, 0]

    def _read(self, index: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """Bilinear samples [B, ..., 3] in 0 to 255 of each picture at points, pixel (0, 0) being centred at (0.5, 0.5)."""
        extra = [1] * (x.ndim - 1)
        height, width = (self.sizes[index, i].view(-1, *extra) for i in (0, 1))
        start = self.starts[index].view(-1, *extra)
        x, y = ((v - 0.5).clamp(min=0).minimum(side - 1) for v, side in ((x, width), (y, height)))
        left, top = x.floor(), y.floor()
        fx, fy = (x - left)[..., None], (y - top)[..., None]
        right, bottom = (left + 1).minimum(width - 1).long(), (top + 1).minimum(height - 1).long()
        left, top, width = left.long(), top.long(), width.long()
        a, b, c, d = (self.pixels[start + row * width + column].float() for row in (top, bottom) for column in (left, right))
        return torch.lerp(torch.lerp(a, b, fx), torch.lerp(c, d, fx), fy)

    def _place(self, index: Tensor, boxes: Tensor, labels: Tensor, yaw: Tensor, sizes: Tensor, crop: Tensor, generator: torch.Generator) -> Tensor:
        """Corners [B, 2] (x, y) of crops (w, h): mostly around some snap, or about what stands out."""
        batch = len(index)
        span = (sizes.flip(-1) - crop)[:, None]  # [B, 1, 2]

        def rand(*shape: int) -> Tensor:
            return torch.rand(batch, *shape, generator=generator, device=self.device)

        there = labels > 0
        which = (rand(TRIALS, boxes.shape[1]) * there[:, None]).argmax(dim=2)
        box = bx.rows(boxes, which)
        low = (box[..., 2:] - crop[:, None]).ceil().clamp(min=0).minimum(span)
        high = torch.maximum(box[..., :2].floor().minimum(span), low)
        reach = 0.3 * (box[..., 2:] - box[..., :2]) * (rand(TRIALS, 1) < 0.15)  # let the crop cut it
        low, high = (low - reach).clamp(min=0).minimum(span).floor(), (high + reach).clamp(min=0).minimum(span).floor()
        corners = self._integers(low, high, generator)
        lost = cut(boxes[:, None], labels[:, None], yaw[:, None], self.directed, corners[:, :, None], crop[:, None, None])[2].sum(dim=2)
        # Of trials that lose equally few snaps the first.
        around = bx.rows(corners, (lost + torch.arange(TRIALS, device=self.device) / TRIALS).argmin(dim=1, keepdim=True))[:, 0]
        # Look-alikes carry no box: of some places the one with most contrast.
        places = self._integers(torch.zeros_like(span).expand(-1, PLACES, -1), span.expand(-1, PLACES, -1), generator)
        grid = (torch.arange(16, device=self.device) + 0.5) / 16
        step = self.sizes[index].flip(-1) / sizes.flip(-1)
        x = (places[..., :1] + grid * crop[:, None, :1]) * step[:, None, :1]
        y = (places[..., 1:] + grid * crop[:, None, 1:]) * step[:, None, 1:]
        shape = (batch, PLACES, 16, 16)
        green = self._read(index, x[:, :, None].expand(shape), y[..., None].expand(shape))[..., 1]
        outstanding = bx.rows(places, green.flatten(2).std(dim=2).argmax(dim=1, keepdim=True))[:, 0]
        free = ~there.any(dim=1, keepdim=True) | (rand(1) < 0.1)
        return outstanding.where(free, around)

    def batch(self, step: int, area: int, seed: int) -> tuple[Tensor, Truth]:
        """Pixels [B, 3, h, w] in 0 to 255 and what they show; B * h * w is about `area`, or less where the views are small."""
        key = seed * 1_000_003 + step
        # The shape alone is drawn on the host: nothing then waits for the device.
        host = np.random.default_rng([seed, step])
        whole = host.random() < WHOLE_SHARE
        window = WHOLE[host.integers(len(WHOLE))] if whole else (int(host.choice(WINDOWS)),) * 2
        count = min(MOST_VIEWS, max(2, round(area / (window[0] * window[1]))))
        generator = torch.Generator(self.device).manual_seed(key)
        index, sizes, turned = self._choose(count, window, whole, generator)
        factor = sizes / self.sizes[index]
        table = self.snaps[index]
        boxes = table[..., :4] * factor.flip(-1).repeat(1, 2)[:, None]
        labels, yaw, uncut = table[..., 4].long(), table[..., 5], table[..., 6]
        window_size = torch.tensor(window[::-1], device=self.device, dtype=torch.float32)  # w, h
        inner = window_size.flip(0).where(turned[:, None], window_size)
        crop = inner.minimum(sizes.flip(-1))
        corner = self._place(index, boxes, labels, yaw, sizes, crop, generator)
        boxes, keep, ignored, entire = cut(boxes, labels, yaw, self.directed, corner[:, None], crop[:, None])
        mirror = torch.rand(count, 2, generator=generator, device=self.device) < 0.5
        pixels = self._pixels(index, corner, crop, factor, mirror, turned, window)
        truth = orient(boxes, labels, yaw, uncut * entire, keep, ignored, crop, mirror, turned)
        return photometric(pixels / 255, key) * 255, truth

    def _pixels(self, index: Tensor, corner: Tensor, crop: Tensor, factor: Tensor, mirror: Tensor, turned: Tensor, window: tuple[int, int]) -> Tensor:
        """The crops' pixels, flipped and turned, the right and lower edges repeated: [B, 3, h, w]."""
        samples = []
        for dy in (0.25, 0.75):
            # Four samples a pixel: a triangle filter nearly as wide as the scale.
            for dx in (0.25, 0.75):
                u = torch.arange(window[1], device=self.device).view(1, 1, -1) + dx
                v = torch.arange(window[0], device=self.device).view(1, -1, 1) + dy
                seen = crop.flip(-1).where(turned[:, None], crop)[..., None, None]
                u, v = u.minimum(seen[:, 0] - 0.5), v.minimum(seen[:, 1] - 0.5)
                u, v = torch.broadcast_tensors(u, v)
                side = turned[:, None, None]
                x, y = v.where(side, u), u.where(side, v)
                x = (crop[:, 0, None, None] - x).where(mirror[:, 0, None, None], x)
                y = (crop[:, 1, None, None] - y).where(mirror[:, 1, None, None], y)
                x = (x + corner[:, 0, None, None]) / factor[:, 1, None, None]
                y = (y + corner[:, 1, None, None]) / factor[:, 0, None, None]
                samples.append(self._read(index, x, y))
        a, b, c, d = samples
        return ((a + b + c + d) / 4).permute(0, 3, 1, 2).contiguous()
