"""Writes a weight file with anchors of more ratios, that still finds what it found.

A new anchor's rows of the RPN are those of the anchor of its size with the nearest ratio, so scaled that both lead to the
same box; training then gives it its own.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path

import torch

import boxes as bx
import weightfile
from model import SmrNet


def with_ratios(model: SmrNet, ratios: list[float]) -> SmrNet:
    old = model.config
    state = model.state_dict()
    wider = SmrNet(replace(old, anchor_ratios=ratios)).to(state["rpn.bbox.bias"].dtype).eval()
    sizes = range(len(old.anchor_sizes))
    nearest = [min(range(len(old.anchor_ratios)), key=lambda i: abs(math.log(old.anchor_ratios[i] / ratio))) for ratio in ratios]
    rows = torch.tensor([i * len(sizes) + size for i in nearest for size in sizes])
    for name in ("weight", "bias"):
        cls, bbox = state[f"rpn.cls.{name}"], state[f"rpn.bbox.{name}"]
        state[f"rpn.cls.{name}"] = cls[rows]
        state[f"rpn.bbox.{name}"] = bbox.view(-1, 4, *bbox.shape[1:])[rows].flatten(0, 1)
    # The coder divides a centre's offset, and the box's sides before their logarithm, by the anchor's sides.
    before, after = (cells[:, 2:] - cells[:, :2] for cells in (model.cells[rows], wider.cells))
    scale = (before / after).to(state["rpn.bbox.bias"].dtype)
    factor = torch.cat([scale, torch.ones_like(scale)], 1).flatten()
    shift = torch.cat([torch.zeros_like(scale), scale.log()], 1) * torch.tensor(bx.RPN_WEIGHTS)
    state["rpn.bbox.weight"] *= factor[:, None, None, None]
    state["rpn.bbox.bias"] = state["rpn.bbox.bias"] * factor + shift.flatten()
    wider.load_state_dict(state)
    return wider


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--ratios", type=float, nargs="+", required=True, help="all of them, height over width")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    weightfile.save(with_ratios(weightfile.load(args.weights), args.ratios), args.out)


if __name__ == "__main__":
    main()
