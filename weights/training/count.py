"""Prints a network's multiply-adds and the size of its weight file. `python count.py [WEIGHTS]`, by default both networks."""

import sys
from pathlib import Path

from smr_gpu_train import weightfile
from smr_gpu_train.config import NETWORKS, Config
from smr_gpu_train.experiments.cost import ROIS, multiply_adds
from smr_gpu_train.model import SmrNet


def stored_bytes(model: SmrNet) -> int:
    """Of the tensors in the weight file: matrices in f16, vectors in f32."""
    return sum(t.numel() * t.element_size() for t in weightfile.stored(model).values())


def main() -> None:
    if len(sys.argv) > 1:
        models = {name: weightfile.load(Path(name)) for name in sys.argv[1:]}
    else:
        models = {name: SmrNet(Config(pose=True, **widths)) for name, widths in NETWORKS.items()}
    for name, model in models.items():
        print(f"{name}: {multiply_adds(model) / 1e9:.3f} G multiply-adds at 320 x 320 with {ROIS} regions, {stored_bytes(model) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
