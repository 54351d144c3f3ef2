"""What the RoI head's layer `pose` says of a region, and the losses that teach it.

Its six outputs: the direction as a vector (c, s), of any length; the logarithms of
three variances: of the direction in rad², of the box's centre along x and along y in
mm² on the input's scale; the logit of "whole", not cut by the picture's edge.

The direction is that in which a hook's barb points, as an angle from +x (right) towards
+y (down): a turn that looks clockwise. It follows a von Mises distribution with the
concentration 1 / variance; the centre's errors follow normal distributions.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

OUTPUTS = 6
# exp() of these stays far from overflow. A direction knows nothing at 1/√3 of a half turn, the deviation of all angles alike.
LOG_VARIANCE_MIN = -12.0
YAW_LOG_VARIANCE_MAX = math.log(math.pi**2 / 3)
CENTRE_LOG_VARIANCE_MAX = math.log(100.0)
DEGREES = 180 / math.pi  # of a radian; ONNX has no operator for that


def _log_variances(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Clamped: of the direction [R], and of the centre [R, 2]."""
    return rows[:, 2].clamp(LOG_VARIANCE_MIN, YAW_LOG_VARIANCE_MAX), rows[:, 3:5].clamp(LOG_VARIANCE_MIN, CENTRE_LOG_VARIANCE_MAX)


def decode(rows: Tensor, directed: Tensor) -> dict[str, Tensor]:
    """Of rows [R, 6]: yaw and its deviation in degrees [R], the centre's deviations in mm [R, 2], the probability of "whole" [R].

    yaw = atan2(s, c), a deviation = exp(log variance / 2); where `directed` [R] is false, both of yaw's are NaN.
    """
    yaw, centre = _log_variances(rows)
    none = torch.full_like(yaw, math.nan)
    return {
        "yaw": torch.where(directed, torch.atan2(rows[:, 1], rows[:, 0]) * DEGREES, none),
        "yaw_std": torch.where(directed, (yaw / 2).exp() * DEGREES, none),
        "centre_std": (centre / 2).exp(),
        "whole": rows[:, 5].sigmoid(),
    }


def yaw_loss(rows: Tensor, yaw: Tensor) -> Tensor:
    """Von Mises likelihood of angles [R] in radians, and half the squared distance of the vectors.

    One loss a region, [R]. The distance steers while the likelihood is still flat. A region's likelihood weighs as its stated deviation
    (Seitzer et al. 2022, with beta = 1/2), else the sure ones drown the others.
    """
    truth = torch.stack([yaw.cos(), yaw.sin()], dim=1)
    cosine = F.cosine_similarity(rows[:, :2], truth, dim=1)
    log_variance, _ = _log_variances(rows)
    kappa = (-log_variance).exp()
    # log(2 pi I0(kappa)) - kappa cos, where i0e = I0 exp(-kappa) does not overflow.
    likelihood = math.log(2 * math.pi) + torch.special.i0e(kappa).log() + kappa * (1 - cosine)
    return likelihood * (log_variance / 2).exp().detach() + 0.5 * (rows[:, :2] - truth).square().sum(dim=1)


def centre_loss(rows: Tensor, error: Tensor) -> Tensor:
    """Normal likelihood of the centre's errors [R, 2] in mm, [R]; the centre itself is the box's and learns from the box's loss."""
    _, log_variance = _log_variances(rows)
    return 0.5 * (log_variance + error.detach().square() * (-log_variance).exp()).sum(dim=1)


def whole_loss(rows: Tensor, whole: Tensor) -> Tensor:
    return F.binary_cross_entropy_with_logits(rows[:, 5], whole, reduction="none")
