"""The configuration that a weight file holds. Needs no torch."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from .errors import Failure


@dataclass
class Variant:
    """The switches of the paper's ablations, and what a plain Faster R-CNN has in place of MSFF-Net: the RPN's own convolution."""

    safe: bool = True
    msff: bool = True
    rw: bool = True
    rpn_conv: bool = False


@dataclass
class Config:
    """All that a reader of the weight file must know beside the tensors; weights/README.md has the meaning of each key."""

    pixels_per_mm: float = 8.0
    mean: list[float] = field(default_factory=lambda: [0.5, 0.5, 0.5])
    std: list[float] = field(default_factory=lambda: [0.2, 0.2, 0.2])
    classes: list[str] = field(default_factory=lambda: ["A", "B"])
    directed: list[str] = field(default_factory=lambda: ["A"])
    anchor_sizes: list[float] = field(default_factory=lambda: [32.0, 48.0, 72.0])
    anchor_ratios: list[float] = field(default_factory=lambda: [0.5, 1.0, 2.0])
    variant: Variant = field(default_factory=Variant)
    stem: int = 64
    channels: list[int] = field(default_factory=lambda: [64, 128, 256, 512])
    blocks: list[int] = field(default_factory=lambda: [3, 4, 6, 3])
    reduction: int = 16
    fused: int = 256
    reweight: int = 64
    head: int = 512
    pose: bool = False
    temperature: float = 1.0

    @property
    def stride(self) -> int:
        return 8 if self.variant.msff else 16

    @property
    def width(self) -> int:
        """Channels of the map that the heads read: without the fusion that is conv4_x."""
        return self.fused if self.variant.msff else self.channels[2]

    def to_dict(self) -> dict[str, Any]:
        return {"format": 2, **asdict(self), "stride": self.stride}

    def to_learn(self, classes: list[str], directed: list[str]) -> "Config":
        """For training on these classes: with pose, and without a temperature, which fits the weights that it was measured with."""
        return replace(self, classes=[*classes], directed=[*directed], pose=True, temperature=1.0)

    @staticmethod
    def from_dict(d: dict[str, Any]) -> "Config":
        """Of a file in format 2, or in format 1, whose networks all had the default widths and no pose."""
        if d["format"] not in (1, 2):
            raise Failure(f"format: expected 1 or 2, got {d['format']}")
        known = {k: v for k, v in d.items() if k in Config.__dataclass_fields__}
        config = Config(**{**known, "variant": Variant(**d["variant"])})
        if d["format"] == 1:
            config.pixels_per_mm = d["input_size"] / (d["mm_per_pixel"] * d["picture_size"])
        return config


FASTER_RCNN = Variant(safe=False, msff=False, rw=False, rpn_conv=True)  # on conv4_x
# The two networks; what else a configuration holds follows from the data.
NETWORKS: dict[str, dict[str, Any]] = {
    "large": {},
    # Multiples of 16 throughout; one block at stride 4, where a block costs most time, and three at stride 16.
    "small": {
        "stem": 16,
        "channels": [32, 64, 128, 192],
        "blocks": [1, 2, 3, 2],
        "reduction": 8,
        "fused": 96,
        "reweight": 32,
        "head": 192,
    },
}
# Those of the published weights, for a network from scratch.
ANCHOR_SIZES = [23.0, 43.0, 54.0, 67.0]
ANCHOR_RATIOS = [0.4, 0.685, 1.0, 1.46, 2.5]
