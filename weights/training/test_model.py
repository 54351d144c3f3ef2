"""The quick forms used in training against their definitions. `python test_model.py`"""

import torch
from torchvision import ops
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection._utils import BoxCoder
from torchvision.models.detection.image_list import ImageList

import boxes as bx
from gates import PoolChannels, PoolSpace, ScaleChannels, ScaleSpace


def same(name: str, got: torch.Tensor, truth: torch.Tensor, bound: float = 1e-10) -> None:
    error = (got - truth).abs().max().item()
    assert error <= bound, f"{name}: {error} > {bound}"
    print(f"ok {name}: {error:.1e}")


def gates() -> None:
    x = torch.randn(2, 6, 5, 7, dtype=torch.float64).contiguous(memory_format=torch.channels_last)
    channel, space = torch.rand(2, 6, dtype=torch.float64), torch.rand(2, 1, 5, 7, dtype=torch.float64)
    cases = [
        ("PoolSpace", PoolSpace, (x,), lambda x: torch.stack([x.mean((2, 3)), x.amax((2, 3))])),
        ("PoolChannels", PoolChannels, (x,), lambda x: torch.cat([x.amax(1, True), x.mean(1, True)], 1)),
        ("ScaleChannels", ScaleChannels, (x, channel), lambda x, g: x * g[:, :, None, None]),
        ("ScaleSpace", ScaleSpace, (x, space), lambda x, g: x * g),
    ]
    for name, quick, inputs, plain in cases:
        inputs = tuple(i.requires_grad_() for i in inputs)
        got, truth = quick.apply(*inputs), plain(*inputs)
        same(name, got, truth)
        weight = torch.randn_like(truth)
        pairs = zip(torch.autograd.grad(got, inputs, weight), torch.autograd.grad(truth, inputs, weight))
        for i, (a, b) in enumerate(pairs):
            same(f"{name}, gradient of input {i}", a, b)


def roi_align() -> None:
    # Inside, partly outside, wholly outside, tiny; float32 sampling weights give the bound.
    features = torch.randn(2, 5, 24, 20, requires_grad=True)
    boxes = [torch.tensor([[3.0, 5, 60, 90], [-5, -3, 20, 200], [300, 10, 320, 40]]), torch.tensor([[10.0, 10, 11, 12]])]
    got, truth = bx.roi_align_dense(features, boxes, 1 / 8), ops.roi_align(features, boxes, 7, 1 / 8, 2, aligned=True)
    same("roi_align_dense", got, truth, 2e-5)
    weight = torch.randn_like(truth)
    same("roi_align_dense, gradient", *(torch.autograd.grad(o, features, weight)[0] for o in (got, truth)), 2e-4)


def anchors_and_coder() -> None:
    sizes, ratios = [31.0, 45.0, 70.0], [0.61, 1.0, 1.64]
    generator = AnchorGenerator((tuple(sizes),), (tuple(ratios),))
    truth = generator(ImageList(torch.zeros(1, 3, 96, 64), [(96, 64)]), [torch.zeros(1, 1, 12, 8)])[0]
    got = bx.grid_anchors(bx.cell_anchors(sizes, ratios), 12, 8, 8)
    same("anchors", got, truth.double(), 0.0)
    deltas = torch.randn(len(truth), 4) * torch.tensor([1.0, 1, 2, 3])
    coder = BoxCoder(bx.ROI_WEIGHTS)
    same("decode", bx.decode(deltas, truth, bx.ROI_WEIGHTS), coder.decode_single(deltas, truth), 1e-3)
    target = bx.decode(deltas / 4, truth, bx.RPN_WEIGHTS)
    same("encode", bx.encode(target, truth, bx.RPN_WEIGHTS), BoxCoder(bx.RPN_WEIGHTS).encode_single(target, truth), 1e-5)


if __name__ == "__main__":
    torch.manual_seed(0)
    gates()
    roi_align()
    anchors_and_coder()
