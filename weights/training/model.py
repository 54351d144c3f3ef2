"""SMR-Net: a ResNet-34 with CBAM, dilated multi-scale fusion, softmax re-weighting, and a Faster R-CNN head.

A parameter's name here is its tensor's name in the weight file.
"""

from dataclasses import asdict, dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision import ops

import boxes as bx
from gates import PoolChannels, PoolSpace, ScaleChannels, ScaleSpace


@dataclass
class Variant:
    """The switches of the paper's ablations."""

    safe: bool = True
    msff: bool = True
    rw: bool = True


@dataclass
class Config:
    """All that a reader of the weight file must know beside the tensors."""

    input_size: int = 320
    mean: list[float] = field(default_factory=lambda: [0.5, 0.5, 0.5])
    std: list[float] = field(default_factory=lambda: [0.2, 0.2, 0.2])
    classes: list[str] = field(default_factory=lambda: ["A", "B"])
    anchor_sizes: list[float] = field(default_factory=lambda: [32.0, 48.0, 72.0])
    anchor_ratios: list[float] = field(default_factory=lambda: [0.5, 1.0, 2.0])
    variant: Variant = field(default_factory=Variant)
    mm_per_pixel: float = 0.04
    picture_size: int = 1000
    reduction: int = 16

    @property
    def stride(self) -> int:
        return 8 if self.variant.msff else 16

    def to_dict(self) -> dict:
        return {"format": 1, **asdict(self), "stride": self.stride}

    @staticmethod
    def from_dict(d: dict) -> "Config":
        d = {k: v for k, v in d.items() if k in Config.__dataclass_fields__}
        return Config(**{**d, "variant": Variant(**d["variant"])})


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
    def __init__(self):
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
    """SAFE-Net: ResNet-34 with a CBAM after conv1 and after each stage."""

    def __init__(self, config: Config):
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        inputs = 64
        for i, (outputs, blocks) in enumerate([(64, 3), (128, 4), (256, 6), (512, 3)], start=1):
            if i == 4 and not config.variant.msff:
                break  # without the fusion nothing reads conv5_x
            stride = 1 if i == 1 else 2
            stage = [BasicBlock(inputs, outputs, stride)]
            stage += [BasicBlock(outputs, outputs, 1) for _ in range(blocks - 1)]
            setattr(self, f"layer{i}", nn.Sequential(*stage))
            inputs = outputs
        if config.variant.safe:
            for i, channels in enumerate([64, 64, 128, 256, 512], start=1):
                if i == 5 and not config.variant.msff:
                    break
                setattr(self, f"cbam{i}", Cbam(channels, config.reduction))
        for m in self.modules():
            if isinstance(m, nn.Conv2d) and m.out_channels > 1:
                nn.init.kaiming_normal_(m.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor, stages: dict) -> None:
        """Puts backbone.conv1, .cbam1, .layer1, .cbam2, … into `stages`."""
        x = stages["backbone.conv1"] = F.relu(self.bn1(self.conv1(x)))
        for i in range(1, 6):
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
    def __init__(self, channels: int, dilation: int, reduction: int):
        super().__init__()
        self.conv = nn.Conv2d(channels, 256, 3, padding=dilation, dilation=dilation, bias=False)
        self.bn = nn.BatchNorm2d(256)
        self.cbam = Cbam(256, reduction)
        nn.init.kaiming_normal_(self.conv.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor, size: tuple[int, int]) -> Tensor:
        x = self.cbam(F.relu(self.bn(self.conv(x))))
        if x.shape[2:] != size:
            x = F.interpolate(x, size, mode="bilinear", align_corners=False)
        return x


class Fusion(nn.Module):
    """MSFF-Net: three scales brought to 256 channels and to stride 8."""

    def __init__(self, config: Config):
        super().__init__()
        self.branch1 = Branch(128, 1, config.reduction)
        self.branch2 = Branch(256, 2, config.reduction)
        self.branch3 = Branch(512, 2, config.reduction)
        if not config.variant.rw:
            self.reduce = nn.Conv2d(768, 256, 1)

    def forward(self, stages: dict) -> list[Tensor]:
        size = stages["backbone.cbam3"].shape[2:]
        maps = []
        for i in (1, 2, 3):
            branch = getattr(self, f"branch{i}")
            maps.append(branch(stages[f"backbone.cbam{i + 2}"], size))
            stages[f"fusion.branch{i}"] = maps[-1]
        return maps


class Reweight(nn.Module):
    """RW-Net: one softmax weight a scale and picture."""

    def __init__(self):
        super().__init__()
        for i in (1, 2, 3):
            setattr(self, f"reduce{i}", nn.Conv2d(256, 64, 1))
        self.fc1 = nn.Linear(192, 64)
        self.fc2 = nn.Linear(64, 3)

    def forward(self, maps: list[Tensor]) -> Tensor:
        # A 1x1 convolution commutes with the mean over space, so pool first.
        pooled = [
            getattr(self, f"reduce{i}")(m.mean(dim=(2, 3), keepdim=True)).flatten(1)
            for i, m in enumerate(maps, start=1)
        ]
        return self.fc2(F.relu(self.fc1(torch.cat(pooled, dim=1)))).softmax(dim=1)


class Rpn(nn.Module):
    def __init__(self, anchors: int):
        super().__init__()
        self.cls = nn.Conv2d(256, anchors, 1)
        self.bbox = nn.Conv2d(256, 4 * anchors, 1)
        for layer in (self.cls, self.bbox):
            nn.init.normal_(layer.weight, std=0.01)
            nn.init.zeros_(layer.bias)


class RoiHead(nn.Module):
    def __init__(self, classes: int):
        super().__init__()
        self.fc6 = nn.Linear(256 * 7 * 7, 512)
        self.fc7 = nn.Linear(512, 512)
        self.cls_score = nn.Linear(512, classes + 1)
        self.bbox_pred = nn.Linear(512, 4 * (classes + 1))
        nn.init.kaiming_normal_(self.fc6.weight, nonlinearity="relu")
        nn.init.kaiming_normal_(self.fc7.weight, nonlinearity="relu")
        nn.init.zeros_(self.fc6.bias)
        nn.init.zeros_(self.fc7.bias)
        nn.init.normal_(self.cls_score.weight, std=0.01)
        nn.init.normal_(self.bbox_pred.weight, std=0.001)
        nn.init.zeros_(self.cls_score.bias)
        nn.init.zeros_(self.bbox_pred.bias)

    def forward(self, pooled: Tensor, stages: dict) -> tuple[Tensor, Tensor]:
        x = stages["roi_head.fc6"] = F.relu(self.fc6(pooled.flatten(1)))
        x = stages["roi_head.fc7"] = F.relu(self.fc7(x))
        stages["roi_head.cls_score"] = self.cls_score(x)
        stages["roi_head.bbox_pred"] = self.bbox_pred(x)
        return stages["roi_head.cls_score"], stages["roi_head.bbox_pred"]


class SmrNet(nn.Module):
    def __init__(self, config: Config):
        super().__init__()
        self.config = config
        self.backbone = Backbone(config)
        if config.variant.msff:
            self.fusion = Fusion(config)
            if config.variant.rw:
                self.reweight = Reweight()
        self.cells = bx.cell_anchors(config.anchor_sizes, config.anchor_ratios)
        self.rpn = Rpn(len(self.cells))
        self.roi_head = RoiHead(len(config.classes))

    def features(self, images: Tensor, stages: dict) -> Tensor:
        """The fused map, [B, 256, S/stride, S/stride], of normalised pictures [B, 3, S, S]."""
        stages["input"] = images
        self.backbone(images, stages)
        if not self.config.variant.msff:
            fused = stages["backbone.cbam4"]
        else:
            maps = self.fusion(stages)
            if self.config.variant.rw:
                weights = stages["reweight.weights"] = self.reweight(maps)
                fused = sum(weights[:, i, None, None, None] * maps[i] for i in range(3))
            else:
                fused = self.fusion.reduce(torch.cat(maps, dim=1))
        stages["fusion.fused"] = fused
        return fused

    def rpn_heads(self, fused: Tensor, stages: dict) -> tuple[Tensor, Tensor, Tensor]:
        """Objectness logits [B, N], deltas [B, N, 4] and anchors [N, 4], in the order (y, x, anchor)."""
        logits = stages["rpn.cls"] = self.rpn.cls(fused)
        deltas = stages["rpn.bbox"] = self.rpn.bbox(fused)
        batch, count, height, width = logits.shape
        logits = logits.permute(0, 2, 3, 1).reshape(batch, -1)
        deltas = deltas.view(batch, count, 4, height, width).permute(0, 3, 4, 1, 2).reshape(batch, -1, 4)
        dtype = torch.promote_types(fused.dtype, torch.float32)
        cells = self.cells.to(fused.device, dtype)
        return logits, deltas, bx.grid_anchors(cells, height, width, self.config.stride)

    @torch.no_grad()
    def detect(self, images: Tensor, stages: dict | None = None, score: float = 0.05, nms: float = 0.5) -> list[dict]:
        """Detections of each normalised picture: boxes [K, 4] in input pixels, scores [K], labels [K].

        `stages`, if given, receives every stage's tensor; then the batch must be one picture.
        """
        stages = {} if stages is None else stages
        fused = self.features(images, stages)
        logits, deltas, anchors = self.rpn_heads(fused, stages)
        size = images.shape[2:]
        picked = [propose(l, d, anchors, size) for l, d in zip(logits, deltas)]
        stages["proposals"], stages["proposal_scores"] = picked[0]
        proposals = [p for p, _ in picked]
        pooled = ops.roi_align(fused, proposals, 7, 1 / self.config.stride, sampling_ratio=2, aligned=True)
        stages["roi_head.pool"] = pooled
        scores, regression = self.roi_head(pooled, stages)
        result, at = [], 0
        for p in proposals:
            part = slice(at, at + len(p))
            result.append(classify(scores[part], regression[part], p, size, score, nms))
            at += len(p)
        stages["detections.boxes"], stages["detections.scores"], stages["detections.labels"] = (
            result[0]["boxes"],
            result[0]["scores"],
            result[0]["labels"],
        )
        return result


@torch.no_grad()
def propose(logits: Tensor, deltas: Tensor, anchors: Tensor, size, before: int = 1000, after: int = 100) -> tuple[Tensor, Tensor]:
    """One picture's proposals [P, 4] and their scores [P]: top `before`, clip, NMS at 0.7, top `after`."""
    logits, deltas = logits.to(anchors.dtype), deltas.to(anchors.dtype)
    top, index = logits.topk(min(before, len(logits)))
    proposals = bx.decode(deltas[index], anchors[index], bx.RPN_WEIGHTS)
    proposals, scores = ops.clip_boxes_to_image(proposals, size), top.sigmoid()
    keep = ops.remove_small_boxes(proposals, 1e-3)
    proposals, scores = proposals[keep], scores[keep]
    keep = ops.nms(proposals, scores, 0.7)[:after]
    return proposals[keep], scores[keep]


def classify(scores: Tensor, regression: Tensor, proposals: Tensor, size, threshold: float, nms: float) -> dict:
    """One picture's detections from the head's outputs: per-class boxes, NMS within a class, the best 100."""
    proposals = proposals.to(scores.dtype)
    probability = scores.softmax(dim=1)
    found = bx.decode(regression.view(len(proposals), -1, 4), proposals[:, None], bx.ROI_WEIGHTS)
    found = ops.clip_boxes_to_image(found, size)
    labels = torch.arange(probability.shape[1], device=scores.device).expand_as(probability)
    # Class 0 is the background.
    found, probability, labels = found[:, 1:].reshape(-1, 4), probability[:, 1:].flatten(), labels[:, 1:].flatten()
    keep = torch.where(probability > threshold)[0]
    found, probability, labels = found[keep], probability[keep], labels[keep]
    keep = ops.remove_small_boxes(found, 1e-2)
    found, probability, labels = found[keep], probability[keep], labels[keep]
    keep = torch.cat([torch.where(labels == c)[0][ops.nms(found[labels == c], probability[labels == c], nms)] for c in labels.unique()]) if len(labels) else labels
    # Descending score; equal scores keep the order (proposal, class) they came in.
    keep = keep.sort().values
    keep = keep[probability[keep].argsort(descending=True, stable=True)][:100]
    return {"boxes": found[keep], "scores": probability[keep], "labels": labels[keep]}
