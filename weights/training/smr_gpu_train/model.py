"""SMR-Net: a ResNet-34 with CBAM, dilated multi-scale fusion, softmax re-weighting, and a Faster R-CNN head.

A parameter's name here is its tensor's name in the weight file.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision import ops

from . import boxes as bx
from . import pose
from .config import Config
from .gates import PoolChannels, PoolSpace, ScaleChannels, ScaleSpace


# Of propose_batch. Chains of boxes each of which alone covers the next are hardly ever longer.
NMS_ROUNDS = 16
# IoU above which other boxes of its class move a detection.
VOTE_IOU = 0.7


def autocast(device: str) -> torch.autocast:
    """bfloat16 where the device computes in it: emulated, it takes several times as long as float32."""
    native = device != "cpu" or torch.ops.mkldnn._is_mkldnn_bf16_supported()
    return torch.autocast(device, dtype=torch.bfloat16, enabled=native)


class ChannelGate(nn.Module):
    def __init__(self, channels: int, reduction: int):
        super().__init__()
        self.fc1 = nn.Linear(channels, channels // reduction)
        self.fc2 = nn.Linear(channels // reduction, channels)
        # The bias counts twice (average and maximum): the gate starts at sigmoid(2), open.
        nn.init.constant_(self.fc2.bias, 1.0)

    def forward(self, x: Tensor) -> Tensor:
        pooled = PoolSpace.apply(x)
        gate = self.fc2(F.relu(self.fc1(pooled))).sum(dim=0).sigmoid()
        return ScaleChannels.apply(x, gate)


class SpatialGate(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(2, 1, 7, padding=3, bias=False)
        self.bn = nn.BatchNorm2d(1)
        nn.init.constant_(self.bn.bias, 2.0)

    def forward(self, x: Tensor) -> Tensor:
        return ScaleSpace.apply(x, self.bn(self.conv(PoolChannels.apply(x))).sigmoid())


class Cbam(nn.Module):
    """Woo et al. 2018: a channel gate, then a spatial gate."""

    def __init__(self, channels: int, reduction: int):
        super().__init__()
        self.channel = ChannelGate(channels, reduction)
        self.spatial = SpatialGate()

    def forward(self, x: Tensor) -> Tensor:
        return self.spatial(self.channel(x))


class BasicBlock(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )
        # Each block starts as the identity (Goyal et al. 2017).
        nn.init.zeros_(self.bn2.weight)

    def forward(self, x: Tensor) -> Tensor:
        identity = x if self.downsample is None else self.downsample(x)
        y = F.relu(self.bn1(self.conv1(x)))
        return F.relu(self.bn2(self.conv2(y)) + identity)


class Backbone(nn.Module):
    """SAFE-Net: a ResNet of basic blocks, ResNet-34 by default, with a CBAM after conv1 and after each stage."""

    def __init__(self, config: Config):
        super().__init__()
        self.conv1 = nn.Conv2d(3, config.stem, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(config.stem)
        inputs = config.stem
        for i, (outputs, blocks) in enumerate(zip(config.channels, config.blocks, strict=True), start=1):
            if i == 4 and not config.variant.msff:
                break  # without the fusion nothing reads conv5_x
            stride = 1 if i == 1 else 2
            stage = [BasicBlock(inputs, outputs, stride)]
            stage += [BasicBlock(outputs, outputs, 1) for _ in range(blocks - 1)]
            setattr(self, f"layer{i}", nn.Sequential(*stage))
            inputs = outputs
        if config.variant.safe:
            for i, channels in enumerate([config.stem, *config.channels], start=1):
                if i == 5 and not config.variant.msff:
                    break
                setattr(self, f"cbam{i}", Cbam(channels, config.reduction))
        for m in self.modules():
            if isinstance(m, nn.Conv2d) and m.out_channels > 1:
                nn.init.kaiming_normal_(m.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor, stages: dict, scales: int) -> None:
        """Puts backbone.conv1, .cbam1, .layer1, .cbam2, … into `stages`; of conv3_x, conv4_x and conv5_x the first `scales`."""
        x = stages["backbone.conv1"] = F.relu(self.bn1(self.conv1(x)))
        for i in range(1, 3 + scales):
            if i > 1:
                if not hasattr(self, f"layer{i - 1}"):
                    break
                x = stages[f"backbone.layer{i - 1}"] = getattr(self, f"layer{i - 1}")(x)
            if hasattr(self, f"cbam{i}"):
                x = getattr(self, f"cbam{i}")(x)
            stages[f"backbone.cbam{i}"] = x
            if i == 1:
                x = stages["backbone.maxpool"] = F.max_pool2d(x, 3, 2, 1)


class Branch(nn.Module):
    def __init__(self, inputs: int, outputs: int, dilation: int, reduction: int):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation, bias=False)
        self.bn = nn.BatchNorm2d(outputs)
        self.cbam = Cbam(outputs, reduction)
        nn.init.kaiming_normal_(self.conv.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor, size: tuple[int, int]) -> Tensor:
        x = self.cbam(F.relu(self.bn(self.conv(x))))
        if x.shape[2:] != size:
            x = F.interpolate(x, size, mode="bilinear", align_corners=False)
        return x


class Fusion(nn.Module):
    """MSFF-Net: three scales brought to one number of channels and to stride 8."""

    def __init__(self, config: Config):
        super().__init__()
        for i, (inputs, dilation) in enumerate(zip(config.channels[1:], (1, 2, 2)), start=1):
            setattr(self, f"branch{i}", Branch(inputs, config.fused, dilation, config.reduction))
        if not config.variant.rw:
            self.reduce = nn.Conv2d(3 * config.fused, config.fused, 1)

    def forward(self, stages: dict, scales: int) -> list[Tensor]:
        size = stages["backbone.cbam3"].shape[2:]
        maps = []
        for i in range(1, scales + 1):
            branch = getattr(self, f"branch{i}")
            maps.append(branch(stages[f"backbone.cbam{i + 2}"], size))
            stages[f"fusion.branch{i}"] = maps[-1]
        return maps


class Reweight(nn.Module):
    """RW-Net: one softmax weight a scale and picture.

    Without the deepest scale its share of the concatenation is zero, and the softmax is over the others.
    """

    def __init__(self, config: Config):
        super().__init__()
        for i in (1, 2, 3):
            setattr(self, f"reduce{i}", nn.Conv2d(config.fused, config.reweight, 1))
        self.fc1 = nn.Linear(3 * config.reweight, config.reweight)
        self.fc2 = nn.Linear(config.reweight, 3)

    def forward(self, maps: list[Tensor]) -> Tensor:
        # A 1x1 convolution commutes with the mean over space, so pool first.
        parts = [
            getattr(self, f"reduce{i}")(m.mean(dim=(2, 3), keepdim=True)).flatten(1)
            for i, m in enumerate(maps, start=1)
        ]
        pooled = torch.cat(parts, dim=1)
        x = F.relu(F.linear(pooled, self.fc1.weight[:, : pooled.shape[1]], self.fc1.bias))
        return F.linear(x, self.fc2.weight[: len(maps)], self.fc2.bias[: len(maps)]).softmax(dim=1)


class Rpn(nn.Module):
    def __init__(self, channels: int, anchors: int, own: bool):
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1) if own else None
        if self.conv is not None:
            nn.init.kaiming_normal_(self.conv.weight, nonlinearity="relu")
            nn.init.zeros_(self.conv.bias)  # type: ignore[arg-type]
        self.cls = nn.Conv2d(channels, anchors, 1)
        self.bbox = nn.Conv2d(channels, 4 * anchors, 1)
        for layer in (self.cls, self.bbox):
            nn.init.normal_(layer.weight, std=0.01)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]


class RoiHead(nn.Module):
    def __init__(self, config: Config):
        super().__init__()
        classes, width = len(config.classes) + 1, config.head
        self.fc6 = nn.Linear(config.width * 7 * 7, width)
        self.fc7 = nn.Linear(width, width)
        self.cls_score = nn.Linear(width, classes)
        self.bbox_pred = nn.Linear(width, 4 * classes)
        self.pose = nn.Linear(width, pose.OUTPUTS) if config.pose else None
        nn.init.kaiming_normal_(self.fc6.weight, nonlinearity="relu")
        nn.init.kaiming_normal_(self.fc7.weight, nonlinearity="relu")
        nn.init.normal_(self.cls_score.weight, std=0.01)
        nn.init.normal_(self.bbox_pred.weight, std=0.001)
        if self.pose is not None:
            nn.init.normal_(self.pose.weight, std=0.01)
        for layer in (self.fc6, self.fc7, self.cls_score, self.bbox_pred, *([self.pose] if self.pose else [])):
            nn.init.zeros_(layer.bias)

    def forward(self, pooled: Tensor, stages: dict) -> "Heads":
        x = stages["roi_head.fc6"] = F.relu(self.fc6(pooled.flatten(1)))
        x = stages["roi_head.fc7"] = F.relu(self.fc7(x))
        stages["roi_head.cls_score"] = self.cls_score(x)
        stages["roi_head.bbox_pred"] = self.bbox_pred(x)
        if self.pose is not None:
            stages["roi_head.pose"] = self.pose(x)
        return Heads(stages["roi_head.cls_score"], stages["roi_head.bbox_pred"], stages.get("roi_head.pose"))


@dataclass
class Heads:
    """What the RoI head says of each region, as it leaves the last layers."""

    scores: Tensor  # [R, classes + 1], logits
    regression: Tensor  # [R, 4 (classes + 1)]
    pose: Tensor | None  # [R, pose.OUTPUTS]

    def rows(self, part: slice) -> "Heads":
        return Heads(self.scores[part], self.regression[part], None if self.pose is None else self.pose[part])


class SmrNet(nn.Module):
    def __init__(self, config: Config):
        super().__init__()
        self.config = config
        self.backbone = Backbone(config)
        if config.variant.msff:
            self.fusion = Fusion(config)
            if config.variant.rw:
                self.reweight = Reweight(config)
        self.cells = bx.cell_anchors(config.anchor_sizes, config.anchor_ratios)
        self.rpn = Rpn(config.width, len(self.cells), config.variant.rpn_conv)
        self.roi_head = RoiHead(config)

    def features(self, images: Tensor, stages: dict, scales: int = 3) -> Tensor:
        """The fused map, [B, C, H/stride, W/stride], of normalised pictures [B, 3, H, W], from F1, F2 and F3 or the first `scales` of them."""
        stages["input"] = images
        self.backbone(images, stages, scales)
        if not self.config.variant.msff:
            fused = stages["backbone.cbam4"]
        else:
            maps = self.fusion(stages, scales)
            if self.config.variant.rw:
                weights = stages["reweight.weights"] = self.reweight(maps)
                fused = sum(weights[:, i, None, None, None] * maps[i] for i in range(scales))
            else:
                fused = self.fusion.reduce(torch.cat(maps, dim=1))
        stages["fusion.fused"] = fused
        return fused

    def rpn_heads(self, fused: Tensor, stages: dict) -> tuple[Tensor, Tensor, Tensor]:
        """Objectness logits [B, N], deltas [B, N, 4] and anchors [N, 4], in the order (y, x, anchor)."""
        seen = fused if self.rpn.conv is None else F.relu(self.rpn.conv(fused))
        logits = stages["rpn.cls"] = self.rpn.cls(seen)
        deltas = stages["rpn.bbox"] = self.rpn.bbox(seen)
        batch, count, height, width = logits.shape
        logits = logits.permute(0, 2, 3, 1).reshape(batch, -1)
        deltas = deltas.view(batch, count, 4, height, width).permute(0, 3, 4, 1, 2).reshape(batch, -1, 4)
        dtype = torch.promote_types(fused.dtype, torch.float32)
        cells = self.cells.to(fused.device, dtype)
        return logits, deltas, bx.grid_anchors(cells, height, width, self.config.stride)

    @torch.no_grad()
    def regions(self, images: Tensor, stages: dict, scales: int = 3) -> list[tuple[Tensor, Heads]]:
        """Each normalised picture's proposals [P, 4] and what the head says of them."""
        fused = self.features(images, stages, scales)
        logits, deltas, anchors = self.rpn_heads(fused, stages)
        picked = [propose(l, d, anchors, images.shape[2:]) for l, d in zip(logits, deltas)]
        stages["proposals"], stages["proposal_scores"] = picked[0]
        proposals = [p for p, _ in picked]
        pooled = ops.roi_align(fused, proposals, 7, 1 / self.config.stride, sampling_ratio=2, aligned=True)
        stages["roi_head.pool"] = pooled
        heads = self.roi_head(pooled, stages)
        ends = [0, *itertools.accumulate(map(len, proposals))]
        return [(p, heads.rows(slice(*ends[i : i + 2]))) for i, p in enumerate(proposals)]

    @torch.no_grad()
    def detect(self, images: Tensor, stages: dict | None = None, score: float = 0.05, nms: float = 0.5, scales: int = 3) -> list[dict]:
        """Detections of each normalised picture: boxes [K, 4] in input pixels, scores [K], labels [K] and, with pose heads, `pose.decode`'s.

        `stages`, if given, receives every stage's tensor; then the batch must be one picture.
        """
        stages = {} if stages is None else stages
        size = images.shape[2:]
        result = [classify(self.config, heads, p, size, score, nms) for p, heads in self.regions(images, stages, scales)]
        stages.update({f"detections.{name}": tensor for name, tensor in result[0].items()})
        return result


@torch.no_grad()
def propose(logits: Tensor, deltas: Tensor, anchors: Tensor, size: Sequence[int], before: int = 1000, after: int = 100) -> tuple[Tensor, Tensor]:
    """One picture's proposals [P, 4] and their scores [P]: top `before`, clip, NMS at 0.7, top `after`."""
    logits, deltas = logits.to(anchors.dtype), deltas.to(anchors.dtype)
    top, index = logits.topk(min(before, len(logits)))
    proposals = bx.decode(deltas[index], anchors[index], bx.RPN_WEIGHTS)
    proposals, scores = ops.clip_boxes_to_image(proposals, size), top.sigmoid()
    keep = ops.remove_small_boxes(proposals, 1e-3)
    proposals, scores = proposals[keep], scores[keep]
    keep = ops.nms(proposals, scores, 0.7)[:after]
    return proposals[keep], scores[keep]


@torch.no_grad()
def propose_batch(logits: Tensor, deltas: Tensor, anchors: Tensor, size: Sequence[int], before: int, after: int) -> tuple[Tensor, Tensor]:
    """`propose` of a batch without a loop over its pictures: proposals [B, after, 4], best first, and which of them there are."""
    top, index = logits.topk(min(before, logits.shape[1]), dim=1)
    boxes = bx.decode(bx.rows(deltas, index), anchors[index], bx.RPN_WEIGHTS)
    boxes = ops.clip_boxes_to_image(boxes, size)
    there = (boxes[..., 2:] - boxes[..., :2]).amin(dim=2) >= 1e-3
    # NMS: a box goes if a better one that stays covers it. Rounds of this settle from the best box down.
    better = torch.ones(top.shape[1], top.shape[1], dtype=torch.bool, device=top.device).triu(1)
    covers = (bx.iou(boxes, boxes) > 0.7) & better & there[:, :, None]
    keep = there
    for _ in range(NMS_ROUNDS):
        keep = there & ~(covers & keep[:, :, None]).any(dim=1)
    rank = torch.arange(top.shape[1], 0, -1, device=top.device)
    left, index = (rank * keep).topk(min(after, top.shape[1]), dim=1)
    return bx.rows(boxes, index), left > 0


@dataclass
class Survivors:
    """One picture's detections, best first: what NMS within a class leaves of its boxes."""

    boxes: Tensor  # [K, 4], after the vote
    scores: Tensor  # [K]
    labels: Tensor  # [K]
    rows: Tensor  # [K], the region that each came from
    pose: Tensor | None  # [K, pose.OUTPUTS], after the vote


def vote(rows: Tensor, boxes: Tensor, scores: Tensor, labels: Tensor, keep: Tensor) -> Tensor:
    """The rows [N, M] of the kept [K] of N boxes, each moved to a mean of those of its class that overlap with it, [K, M].

    Box voting (Gidaris and Komodakis 2015, section 4.3), with weights that begin at 0: score (IoU - t) / (1 - t).
    """
    overlap = ops.box_iou(boxes[keep], boxes)
    weights = scores * (overlap - VOTE_IOU).clamp(min=0) / (1 - VOTE_IOU)
    weights = weights.where(labels[keep][:, None] == labels, 0.0).nan_to_num()
    weights[torch.arange(len(keep), device=keep.device), keep] = scores[keep]
    far = rows[None] - rows[keep][:, None]
    return rows[keep] + (weights[..., None] * far).sum(dim=1) / weights.sum(dim=1, keepdim=True)


def survivors(config: Config, heads: Heads, proposals: Tensor, size: Sequence[int], threshold: float, nms: float) -> Survivors:
    """From the head's outputs: a box for each class, NMS within a class, the best 100, the vote."""
    proposals = proposals.to(heads.scores.dtype)
    logits = heads.scores / config.temperature
    probability = logits.softmax(dim=1)
    # By how much a class is above all others: the score's logit, by which to order, as scores close to 1 are equal.
    own = torch.eye(logits.shape[1], dtype=torch.bool, device=logits.device)
    margin = logits - logits[:, None].masked_fill(own, -torch.inf).logsumexp(dim=2)
    found = bx.decode(heads.regression.view(len(proposals), -1, 4), proposals[:, None], bx.ROI_WEIGHTS)
    found = ops.clip_boxes_to_image(found, size)
    labels = torch.arange(probability.shape[1], device=probability.device).expand_as(probability)
    rows = torch.arange(len(proposals), device=probability.device)[:, None].expand_as(probability)
    # Class 0 is the background.
    found, margin = found[:, 1:].reshape(-1, 4), margin[:, 1:].flatten()
    probability, labels, rows = (of[:, 1:].flatten() for of in (probability, labels, rows))
    keep = torch.where(probability > threshold)[0]
    keep = keep[ops.remove_small_boxes(found[keep], 1e-2)]
    keep = torch.cat([c[ops.nms(found[c], margin[c], nms)] for c in (keep[labels[keep] == label] for label in labels[keep].unique())] or [keep])
    # Best first; equals keep the order (proposal, class) they came in.
    keep = keep.sort().values
    keep = keep[margin[keep].argsort(descending=True, stable=True)][:100]
    candidates = found, probability, labels, keep
    turned = None if heads.pose is None else vote(heads.pose.to(found.dtype)[rows], *candidates)
    return Survivors(vote(found, *candidates), probability[keep], labels[keep], rows[keep], turned)


def classify(config: Config, heads: Heads, proposals: Tensor, size: Sequence[int], threshold: float, nms: float) -> dict[str, Tensor]:
    """One picture's detections from the head's outputs, as `SmrNet.detect` gives them."""
    found = survivors(config, heads, proposals, size, threshold, nms)
    result = {"boxes": found.boxes, "scores": found.scores, "labels": found.labels}
    if found.pose is not None:
        directed = torch.tensor([False, *(c in config.directed for c in config.classes)], device=proposals.device)
        result |= pose.decode(found.pose, directed[found.labels])
    return result
