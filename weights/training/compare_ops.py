"""Compares `smr-gpu op` with torch and torchvision on random input.

Sums are held to n * eps * sum |w||x| (n products in float32, against float64),
NMS to exact indices. Leaves with status 1 if any case is out of bounds.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors.torch import load_file, save_file
from torch import Tensor
from torchvision import ops

EPS = torch.finfo(torch.float32).eps


def run(binary: Path, device: str | None, name: str, tensors: dict[str, Tensor], params: dict) -> dict[str, Tensor]:
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.safetensors", Path(folder) / "out.safetensors"
        save_file({k: v.contiguous() for k, v in tensors.items()}, source)
        command = [str(binary), "op", name, str(source), str(target)]
        for key, value in params.items():
            command += ["--param", f"{key}={value}"]
        if device:
            command += ["--device", device]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{' '.join(command)}\nexit {done.returncode}: {done.stderr.strip()}")
        return load_file(target)


def conv2d_case(binary, device, shape, weight, stride, padding, dilation, relu, bias, residual) -> bool:
    x, w = torch.randn(shape), torch.randn(weight) / 8
    tensors = {"input": x, "weight": w}
    params = {"stride": stride, "padding": padding, "dilation": dilation, "relu": str(relu).lower()}
    places = {"stride": stride, "padding": padding, "dilation": dilation}
    truth = F.conv2d(x.double()[None], w.double(), **places)[0]
    size = F.conv2d(x.double().abs()[None], w.double().abs(), **places)[0]
    if bias:
        tensors["bias"] = torch.randn(weight[0])
        truth = truth + tensors["bias"].double()[:, None, None]
        size = size + tensors["bias"].double().abs()[:, None, None]
    if residual:
        tensors["residual"] = torch.randn(truth.shape)
        truth, size = truth + tensors["residual"].double(), size + tensors["residual"].double().abs()
    truth = truth.relu() if relu else truth
    got = run(binary, device, "conv2d", tensors, params)["output"].double().view(truth.shape)
    terms = weight[1] * weight[2] * weight[3] + bias + residual
    bound = terms * EPS * size
    error = (got - truth).abs()
    good = bool((error <= bound).all())
    label = f"conv2d {list(shape)} * {list(weight)} stride {stride} padding {padding} dilation {dilation}"
    print(f"{'ok  ' if good else 'FAIL'} {label}: max error {error.max():.2e}, {(error / bound).max():.3f} of the bound")
    return good


def nms_case(binary, device, count: int, iou: float) -> bool:
    centre, extent = torch.rand(count, 2) * 120, torch.rand(count, 2) * 40 + 30
    boxes = torch.cat([centre - extent / 2, centre + extent / 2], dim=1)
    # Distinct scores, so that the order is defined in torchvision too.
    scores = (torch.randperm(count).float() + 0.5) / count
    out = run(binary, device, "nms", {"boxes": boxes, "scores": scores}, {"iou_threshold": iou})
    truth = ops.nms(boxes, scores, iou)
    number = int(out["count"].flatten()[0])
    got = out["keep"].flatten()[:number].long()
    good = torch.equal(got, truth)
    print(f"{'ok  ' if good else 'FAIL'} nms {count} boxes at {iou}: kept {number}, torchvision {len(truth)}, {'same indices' if good else 'indices differ'}")
    return good


def roi_align_case(binary, device, shape, count: int, scale: float) -> bool:
    features = torch.randn(shape)
    height, width = shape[1] / scale, shape[2] / scale
    low = torch.rand(count, 2) * torch.tensor([width, height]) * 1.1 - 0.05 * width
    boxes = torch.cat([low, low + torch.rand(count, 2) * torch.tensor([width, height]) * 0.5], dim=1)
    params = {"spatial_scale": scale, "output_size": 7, "sampling_ratio": 2}
    got = run(binary, device, "roi_align", {"features": features, "boxes": boxes}, params)["output"].double()

    def align(map: Tensor) -> Tensor:
        return ops.roi_align(map.double()[None], [boxes.double()], 7, scale, sampling_ratio=2, aligned=True)

    error = (got.view(count, shape[0], 7, 7) - align(features)).abs()
    # Sixteen products; and a sampling point, itself rounded by a few eps of its
    # size, moves the value by at most the largest difference of neighbours.
    reach = max(shape[1:]) * 2
    bound = EPS * (16 * align(features.abs()) + 16 * reach * features.abs().max())
    good = bool((error <= bound).all())
    print(f"{'ok  ' if good else 'FAIL'} roi_align {list(shape)}, {count} boxes, scale {scale}: max error {error.max():.2e}, {(error / bound).max():.3f} of the bound")
    return good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=Path, help="the smr-gpu program")
    parser.add_argument("--device", help="as smr-gpu's --device")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    good = [
        conv2d_case(args.binary, args.device, *case)
        for case in [
            # input, weight, stride, padding, dilation, relu, bias, residual
            ((3, 64, 64), (64, 3, 7, 7), 2, 3, 1, True, True, False),
            ((64, 40, 40), (64, 64, 3, 3), 1, 1, 1, True, True, True),
            ((64, 40, 40), (128, 64, 3, 3), 2, 1, 1, True, True, False),
            ((64, 37, 41), (128, 64, 1, 1), 2, 0, 1, False, True, False),
            ((128, 19, 23), (31, 128, 3, 3), 1, 2, 2, False, False, False),
            ((512, 10, 10), (256, 512, 3, 3), 1, 2, 2, True, True, False),
            ((2, 53, 47), (1, 2, 7, 7), 1, 3, 1, False, False, False),
            ((256, 11, 13), (12, 256, 1, 1), 1, 0, 1, False, True, False),
            ((1, 1, 1), (1, 1, 1, 1), 1, 0, 1, False, True, False),
        ]
    ]
    good += [nms_case(args.binary, args.device, n, iou) for n, iou in [(1, 0.5), (31, 0.5), (257, 0.5), (1000, 0.7), (1000, 0.3)]]
    good += [
        roi_align_case(args.binary, args.device, shape, n, scale)
        for shape, n, scale in [((256, 40, 40), 100, 0.125), ((17, 13, 11), 31, 0.125), ((3, 1, 1), 5, 0.0625)]
    ]
    print(f"{sum(good)} of {len(good)} agree")
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
