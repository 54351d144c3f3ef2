"""Torchvision's Faster R-CNN losses, with boxes to ignore, and those of pose.py, of all pictures of a batch at once.

A crop cuts some snaps in two. They are neither targets nor background: anchors
and proposals that lie on them are left out.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from . import boxes as bx
from . import pose
from .model import Heads, SmrNet, autocast, propose_batch
from .truth import Truth

ROIS = 64  # a picture, a quarter of them positive
ANCHORS = 256  # a picture, half of them positive
NEARLY = 0.9  # of a truth's best overlap with an anchor
# A region that overlaps with a truth by 0.5 shows it, one by less than this does not; what lies between
# teaches nothing, where a hook that is hard to see would be taught to be background.
BACKGROUND = 0.4


def _on_ignored(boxes: Tensor, ignored: Tensor) -> Tensor:
    """Which boxes [B, K, 4] have more than a fifth of their area on an ignored box [B, M, 4]."""
    if not ignored.shape[1]:
        return torch.zeros(boxes.shape[:2], dtype=torch.bool, device=boxes.device)
    overlap = bx.intersection(boxes, ignored).amax(dim=2)
    return overlap > 0.2 * bx.area(boxes)


def _sample(positive: Tensor, negative: Tensor, first: Tensor, count: int, fraction: float) -> tuple[Tensor, Tensor, Tensor]:
    """Of K candidates, `count` a picture: indices [B, count], which of them are positive and which are neither.

    At most `fraction` of them positive, those with the highest `first` [B, K]; the rest negative, likewise."""
    most = min(int(count * fraction), positive.shape[1])
    p_key, p = first.masked_fill(~positive, -1.0).topk(most, dim=1)
    n_key, n = first.masked_fill(~negative, -1.0).topk(min(count, negative.shape[1]), dim=1)
    found = p_key >= 0
    room = count - found.sum(dim=1, keepdim=True)
    taken = (n_key >= 0) & (torch.arange(n.shape[1], device=n.device) < room)
    index = torch.cat([p, n], dim=1)
    is_positive = torch.cat([found, torch.zeros_like(taken)], dim=1)
    used = torch.cat([found, taken], dim=1)
    # The used ones lie in the first `count` rows then.
    order = used.int().argsort(dim=1, descending=True, stable=True)[:, :count]
    return index.gather(1, order), is_positive.gather(1, order), ~used.gather(1, order)


def match_anchors(anchors: Tensor, truth: Truth) -> tuple[Tensor, Tensor, Tensor]:
    """Positive and negative masks [B, A], and each anchor's truth; 0.7 / 0.3 and about each truth's best anchors."""
    everywhere = anchors[None].expand(len(truth.boxes), -1, -1)
    iou = bx.iou(everywhere, truth.boxes).where(truth.labels[:, None] > 0, -1.0)
    best, which = iou.max(dim=2)
    positive = best >= 0.7
    # Low-quality matches: the best anchors of a truth, or nearly, though no overlap reaches 0.7. A long
    # hook has one or two best ones alone, too few to learn from.
    positive |= (iou >= NEARLY * iou.amax(dim=1, keepdim=True).clamp(min=1e-6)).any(dim=2)
    negative = (best < 0.3) & ~positive & ~_on_ignored(everywhere, truth.ignored)
    return positive, negative, which


def mean_where(values: Tensor, which: Tensor) -> Tensor:
    """The mean of the values where `which` is true, 0 where it nowhere is; what is not finite elsewhere does no harm."""
    return values.where(which, 0.0).sum() / which.sum().clamp(min=1)


def rpn_loss(logits: Tensor, deltas: Tensor, anchors: Tensor, truth: Truth) -> tuple[Tensor, Tensor]:
    """Of objectness [B, A] and deltas [B, A, 4]."""
    positive, negative, which = match_anchors(anchors, truth)
    index, is_positive, unused = _sample(positive, negative, torch.rand_like(logits), ANCHORS, 0.5)
    total = (~unused).sum().clamp(min=1)
    entropy = F.binary_cross_entropy_with_logits(logits.gather(1, index), is_positive.to(logits.dtype), reduction="none")
    objectness = entropy.where(~unused, 0.0).sum() / total
    # Anchors without a snap have their own box as what is wanted.
    chosen = anchors[index]
    boxes = bx.rows(truth.boxes, which.gather(1, index)).where(is_positive[..., None], chosen)
    error = F.smooth_l1_loss(bx.rows(deltas, index), bx.encode(boxes, chosen, bx.RPN_WEIGHTS), beta=1 / 9, reduction="none")
    return objectness, error.where(is_positive[..., None], 0.0).sum() / total


@dataclass
class Rois:
    """R sampled regions of each picture; what they should be found to be, meaningless where the label is not above 0."""

    boxes: Tensor  # [B, R, 4]
    labels: Tensor  # [B, R], 0 is background, -1 no region at all
    truth: Tensor  # [B, R, 4]
    yaw: Tensor  # [B, R], radians, NaN where there is no direction
    whole: Tensor  # [B, R], 0 or 1
    proposed: Tensor  # [B, R], from the RPN; the others are the truth itself

    def flat(self) -> "Rois":
        """Of all pictures in a row."""
        return Rois(*(getattr(self, name).flatten(0, 1) for name in Rois.__dataclass_fields__))


@torch.no_grad()
def sample_rois(proposals: Tensor, there: Tensor, truth: Truth) -> Rois:
    """From the proposals [B, P, 4] that are `there` [B, P], best first, and the truth; a quarter of them positive.

    Of a picture without a snap the best proposals: they look most like one."""
    snaps = truth.labels > 0
    boxes, there = torch.cat([proposals, truth.boxes], dim=1), torch.cat([there, snaps], dim=1)
    iou = bx.iou(boxes, truth.boxes).where(snaps[:, None], -1.0)
    best, which = iou.max(dim=2)
    positive = there & (best >= 0.5)
    negative = there & (best < BACKGROUND) & ~_on_ignored(boxes, truth.ignored)
    by_rank = torch.arange(boxes.shape[1], 0, -1, device=boxes.device) / boxes.shape[1]
    first = torch.rand_like(best).where(snaps.any(dim=1, keepdim=True), by_rank)
    index, is_positive, unused = _sample(positive, negative, first, ROIS, 0.25)
    which = which.gather(1, index)
    labels = bx.rows(truth.labels, which).where(is_positive, 0).where(~unused, -1)
    return Rois(bx.rows(boxes, index), labels, bx.rows(truth.boxes, which), bx.rows(truth.yaw, which), bx.rows(truth.whole, which), index < proposals.shape[1])


def of_label(regression: Tensor, labels: Tensor) -> Tensor:
    """Each region's deltas [R, 4] for its own class."""
    return bx.rows(regression.view(len(labels), -1, 4), labels.clamp(min=0)[:, None])[:, 0]


def roi_loss(heads: Heads, rois: Rois) -> tuple[Tensor, Tensor]:
    used, positive = rois.labels >= 0, rois.labels > 0
    classification = mean_where(F.cross_entropy(heads.scores, rois.labels.clamp(min=0), reduction="none"), used)
    boxes = rois.truth.where(positive[:, None], rois.boxes)
    wanted = bx.encode(boxes, rois.boxes, bx.ROI_WEIGHTS).where(positive[:, None], 0.0)
    error = F.smooth_l1_loss(of_label(heads.regression, rois.labels), wanted, beta=1 / 9, reduction="none").sum(dim=1)
    return classification, error.where(positive, 0.0).sum() / used.sum().clamp(min=1)


def pose_losses(heads: Heads, said: Tensor, rois: Rois, pixels_per_mm: float) -> dict[str, Tensor]:
    """Of the positive regions, of which the layer `pose` said this; the centre's deviations learn from proposals alone, as there are no others in use."""
    positive = rois.labels > 0
    directed = positive & rois.yaw.isfinite()
    found = positive & rois.proposed
    boxes = bx.decode(of_label(heads.regression.detach(), rois.labels), rois.boxes, bx.ROI_WEIGHTS)
    error = (boxes[:, :2] + boxes[:, 2:] - rois.truth[:, :2] - rois.truth[:, 2:]) / 2
    error = error.where(found[:, None], 0.0)
    return {
        "yaw": mean_where(pose.yaw_loss(said, rois.yaw.nan_to_num()), directed),
        "centre": mean_where(pose.centre_loss(said, error / pixels_per_mm), found),
        "whole": mean_where(pose.whole_loss(said, rois.whole.where(positive, 0.0)), positive),
    }


# In the sum; the box and class losses weigh 1. A likelihood's gradient grows as its deviation shrinks.
WEIGHTS = {"yaw": 0.1, "centre": 0.03, "whole": 0.1}


def detection_losses(model: SmrNet, images: Tensor, truth: Truth) -> dict[str, Tensor]:
    """The weighted losses of a batch.

    The network in bfloat16 where the device gains by it, the losses in float32."""
    stages: dict = {}
    with autocast(images.device.type):
        fused = model.features(images, stages)
        logits, deltas, anchors = model.rpn_heads(fused, stages)
    logits, deltas, anchors = logits.float(), deltas.float(), anchors.float()
    objectness, rpn_box = rpn_loss(logits, deltas, anchors, truth)
    proposals, there = propose_batch(logits.detach(), deltas.detach(), anchors, images.shape[2:], 300, 100)
    rois = sample_rois(proposals, there, truth)
    with autocast(images.device.type):
        heads = model.roi_head(bx.roi_align_dense(fused, rois.boxes, 1 / model.config.stride), stages)
    heads = Heads(heads.scores.float(), heads.regression.float(), None if heads.pose is None else heads.pose.float())
    flat = rois.flat()
    classification, roi_box = roi_loss(heads, flat)
    losses = {"objectness": objectness, "rpn_box": rpn_box, "class": classification, "roi_box": roi_box}
    if heads.pose is not None:
        losses |= pose_losses(heads, heads.pose, flat, model.config.pixels_per_mm)
    return {k: WEIGHTS.get(k, 1.0) * v for k, v in losses.items()}
