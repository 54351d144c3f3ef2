"""Writes golden tensors of every ablation, of Faster R-CNN and of the network without its deepest scale, on untrained weights, for the Rust tests.

The weights and the picture are hashes, which src/smr/weights.rs and
tests/stages.rs compute too, so the file holds outputs only. Computed in
float64, stored in float32, named "no-msff/rpn.cls" and so on. Of the RoI
head's rows only the best proposal's is kept.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from smr_gpu_train.data import normalise, resize_square
from smr_gpu_train.config import FASTER_RCNN, Config, Variant
from smr_gpu_train.model import SmrNet

SEED = 7
VARIANTS = {"full": {}, "no-safe": {"safe": False}, "no-msff": {"msff": False}, "no-rw": {"rw": False}, "faster-rcnn": asdict(FASTER_RCNN), "no-deepest": {}}
# Scales that are computed, where that is not all.
SCALES = {"no-deepest": 2}
STAGES = ("rpn.cls", "rpn.bbox", "proposals", "roi_head.pool", "roi_head.cls_score", "roi_head.bbox_pred")
WIDTH, HEIGHT = 80, 70
# Middle and spread of a vector, by the end of its name: blocks near the identity, gates open.
VECTORS = (
    ("running_var", 1, 0.5),
    ("bn2.weight", 0.3, 0.1),
    ("weight", 1, 0.2),
    ("channel.fc2.bias", 1, 0.1),
    ("spatial.bn.bias", 2, 0.1),
)


def hashed(name: str, shape: torch.Size) -> torch.Tensor:
    """The values of `random_tensor` in src/smr/weights.rs, bit for bit."""
    key = 0x811C9DC5 ^ SEED
    for byte in name.encode():
        key = (key ^ byte) * 0x01000193 & 0xFFFFFFFF
    x = np.arange(shape.numel(), dtype=np.uint32) * np.uint32(0x9E3779B9) + np.uint32(key)
    x = (x ^ x >> np.uint32(16)) * np.uint32(0x7FEB352D)
    x = (x ^ x >> np.uint32(15)) * np.uint32(0x846CA68B)
    x = x ^ x >> np.uint32(16)
    middle, spread = next(((m, s) for end, m, s in VECTORS if name.endswith(end)), (0, 0.1))
    if len(shape) > 1:
        middle, spread = 0, np.sqrt(np.float32(6) / np.float32(shape[1:].numel()))
    middle, spread = np.float32(middle), np.float32(spread)
    unit = (x >> np.uint32(8)).astype(np.float32) / np.float32(1 << 23) - np.float32(1)
    return torch.from_numpy(middle + spread * unit).view(shape)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    words = np.arange(WIDTH * HEIGHT, dtype=np.uint32) * np.uint32(2654435761)
    picture = np.stack([words >> np.uint32(8 * c) & np.uint32(255) for c in range(3)], axis=-1)
    pixels, _, _ = resize_square(picture.astype(np.uint8).reshape(HEIGHT, WIDTH, 3), 64, torch.float64)
    stored = {}
    for label, off in VARIANTS.items():
        variant = Variant(**off)
        # Faster R-CNN's head is torchvision's.
        config = Config(anchor_sizes=[16.0, 32.0], anchor_ratios=[0.5, 1.0, 2.0], variant=variant, head=1024 if variant == FASTER_RCNN else 512)
        model = SmrNet(config)
        state = model.state_dict()
        model.load_state_dict({k: v if k.endswith("num_batches_tracked") else hashed(k, v.shape) for k, v in state.items()})
        stages: dict[str, torch.Tensor] = {}
        image = normalise(pixels, config.mean, config.std)[None]
        model.double().eval().detect(image, stages, score=0.0, scales=SCALES.get(label, 3))
        # A map that died, or gates that shut, would hide whatever comes before them.
        assert stages["fusion.fused"].std() > 0.1, label
        for name in STAGES:
            # One picture: the maps lose the batch dimension; of rows the best is kept.
            tensor = stages[name][0] if name.startswith("rpn.") else stages[name][:1]
            stored[f"{label}/{name}"] = tensor.float().contiguous().clone()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    save_file(stored, args.out)
    args.out.chmod(0o644)
    print(f"{len(stored)} tensors; {args.out}: {args.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
