"""CBAM's pooling and gating with gradients that are quick on a CPU.

Same numbers as mean, amax and `*`; autograd's own backward of these reduces
bfloat16 maps through float32 copies and costs more than the convolutions.
Here sums over space or channels are matrix products with ones.
"""

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function


def _flat(x: Tensor) -> Tensor:
    """[B, C, H, W] in channels_last as [B, H * W, C], without a copy."""
    return x.permute(0, 2, 3, 1).reshape(x.shape[0], -1, x.shape[1])


def _map(x: Tensor, height: int, width: int) -> Tensor:
    return x.view(x.shape[0], height, width, x.shape[2]).permute(0, 3, 1, 2)


class PoolSpace(Function):
    """Mean and maximum over space: [2, B, C]."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        flat = _flat(x)
        mean = (flat.new_ones(len(flat), 1, flat.shape[1]) @ flat)[:, 0] / flat.shape[1]
        top, index = flat.max(dim=1)
        ctx.save_for_backward(index)
        ctx.size = x.shape[2:]
        return torch.stack([mean, top])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (index,) = ctx.saved_tensors
        height, width = ctx.size
        flat = (grad[0] / (height * width))[:, None, :].expand(-1, height * width, -1).contiguous()
        flat.scatter_add_(1, index[:, None, :], grad[1][:, None, :])
        return _map(flat, height, width)


class PoolChannels(Function):
    """Maximum and mean over channels: [B, 2, H, W]."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        flat = _flat(x)
        mean = (flat @ flat.new_ones(flat.shape[2], 1)) / flat.shape[2]
        top, index = flat.max(dim=2, keepdim=True)
        ctx.save_for_backward(index)
        ctx.shape = x.shape
        return _map(torch.cat([top, mean], dim=2), *x.shape[2:])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (index,) = ctx.saved_tensors
        _, channels, height, width = ctx.shape
        grad = _flat(grad)
        flat = (grad[:, :, 1:] / channels).expand(-1, -1, channels).contiguous()
        flat.scatter_add_(2, index, grad[:, :, :1].contiguous())
        return _map(flat, height, width)


class ScaleChannels(Function):
    """x [B, C, H, W] times gate [B, C]."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, gate: Tensor) -> Tensor:
        ctx.save_for_backward(x, gate)
        return _map(_flat(x) * gate[:, None, :], *x.shape[2:])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
        x, gate = ctx.saved_tensors
        flat = _flat(grad)
        product = flat * _flat(x)
        to_gate = (product.new_ones(len(product), 1, product.shape[1]) @ product)[:, 0]
        return _map(flat * gate[:, None, :], *x.shape[2:]), to_gate


class ScaleSpace(Function):
    """x [B, C, H, W] times gate [B, 1, H, W]."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, gate: Tensor) -> Tensor:
        gate = _flat(gate)
        ctx.save_for_backward(x, gate)
        return _map(_flat(x) * gate, *x.shape[2:])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
        x, gate = ctx.saved_tensors
        flat = _flat(grad)
        product = flat * _flat(x)
        to_gate = product @ product.new_ones(product.shape[2], 1)
        return _map(flat * gate, *x.shape[2:]), _map(to_gate, *x.shape[2:])
