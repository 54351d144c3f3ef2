"""Writes golden tensors of every stage of one picture, for the Rust tests.

Computed in float64 from the rounded weights of the file, stored in float32
(labels in int32). The names are the stages' names; "pixels" is the resized
picture before normalisation, 0 to 255. Of roi_head.pool only the first
proposals are kept, since it is large.
"""

import argparse
import json
from pathlib import Path

import torch
from safetensors.torch import save_file

from smr_gpu_train import weightfile
from smr_gpu_train.data import normalise, resize_square
from smr_gpu_train.pictures import read_picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--picture", type=Path, required=True)
    parser.add_argument("--size", type=int, default=320, help="resize to this many pixels, a multiple of 32")
    parser.add_argument("--pooled", type=int, default=4, help="how many proposals of roi_head.pool to keep")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    model = weightfile.load(args.weights, torch.float64)
    config = model.config
    pixels, scale, corner = resize_square(read_picture(args.picture), args.size, torch.float64)
    stages: dict[str, torch.Tensor] = {}
    image = normalise(pixels, config.mean, config.std)[None].contiguous(memory_format=torch.channels_last)
    detections = model.detect(image, stages)[0]
    if not config.variant.safe:
        stages = {k: v for k, v in stages.items() if not k.startswith("backbone.cbam")}
    stages["pixels"] = pixels
    stages["roi_head.pool"] = stages["roi_head.pool"][: args.pooled]
    stored = {}
    for name, tensor in stages.items():
        # One picture: the batch dimension goes.
        tensor = tensor[0] if tensor.ndim == 4 and name != "roi_head.pool" or name == "reweight.weights" else tensor
        stored[name] = tensor.to(torch.float32 if tensor.is_floating_point() else torch.int32).contiguous().clone()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    meta = {"picture": args.picture.name, "size": args.size, "picture_pixels_a_pixel": scale, "corner": corner}
    save_file(stored, args.out, metadata={"fixture": json.dumps(meta)})
    args.out.chmod(0o644)
    for name, tensor in stored.items():
        print(f"{name:24} {tensor.dtype} {list(tensor.shape)}")
    print(f"{len(detections['boxes'])} detections; {args.out}: {args.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
