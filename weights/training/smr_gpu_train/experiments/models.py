"""The networks behind one contract: `losses` of a batch of views with their truth, `find` of a picture.

All begin with random weights: there is no ImageNet file here, for any of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby

import torch
from torch import Tensor, nn
from torchvision import models as tv
from torchvision import ops

from .. import boxes as bx
from ..config import ANCHOR_RATIOS, ANCHOR_SIZES, FASTER_RCNN, NETWORKS, Config, Variant
from ..data import network_input, normalise
from ..losses import detection_losses, roi_loss, sample_rois
from ..model import Backbone, Cbam, Heads, SmrNet, autocast, classify
from ..pictures import Entry
from ..truth import Truth
from .plan import Row

SCALE_PER_MM = 8.0
HEAD = 1024  # torchvision's width of the head's two layers; the original's 4096 would have three quarters of all weights
Proposals = tuple[Tensor, Tensor]  # boxes [B, P, 4], and which of them there are


class Ablated(SmrNet):
    """SMR-Net with what a weight file has no switch for."""

    def __init__(self, config: Config, dilation: bool, every_block: bool):
        super().__init__(config)
        if not dilation and config.variant.msff:
            for conv in (m for m in self.fusion.modules() if isinstance(m, nn.Conv2d) and m.dilation == (2, 2)):
                conv.dilation = conv.padding = (1, 1)
        if every_block:
            # The stage's own CBAM follows its last block.
            for i, channels in enumerate(config.channels, start=1):
                blocks = getattr(self.backbone, f"layer{i}", ())
                attended = [nn.Sequential(block, Cbam(channels, config.reduction)) for block in blocks[:-1]] + [*blocks[-1:]]
                if attended:
                    setattr(self.backbone, f"layer{i}", nn.Sequential(*attended))


class Faster(SmrNet):
    """Faster R-CNN (Ren et al. 2015) on conv4_x of ResNet-34, which is a variant of SMR-Net, or on conv5_3 of VGG-16; stride 16 both.

    VGG-16 is torchvision's with batch norm, without which it hardly learns from random weights. Anchors, input, losses,
    RoIAlign and what follows it are SMR-Net's.
    """

    def __init__(self, config: Config, backbone: str):
        super().__init__(config)
        if backbone == "vgg16":
            self.backbone = tv.vgg16_bn(weights=None).features[:-1]

    def features(self, images: Tensor, stages: dict, scales: int = 3) -> Tensor:
        if isinstance(self.backbone, Backbone):
            return super().features(images, stages, scales)
        fused: Tensor = self.backbone(images)
        stages["fusion.fused"] = fused
        return fused


class Fast(Faster):
    """Fast R-CNN (Girshick 2015): the same without an RPN; its regions come from outside."""

    def __init__(self, config: Config, backbone: str):
        super().__init__(config, backbone)
        del self.rpn

    def rpn_heads(self, fused: Tensor, stages: dict) -> tuple[Tensor, Tensor, Tensor]:
        raise NotImplementedError("Fast R-CNN has no RPN")

    def losses(self, images: Tensor, truth: Truth, proposals: Proposals) -> dict[str, Tensor]:
        with autocast(images.device.type):
            fused = self.features(images, {})
        rois = sample_rois(*proposals, truth)
        with autocast(images.device.type):
            heads = self.roi_head(bx.roi_align_dense(fused, rois.boxes, 1 / self.config.stride), {})
        classification, box = roi_loss(Heads(heads.scores.float(), heads.regression.float(), None), rois.flat())
        return {"class": classification, "roi_box": box}

    def heads_of(self, images: Tensor, boxes: Tensor) -> Heads:
        """Of one normalised picture [1, 3, H, W] and its regions [P, 4]."""
        pooled = ops.roi_align(self.features(images, {}), [boxes], 7, 1 / self.config.stride, sampling_ratio=2, aligned=True)
        heads: Heads = self.roi_head(pooled, {})
        return heads


def configuration(row: Row, network: str, mean: list[float], std: list[float], pose: bool) -> Config:
    """Anchors, input scale, mean and deviation are all networks'."""
    own = dict(pixels_per_mm=SCALE_PER_MM, mean=mean, std=std, anchor_sizes=ANCHOR_SIZES, anchor_ratios=ANCHOR_RATIOS)
    if row.model == "smr":
        return Config(**own, variant=Variant(row.safe, row.msff, row.rw), pose=pose, **NETWORKS[network])  # type: ignore[arg-type]
    # Without MSFF-Net stride and width are those of the third stage.
    channels = [64, 128, 512, 512] if row.backbone == "vgg16" else [64, 128, 256, 512]
    return Config(**own, variant=FASTER_RCNN, channels=channels, head=HEAD)  # type: ignore[arg-type]


def maker(row: Row) -> Callable[[Config], SmrNet]:
    if row.in_a_weight_file:
        return SmrNet
    if row.model in ("faster", "fast"):
        return partial({"faster": Faster, "fast": Fast}[row.model], backbone=row.backbone)
    return partial(Ablated, dilation=row.dilation, every_block=row.every_block)


def losses(model: SmrNet, images: Tensor, truth: Truth, proposals: Proposals | None) -> dict[str, Tensor]:
    """The weighted losses of a batch of normalised views."""
    if isinstance(model, Fast):
        assert proposals is not None
        return model.losses(images, truth, proposals)
    return detection_losses(model, images, truth)


@dataclass
class Seen:
    """A picture as the networks read it."""

    pixels: Tensor  # [3, H, W], 0 to 255
    ratio: tuple[float, float]  # the gel's pixels a pixel, along x and y
    size: tuple[int, int]  # of the gel, height and width


def see(entry: Entry, scale: float = 1.0) -> Seen:
    """`scale` is beside the scale that the networks have learnt."""
    return Seen(*network_input(entry.pixels(), SCALE_PER_MM * entry.mm_per_pixel * scale), entry.size)


BATCH = 16  # pictures of one size at once on a card, which waits for its commands otherwise


@torch.no_grad()
def find(model: SmrNet, pictures: Sequence[Seen], device: str, regions: Sequence[Tensor] | None = None) -> list[dict[str, Tensor]]:
    """Detections of each picture, best first, down to a score of 0.05, boxes in pixels of its gel; `regions` [P, 4] of each are shares of its sides."""
    config, found = model.config, list[dict[str, Tensor]]()
    at_once = BATCH if device != "cpu" and regions is None else 1
    of_one_size = ([*group] for _, group in groupby(pictures, lambda seen: seen.pixels.shape))
    for part in (group[i : i + at_once] for group in of_one_size for i in range(0, len(group), at_once)):
        images = normalise(torch.stack([seen.pixels for seen in part]).to(device), config.mean, config.std).contiguous(memory_format=torch.channels_last)
        if isinstance(model, Fast):
            assert regions is not None
            (x, y), (height, width) = part[0].ratio, part[0].size
            boxes = regions[len(found)].to(device, torch.float32) * torch.tensor([width / x, height / y] * 2, device=device)
            results = [classify(config, model.heads_of(images, boxes), boxes, images.shape[2:], 0.05, 0.5)]
        else:
            results = model.detect(images)
        for seen, result in zip(part, results, strict=True):
            one = {name: result[name].cpu() for name in ("boxes", "scores", "labels")}
            one["boxes"] = one["boxes"] * torch.tensor([*seen.ratio, *seen.ratio])
            found.append(one)
    return found


def truth_of(entry: Entry) -> dict:
    """What a picture shows, as metrics.py reads it."""
    return {"boxes": torch.from_numpy(entry.snaps.boxes), "labels": torch.from_numpy(entry.snaps.labels), "mm_per_pixel": entry.mm_per_pixel}
