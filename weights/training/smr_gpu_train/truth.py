"""What the pictures of a batch show, as the losses read it."""

from dataclasses import dataclass

from torch import Tensor


@dataclass
class Truth:
    """Of B pictures, N rows each: label 0 marks those that are left over, and an ignored box of no area is none."""

    boxes: Tensor  # [B, N, 4]
    labels: Tensor  # [B, N], 0: no snap
    yaw: Tensor  # [B, N], radians, NaN where there is no direction
    whole: Tensor  # [B, N], 0 or 1
    ignored: Tensor  # [B, M, 4]
