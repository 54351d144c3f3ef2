"""Prints a weight file's figures on COCO folders."""

import argparse
import json
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "0")

import torch

import weightfile
from metrics import detect_folder, figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--data", type=Path, nargs="+", required=True)
    parser.add_argument("--conf", type=float, default=0.5, help="least score of a best box")
    parser.add_argument("--limit", type=int, help="the first pictures of each folder only")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    args = parser.parse_args()
    model = weightfile.load(args.weights)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model.to(device)
    result = {}
    for folder in args.data:
        start = time.monotonic()
        truths, detections = detect_folder(model, folder, args.limit, device)
        rows = result[str(folder)] = figures(truths, detections, args.conf)
        print(f"{folder}: {len(truths)} pictures in {time.monotonic() - start:.0f} s, conf {args.conf}")
        for name, row in rows.items():
            print(f"{name}: " + ", ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
    if args.json:
        args.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
