"""Torchvision's Faster R-CNN losses, with boxes to ignore, and those of pose.py.

A crop cuts some snaps in two. They are neither targets nor background: anchors
and proposals that lie on them are left out.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torchvision import ops

import boxes as bx
import pose
from model import Heads, SmrNet, autocast, propose

ROIS = 64  # a picture, a quarter of them positive
ANCHORS = 256  # a picture, half of them positive
NEARLY = 0.9  # of a truth's best overlap with an anchor
# A region that overlaps with a truth by 0.5 shows it, one by less than this does not; what lies between
# teaches nothing, where a hook that is hard to see would be taught to be background.
BACKGROUND = 0.4


def _on_ignored(boxes: Tensor, ignored: Tensor) -> Tensor:
    """Which boxes have more than a fifth of their area on an ignored box."""
    if not len(ignored):
        return torch.zeros(len(boxes), dtype=torch.bool, device=boxes.device)
    low = torch.maximum(boxes[:, None, :2], ignored[None, :, :2])
    high = torch.minimum(boxes[:, None, 2:], ignored[None, :, 2:])
    overlap = (high - low).clamp(min=0).prod(dim=2).amax(dim=1)
    return overlap > 0.2 * ops.box_area(boxes)


def _sample(positive: Tensor, negative: Tensor, count: int, fraction: float) -> tuple[Tensor, Tensor]:
    """Random indices: at most `fraction` of `count` positive, the rest negative."""
    p, n = torch.where(positive)[0], torch.where(negative)[0]
    p = p[torch.randperm(len(p), device=p.device)[: int(count * fraction)]]
    n = n[torch.randperm(len(n), device=n.device)[: count - len(p)]]
    return p, n


def match_anchors(anchors: Tensor, truth: Tensor, ignored: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Positive and negative masks, and each anchor's truth; 0.7 / 0.3 and about each truth's best anchors."""
    if not len(truth):
        none = torch.zeros(len(anchors), dtype=torch.bool, device=anchors.device)
        return none, ~none & ~_on_ignored(anchors, ignored), none.long()
    iou = ops.box_iou(anchors, truth)
    best, which = iou.max(dim=1)
    positive = best >= 0.7
    # Low-quality matches: the best anchors of a truth, or nearly, though no overlap reaches 0.7. A long
    # hook has one or two best ones alone, too few to learn from.
    positive |= (iou >= NEARLY * iou.amax(dim=0, keepdim=True).clamp(min=1e-6)).any(dim=1)
    negative = (best < 0.3) & ~positive & ~_on_ignored(anchors, ignored)
    return positive, negative, which


def rpn_loss(logits: Tensor, deltas: Tensor, anchors: Tensor, targets: list[dict]) -> tuple[Tensor, Tensor]:
    picked, labels, predicted, wanted = [], [], [], []
    for i, target in enumerate(targets):
        positive, negative, which = match_anchors(anchors, target["boxes"], target["ignored"])
        p, n = _sample(positive, negative, ANCHORS, 0.5)
        picked.append(logits[i][torch.cat([p, n])])
        labels.append(torch.cat([torch.ones_like(p), torch.zeros_like(n)]).float())
        if len(p):
            predicted.append(deltas[i][p])
            wanted.append(bx.encode(target["boxes"][which[p]], anchors[p], bx.RPN_WEIGHTS))
    objectness = F.binary_cross_entropy_with_logits(torch.cat(picked), torch.cat(labels))
    if not predicted:
        return objectness, deltas.sum() * 0
    total = sum(map(len, labels))
    return objectness, F.smooth_l1_loss(torch.cat(predicted), torch.cat(wanted), beta=1 / 9, reduction="sum") / total


@dataclass
class Rois:
    """Sampled regions of one picture; what they should be found to be, meaningless where the label is 0."""

    boxes: Tensor  # [R, 4]
    labels: Tensor  # [R], 0 is background
    truth: Tensor  # [R, 4]
    yaw: Tensor  # [R], radians, NaN where there is no direction
    whole: Tensor  # [R], 0 or 1
    proposed: Tensor  # [R], from the RPN; the others are the truth itself


@torch.no_grad()
def sample_rois(proposals: Tensor, target: dict) -> Rois:
    """From the proposals and the truth, a quarter of them positive."""
    truth = target["boxes"]
    rois = torch.cat([proposals, truth])
    if not len(truth):
        rois = rois[torch.where(~_on_ignored(rois, target["ignored"]))[0][:ROIS]]
        zeros = rois.new_zeros(len(rois))
        return Rois(rois, zeros.long(), rois, zeros, zeros, zeros == 0)
    best, which = ops.box_iou(rois, truth).max(dim=1)
    positive = best >= 0.5
    negative = (best < BACKGROUND) & ~_on_ignored(rois, target["ignored"])
    p, n = _sample(positive, negative, ROIS, 0.25)
    picked = torch.cat([p, n])
    which = which[picked]
    labels = target["labels"][which].clone()
    labels[len(p) :] = 0
    return Rois(rois[picked], labels, truth[which], target["yaw"][which], target["whole"][which], picked < len(proposals))


def roi_loss(heads: Heads, rois: Rois) -> tuple[Tensor, Tensor]:
    classification = F.cross_entropy(heads.scores, rois.labels)
    positive = torch.where(rois.labels > 0)[0]
    if not len(positive):
        return classification, heads.regression.sum() * 0
    regression = heads.regression.view(len(rois.labels), -1, 4)[positive, rois.labels[positive]]
    wanted = bx.encode(rois.truth[positive], rois.boxes[positive], bx.ROI_WEIGHTS)
    return classification, F.smooth_l1_loss(regression, wanted, beta=1 / 9, reduction="sum") / len(rois.labels)


def pose_losses(heads: Heads, rois: Rois, pixels_per_mm: float) -> dict[str, Tensor]:
    """Of the positive regions; the centre's deviations learn from proposals alone, as there are no others in use."""
    none = heads.pose.sum() * 0
    losses = {"yaw": none, "centre": none, "whole": none}
    positive = rois.labels > 0
    if positive.any():
        losses["whole"] = pose.whole_loss(heads.pose[positive], rois.whole[positive])
    directed = positive & rois.yaw.isfinite()
    if directed.any():
        losses["yaw"] = pose.yaw_loss(heads.pose[directed], rois.yaw[directed])
    found = torch.where(positive & rois.proposed)[0]
    if len(found):
        regression = heads.regression.view(len(rois.labels), -1, 4)[found, rois.labels[found]]
        boxes = bx.decode(regression.detach(), rois.boxes[found], bx.ROI_WEIGHTS)
        error = (boxes[:, :2] + boxes[:, 2:] - rois.truth[found, :2] - rois.truth[found, 2:]) / 2
        losses["centre"] = pose.centre_loss(heads.pose[found], error / pixels_per_mm)
    return losses


# In the sum; the box and class losses weigh 1. A likelihood's gradient grows as its deviation shrinks.
WEIGHTS = {"yaw": 0.1, "centre": 0.03, "whole": 0.1}


def detection_losses(model: SmrNet, images: Tensor, targets: list[dict], distiller=None, wanted: Tensor | None = None, scales: int = 3) -> tuple[dict[str, Tensor], Tensor]:
    """The weighted losses of a batch, and the fused map of so many scales; `wanted` is the teacher's, if it is at hand.

    The network in bfloat16 where the device gains by it, the losses in float32."""
    stages: dict = {}
    with autocast(images.device.type):
        fused = model.features(images, stages, scales)
        logits, deltas, anchors = model.rpn_heads(fused, stages)
    logits, deltas, anchors = logits.float(), deltas.float(), anchors.float()
    objectness, rpn_box = rpn_loss(logits, deltas, anchors, targets)
    size = images.shape[2:]
    sampled = [
        sample_rois(propose(l.detach(), d.detach(), anchors, size, 300, 100)[0], t)
        for l, d, t in zip(logits, deltas, targets)
    ]
    boxes = [r.boxes for r in sampled]
    rois = Rois(*(torch.cat([getattr(r, name) for r in sampled]) for name in Rois.__dataclass_fields__))
    with autocast(images.device.type):
        heads = model.roi_head(bx.roi_align_dense(fused, boxes, 1 / model.config.stride), stages)
    heads = Heads(heads.scores.float(), heads.regression.float(), None if heads.pose is None else heads.pose.float())
    classification, roi_box = roi_loss(heads, rois)
    losses = {"objectness": objectness, "rpn_box": rpn_box, "class": classification, "roi_box": roi_box}
    if heads.pose is not None:
        losses |= pose_losses(heads, rois, model.config.pixels_per_mm)
    if distiller is not None:
        losses |= distiller.losses(images, fused, boxes, heads, wanted)
    return {k: WEIGHTS.get(k, 1.0) * v for k, v in losses.items()}, fused
