"""What RW-Net's weights are, and how far boxes move where the deepest scale is left out."""

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import weightfile
from metrics import detect_folder

SCORE = 0.5  # of the boxes that count
GONE = 20  # frame pixels: a box without another of its class as near as this is gone


def centres(boxes: Tensor) -> Tensor:
    return (boxes[:, :2] + boxes[:, 2:]) / 2


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="COCO folders")
    parser.add_argument("--pictures", type=int, default=40, help="the first of each folder")
    args = parser.parse_args()
    net = weightfile.load(args.weights).eval()
    seen: list[np.ndarray] = []
    net.reweight.register_forward_hook(lambda _, maps, weights: seen.append(weights[0].numpy()))
    for folder in args.data:
        seen.clear()
        truths, whole = detect_folder(net, folder, args.pictures)
        weights = np.array(seen)
        _, less = detect_folder(net, folder, args.pictures, scales=2)
        boxes, gone, moved = 0, 0, []
        for truth, a, b in zip(truths, whole, less):
            kept = b["scores"] > SCORE
            for box, label in zip(a["boxes"][a["scores"] > SCORE], a["labels"][a["scores"] > SCORE]):
                same = centres(b["boxes"][kept & (b["labels"] == label)])
                distance = (same - centres(box[None])).norm(dim=1).min().item() if len(same) else GONE
                boxes, gone = boxes + 1, gone + (distance >= GONE)
                if distance < GONE:
                    moved.append(distance * truth["mm_per_pixel"])
        low, high = weights.min(axis=0).round(3), weights.max(axis=0).round(3)
        print(f"{folder.name}: {len(weights)} pictures, weights {low} to {high}; without the deepest scale {gone} of {boxes} boxes gone, centres moved by {np.median(moved):.3f} mm in the median, {max(moved):.3f} at most")


if __name__ == "__main__":
    main()
