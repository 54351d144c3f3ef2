"""Prints a network's multiply-adds and the size of its weight file. `python count.py [WEIGHTS]`, by default both networks."""

import sys
from pathlib import Path

import torch
from torch import nn

from smr_gpu_train import weightfile
from smr_gpu_train.config import NETWORKS, Config
from smr_gpu_train.model import SmrNet

ROIS = 100


def multiply_adds(model: SmrNet, height: int = 320, width: int = 320) -> int:
    """Of convolutions and linear layers on one picture with 100 regions; the CBAMs' pooling and scaling are not counted."""
    total = 0

    def count(layer: nn.Module, inputs: tuple, output: torch.Tensor) -> None:
        nonlocal total
        total += output.numel() * layer.weight[0].numel()

    hooks = [m.register_forward_hook(count) for m in model.modules() if isinstance(m, (nn.Conv2d, nn.Linear))]
    with torch.no_grad():
        fused = model.eval().features(torch.zeros(1, 3, height, width), {})
        model.rpn_heads(fused, {})
        model.roi_head(torch.zeros(ROIS, model.config.width, 7, 7), {})
    for hook in hooks:
        hook.remove()
    return total


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
