"""Torchvision's Faster R-CNN losses, with boxes to ignore.

A crop cuts some snaps in two. They are neither targets nor background: anchors
and proposals that lie on them are left out.
"""

import torch
import torch.nn.functional as F
from torch import Tensor
from torchvision import ops

import boxes as bx
from model import SmrNet, propose

ROIS = 64  # a picture, a quarter of them positive
ANCHORS = 256  # a picture, half of them positive


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
    """Positive and negative masks, and each anchor's truth; 0.7 / 0.3 and each truth's best anchors."""
    if not len(truth):
        none = torch.zeros(len(anchors), dtype=torch.bool, device=anchors.device)
        return none, ~none & ~_on_ignored(anchors, ignored), none.long()
    iou = ops.box_iou(anchors, truth)
    best, which = iou.max(dim=1)
    positive = best >= 0.7
    # Low-quality matches: the best anchors of a truth, though no overlap reaches 0.7.
    positive |= (iou == iou.amax(dim=0, keepdim=True).clamp(min=1e-6)).any(dim=1)
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


@torch.no_grad()
def sample_rois(proposals: Tensor, target: dict) -> tuple[Tensor, Tensor, Tensor]:
    """RoIs [R, 4] from the proposals and the truth, their classes [R] and their truth boxes [R, 4]."""
    truth = target["boxes"]
    rois = torch.cat([proposals, truth])
    if not len(truth):
        free = torch.where(~_on_ignored(rois, target["ignored"]))[0][:ROIS]
        rois = rois[free]
        return rois, torch.zeros(len(rois), dtype=torch.long, device=rois.device), rois
    best, which = ops.box_iou(rois, truth).max(dim=1)
    positive = best >= 0.5
    negative = ~positive & ~_on_ignored(rois, target["ignored"])
    p, n = _sample(positive, negative, ROIS, 0.25)
    picked = torch.cat([p, n])
    labels = target["labels"][which[picked]].clone()
    labels[len(p) :] = 0
    return rois[picked], labels, truth[which[picked]]


def roi_loss(scores: Tensor, regression: Tensor, rois: Tensor, labels: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    classification = F.cross_entropy(scores, labels)
    positive = torch.where(labels > 0)[0]
    if not len(positive):
        return classification, regression.sum() * 0
    regression = regression.view(len(scores), -1, 4)[positive, labels[positive]]
    wanted = bx.encode(truth[positive], rois[positive], bx.ROI_WEIGHTS)
    return classification, F.smooth_l1_loss(regression, wanted, beta=1 / 9, reduction="sum") / len(labels)


def detection_losses(model: SmrNet, images: Tensor, targets: list[dict]) -> dict[str, Tensor]:
    """The four losses of a batch; the network in bfloat16 where the device gains by it, the losses in float32."""
    stages: dict = {}
    with torch.autocast(images.device.type, dtype=torch.bfloat16):
        fused = model.features(images, stages)
        logits, deltas, anchors = model.rpn_heads(fused, stages)
    logits, deltas, anchors = logits.float(), deltas.float(), anchors.float()
    objectness, rpn_box = rpn_loss(logits, deltas, anchors, targets)
    size = images.shape[2:]
    sampled = [
        sample_rois(propose(l.detach(), d.detach(), anchors, size, 300, 100)[0], t)
        for l, d, t in zip(logits, deltas, targets)
    ]
    rois, labels, truth = zip(*sampled)
    with torch.autocast(images.device.type, dtype=torch.bfloat16):
        pooled = bx.roi_align_dense(fused, rois, 1 / model.config.stride)
        scores, regression = model.roi_head(pooled, stages)
    classification, roi_box = roi_loss(scores.float(), regression.float(), torch.cat(rois), torch.cat(labels), torch.cat(truth))
    return {"objectness": objectness, "rpn_box": rpn_box, "class": classification, "roi_box": roi_box}
