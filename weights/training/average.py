"""Writes the mean of two weight files of the same network, with batch norm statistics of its own or, where both
have the same (`train.py --keep-statistics`), with theirs.

Of a run and the weights that it began with, the mean knows what the run learnt and forgets less.
"""

import argparse
from pathlib import Path

import torch

import weightfile
from learner import measure_statistics
from pool import AREA, Pool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, nargs=2, required=True)
    parser.add_argument("--share", type=float, default=0.5, help="of the second file in the mean")
    parser.add_argument("--statistics", nargs="+", type=Path, help="COCO folders: the statistics are those of batches of their pictures")
    parser.add_argument("--cache", type=Path, help="where small pictures are kept, with --statistics")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if args.statistics and not args.cache:
        parser.error("--statistics: give --cache")
    first, second = (weightfile.load(file) for file in args.weights)
    other, state = first.state_dict(), second.state_dict()
    if {k: v.shape for k, v in other.items()} != {k: v.shape for k, v in state.items()}:
        raise SystemExit(f"{args.weights[0]}: expected the tensors of {args.weights[1]}")
    second.load_state_dict({k: other[k].lerp(v, args.share) if v.is_floating_point() else v for k, v in state.items()})
    if args.statistics:
        measure_statistics(second, Pool.of(args.statistics, second.config.pixels_per_mm, args.cache), AREA, args.seed)
    elif any("running" in k and not torch.equal(v, other[k]) for k, v in state.items()):
        raise SystemExit(f"{args.weights[1]}: expected the batch norm statistics of {args.weights[0]}; else give --statistics")
    weightfile.save(second, args.out)


if __name__ == "__main__":
    main()
