"""Writes a weight file with anchors of more ratios, that still finds what it found.

A new anchor's rows of the RPN are those of the anchor of its size with the nearest ratio, so scaled that both lead to the
same box; training then gives it its own. With --data it says how many labelled snaps no anchor overlaps by half, before
and after.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torchvision.ops import box_iou

import boxes as bx
import weightfile
from data import CLASSES, read_coco, scaled, whole_tiles
from model import Config, SmrNet

HALF = 0.5  # overlap of a box that finds a snap


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


def best_overlaps(config: Config, folder: Path) -> dict[str, np.ndarray]:
    """By class, each labelled snap's best overlap with an anchor."""
    cells = bx.cell_anchors(config.anchor_sizes, config.anchor_ratios)
    best: dict[str, list[float]] = {name: [] for name in CLASSES}
    for entry in read_coco(folder):
        scale = entry.mm_per_pixel * config.pixels_per_mm
        height, width = (whole_tiles(scaled(side, scale)) // config.stride for side in entry.size)
        anchors = bx.grid_anchors(cells, height, width, config.stride)
        overlaps = box_iou(torch.from_numpy(entry.snaps.boxes).to(anchors.dtype) * scale, anchors).amax(dim=1)
        for label, overlap in zip(entry.snaps.labels, overlaps.tolist()):
            best[CLASSES[label - 1]].append(overlap)
    return {name: np.array(overlaps) for name, overlaps in best.items() if overlaps}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--ratios", type=float, nargs="+", required=True, help="all of them, height over width")
    parser.add_argument("--data", type=Path, nargs="+", default=[], help="COCO folders")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    model = weightfile.load(args.weights)
    wider = with_ratios(model, args.ratios)
    for folder in args.data:
        before, after = (best_overlaps(m.config, folder) for m in (model, wider))
        for name in before:
            shares = (f"{100 * (best[name] < HALF).mean():.1f}" for best in (before, after))
            print(f"{folder.name}: of {len(before[name])} {name} no anchor overlaps by half: {', then '.join(shares)} %")
    weightfile.save(wider, args.out)


if __name__ == "__main__":
    main()
