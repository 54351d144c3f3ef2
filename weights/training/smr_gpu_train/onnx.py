"""Writes a weight file's network as ONNX, from pixels to detections.

Input `pixels` [B, 3, H, W], float32 in 0 to 255, red, green, blue: pictures at the network's scale with sides of multiples
of 32, as `data.network_input` makes them. Outputs of each picture's 100 best detections, best first, in input pixels:
`boxes` [B, 100, 4], `scores` [B, 100], `labels` [B, 100] (0: no detection), and with pose `yaw`, `yaw_std` [B, 100] in
degrees (NaN where the class has no direction), `centre_std` [B, 100, 2] in mm and `whole` [B, 100].
"""

import argparse
import json
import warnings
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision import ops

from . import boxes as bx
from . import pose, weightfile
from .data import normalise
from .errors import Failure
from .files import whole
from .model import VOTE_IOU, Cbam, SmrNet

OPSET = 18
BEFORE, AFTER, MOST = 1000, 100, 100
SCORE, NMS = 0.05, 0.5
NEVER = -1e9  # a logit


def plain_cbam(gates: Cbam, x: Tensor) -> Tensor:
    """CBAM in operations that ONNX has."""
    channel, spatial = gates.channel, gates.spatial

    def mlp(pooled: Tensor) -> Tensor:
        out: Tensor = channel.fc2(F.relu(channel.fc1(pooled.flatten(1))))
        return out

    gate = mlp(F.adaptive_avg_pool2d(x, 1)) + mlp(F.adaptive_max_pool2d(x, 1))
    x = x * gate.sigmoid()[:, :, None, None]
    pooled = torch.cat([x.amax(dim=1, keepdim=True), x.mean(dim=1, keepdim=True)], dim=1)
    out: Tensor = x * spatial.bn(spatial.conv(pooled)).sigmoid()
    return out


class Suppress(torch.autograd.Function):
    """ONNX's NonMaxSuppression: (group, 0, box) of what stays of boxes [G, N, 4] with scores [G, 1, N] above 0."""

    @staticmethod
    def forward(ctx: Any, boxes: Tensor, scores: Tensor, most: int, overlap: float) -> Tensor:
        rows = []
        for group, (own, score) in enumerate(zip(boxes, scores[:, 0])):
            there = torch.where(score > 0)[0]
            keep = there[ops.nms(own[there], score[there], overlap)][:most]
            rows.append(torch.stack([torch.full_like(keep, group), torch.zeros_like(keep), keep], dim=1))
        return torch.cat(rows)

    @staticmethod
    def symbolic(g: Any, boxes: Any, scores: Any, most: int, overlap: float) -> Any:
        constants = (torch.tensor([most]), torch.tensor([overlap]), torch.tensor([0.0]))
        return g.op("NonMaxSuppression", boxes, scores, *(g.op("Constant", value_t=value) for value in constants))


def kept(boxes: Tensor, rank: Tensor, there: Tensor, most: int, overlap: float) -> Tensor:
    """Which boxes [G, N, 4] of each group that are `there` stay, the highest rank [G, N] first, ranks being above 0: [G, N]."""
    scores = rank.to(boxes.dtype).where(there, -1.0)
    found = Suppress.apply(boxes, scores[:, None], most, overlap)
    index = found[:, 0] * boxes.shape[1] + found[:, 2]
    flat = torch.zeros_like(scores).view(-1)
    return flat.scatter(0, index, torch.ones_like(index, dtype=flat.dtype)).view_as(scores) > 0


def ranks(values: Tensor) -> Tensor:
    """From 1 for the least of values [G, N]; of equals the first has the highest."""
    order = torch.arange(values.shape[1], device=values.device)
    beats = (values[:, :, None] > values[:, None]) | ((values[:, :, None] == values[:, None]) & (order[:, None] < order))
    return beats.sum(dim=2) + 1


def propose(logits: Tensor, deltas: Tensor, anchors: Tensor, size: Sequence[int]) -> tuple[Tensor, Tensor]:
    """`model.propose` of a batch: proposals [B, AFTER, 4], best first, and which of them there are."""
    # Of small pictures there are fewer anchors than are looked at: some that are never there.
    logits = F.pad(logits, (0, BEFORE), value=NEVER)
    deltas, anchors = F.pad(deltas, (0, 0, 0, BEFORE)), F.pad(anchors, (0, 0, 0, BEFORE))
    top, index = logits.topk(BEFORE, dim=1)
    boxes = ops.clip_boxes_to_image(bx.decode(bx.rows(deltas, index), anchors[index], bx.RPN_WEIGHTS), size)
    there = (top > NEVER / 2) & ((boxes[..., 2:] - boxes[..., :2]).amin(dim=2) >= 1e-3)
    rank = torch.arange(BEFORE, 0, -1, device=top.device).expand_as(top)
    left, index = (rank * kept(boxes, rank, there, AFTER, 0.7)).topk(AFTER, dim=1)
    return bx.rows(boxes, index), left > 0


class Detector(nn.Module):
    """`SmrNet.detect` of a batch without a loop over its pictures."""

    def __init__(self, net: SmrNet):
        super().__init__()
        self.net = net
        self.directed = [False, *(name in net.config.directed for name in net.config.classes)]

    def forward(self, pixels: Tensor) -> tuple[Tensor, ...]:
        net, config = self.net, self.net.config
        batch, size = pixels.shape[0], pixels.shape[2:]
        fused = net.features(normalise(pixels, config.mean, config.std), {})
        logits, deltas, anchors = net.rpn_heads(fused, {})
        proposals, there = propose(logits, deltas, anchors, size)
        number = torch.arange(batch, device=pixels.device).to(proposals.dtype)[:, None, None].expand(-1, AFTER, 1)
        regions = torch.cat([number, proposals], dim=2).view(-1, 5)
        heads = net.roi_head(ops.roi_align(fused, regions, 7, 1 / config.stride, sampling_ratio=2, aligned=True), {})
        classes = len(config.classes)
        scaled = heads.scores / config.temperature
        own = torch.eye(classes + 1, dtype=torch.bool, device=pixels.device)
        margin = scaled - scaled[:, None].masked_fill(own, NEVER).logsumexp(dim=2)

        def by_class(values: Tensor) -> Tensor:
            """[B * AFTER, classes + 1, ...] to [B, classes * AFTER, ...], without the background."""
            values = values[:, 1:].reshape(batch, AFTER, classes, *values.shape[2:])
            return values.transpose(1, 2).reshape(batch, classes * AFTER, *values.shape[3:])

        found = bx.decode(heads.regression.view(-1, classes + 1, 4), proposals.view(-1, 1, 4), bx.ROI_WEIGHTS)
        found = by_class(ops.clip_boxes_to_image(found, size))
        scores, margin = by_class(scaled.softmax(dim=1)), by_class(margin)
        sides = (found[..., 2:] - found[..., :2]).amin(dim=2)
        likely = (scores > SCORE) & (sides >= 1e-2) & there.repeat(1, classes)

        def groups(values: Tensor) -> Tensor:
            return values.reshape(batch * classes, AFTER, *values.shape[2:])

        keep = kept(groups(found), ranks(groups(margin)), groups(likely), AFTER, NMS).view(batch, -1)
        top, index = margin.masked_fill(~keep, NEVER).topk(MOST, dim=1)
        labels = torch.arange(1, classes + 1, device=pixels.device).repeat_interleave(AFTER)
        label = labels[index]
        # The vote, as model.vote has it.
        overlap = bx.iou(bx.rows(found, index), found)
        weights = scores[:, None] * (overlap - VOTE_IOU).clamp(min=0) / (1 - VOTE_IOU)
        weights = weights * ((labels == label[..., None]) & there.repeat(1, classes)[:, None])
        self_ = torch.arange(classes * AFTER, device=pixels.device) == index[..., None]
        weights = torch.where(self_, scores[:, None], weights)
        share = weights / weights.sum(dim=2, keepdim=True)

        def voted(values: Tensor) -> Tensor:
            far = values[:, None] - bx.rows(values, index)[:, :, None]
            return bx.rows(values, index) + (share[..., None] * far).sum(dim=2)

        is_one = top > NEVER / 2
        outputs = [voted(found), scores.gather(1, index).where(is_one, 0.0), label.where(is_one, 0)]
        if heads.pose is not None:
            turned = voted(heads.pose.view(batch, AFTER, -1).repeat(1, classes, 1))
            directed = torch.tensor(self.directed, device=pixels.device)[label]
            said = pose.decode(turned.view(-1, pose.OUTPUTS), directed.view(-1))
            outputs += [value.view(batch, MOST, *value.shape[1:]) for value in said.values()]
        return tuple(outputs)


NAMES = ("boxes", "scores", "labels", "yaw", "yaw_std", "centre_std", "whole")


def export(net: SmrNet, file: Any) -> None:
    """Writes it with the configuration as JSON in the metadata's `config`."""
    import onnx

    names = NAMES if net.config.pose else NAMES[:3]
    axes: dict[str, dict[int, str]] = {"pixels": {0: "batch", 2: "height", 3: "width"}, **{name: {0: "batch"} for name in names}}
    own = Cbam.forward
    setattr(Cbam, "forward", plain_cbam)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")  # the tracer's: what it holds for constants here are
            net = net.to(memory_format=torch.contiguous_format)
            torch.onnx.export(Detector(net).eval(), (torch.rand(2, 3, 96, 128) * 255,), file, dynamo=False, opset_version=OPSET, input_names=["pixels"], output_names=[*names], dynamic_axes=axes)
    finally:
        setattr(Cbam, "forward", own)
    model = onnx.load(file)
    onnx.helper.set_model_props(model, {"config": json.dumps(net.config.to_dict())})
    onnx.checker.check_model(model)
    onnx.save(model, file)


def run(args: argparse.Namespace) -> int:
    net = weightfile.load(args.weights)
    if args.out.suffix != ".onnx":
        raise Failure(f"--out: expected a name that ends with .onnx, got {args.out}")
    with whole(args.out) as part:
        export(net, part)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB")
    return 0
