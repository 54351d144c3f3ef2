"""What RW-Net's weights are, and how far boxes move without the third scale."""

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import weightfile
from metrics import detect_folder

SCORE = 0.5  # of the boxes that count
GONE = 20  # frame pixels: a box without another of its class as near as this is gone


class Recorder:
    """Stands in for RW-Net: keeps its weights, and may take the third scale out of the sum."""

    def __init__(self, reweight: torch.nn.Module):
        self.reweight, self.without, self.seen = reweight.forward, False, []

    def __call__(self, maps: list[Tensor]) -> Tensor:
        weights = self.reweight(maps).clone()
        self.seen.append(weights[0].numpy())
        if self.without:
            weights[:, 2] = 0
        return weights


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
    recorder = Recorder(net.reweight)
    net.reweight.forward = recorder
    for folder in args.data:
        recorder.seen, recorder.without = [], False
        truths, whole = detect_folder(net, folder, args.pictures)
        weights = np.array(recorder.seen)
        recorder.without = True
        _, less = detect_folder(net, folder, args.pictures)
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
        print(f"{folder.name}: {len(weights)} pictures, weights {low} to {high}; without the third scale {gone} of {boxes} boxes gone, centres moved by {np.median(moved):.3f} mm in the median, {max(moved):.3f} at most")


if __name__ == "__main__":
    main()
