"""Writes the weight file from a training checkpoint (its averaged weights), or a random one for tests."""

import argparse
import hashlib
import json
from pathlib import Path

import torch
from torch import nn

import weightfile
from learner import measure_statistics
from model import NETWORKS, Config, SmrNet, Variant
from pool import AREA, Pool


def random_model(config: Config, seed: int) -> SmrNet:
    """Random weights with batch norm statistics that keep the activations in range."""
    torch.manual_seed(seed)
    model = SmrNet(config).to(memory_format=torch.channels_last)
    for m in model.modules():
        if isinstance(m, nn.BatchNorm2d):
            nn.init.uniform_(m.weight, 0.5, 1.0)
            m.momentum = None
    model.train()
    with torch.no_grad():
        model.features(torch.randn(4, 3, 320, 320).contiguous(memory_format=torch.channels_last), {})
        # Spread the scores, so that proposals and detections are not all alike.
        model.rpn.cls.weight.mul_(20)
        model.roi_head.cls_score.weight.mul_(20)
        model.roi_head.bbox_pred.weight.mul_(20)
    return model.eval()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--checkpoint", type=Path)
    source.add_argument("--random", type=int, metavar="SEED", help="no training: random weights from this seed")
    parser.add_argument("--student", action="store_true", help="the network that learnt beside the other")
    parser.add_argument("--network", choices=NETWORKS, default="large", help="of random weights")
    parser.add_argument("--statistics", nargs="+", type=Path, default=[], help="COCO folders: batch norm statistics from batches of their pictures, for a run that has not ended")
    parser.add_argument("--no-safe", action="store_true")
    parser.add_argument("--no-msff", action="store_true")
    parser.add_argument("--no-rw", action="store_true")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if args.checkpoint:
        state = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
        learner = state["student"] if args.student else state
        model = SmrNet(Config.from_dict(json.loads(learner["config"])))
        model.load_state_dict(learner["ema"])
        if args.statistics:
            pool = Pool.of(args.statistics, model.config.pixels_per_mm, args.checkpoint.parent / "cache")
            measure_statistics(model.to(memory_format=torch.channels_last), pool, AREA, seed=1)
        print(f"step {state['step']}, {state['seen']} pictures seen, {state['seconds'] / 60:.1f} min")
    else:
        variant = Variant(safe=not args.no_safe, msff=not args.no_msff, rw=not args.no_rw)
        model = random_model(Config(**NETWORKS[args.network], variant=variant, pose=True), args.random)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    weightfile.save(model, args.out)
    digest = hashlib.sha256(args.out.read_bytes()).hexdigest()
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB, sha256 {digest}")


if __name__ == "__main__":
    main()
