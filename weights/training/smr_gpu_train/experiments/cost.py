"""What a network costs: parameters, multiply-adds, and its time through ONNX Runtime on one thread of this CPU."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .. import onnx as detector
from ..data import normalise
from ..model import SmrNet
from .models import Fast

ROIS = 100
RUNS = 11


def multiply_adds(model: SmrNet, height: int = 320, width: int = 320, regions: int = ROIS) -> int:
    """Of convolutions and linear layers on one picture with so many regions; the CBAMs' pooling and scaling are not counted."""
    total = 0

    def count(layer: nn.Module, inputs: tuple, output: Tensor) -> None:
        nonlocal total
        assert isinstance(layer.weight, Tensor)
        total += output.numel() * layer.weight[0].numel()

    hooks = [m.register_forward_hook(count) for m in model.modules() if isinstance(m, (nn.Conv2d, nn.Linear))]
    with torch.no_grad():
        fused = model.eval().features(torch.zeros(1, 3, height, width), {})
        if not isinstance(model, Fast):
            model.rpn_heads(fused, {})
        model.roi_head(torch.zeros(regions, model.config.width, 7, 7), {})
    for hook in hooks:
        hook.remove()
    return total


def of_onnx(file: Path) -> tuple[int, int]:
    """Parameters and multiply-adds of an ONNX file's convolutions, whose input has a fixed size."""
    import onnx

    model = onnx.shape_inference.infer_shapes(onnx.load(file))
    weights = {each.name: [*each.dims] for each in model.graph.initializer}
    shapes = {v.name: [d.dim_value for d in v.type.tensor_type.shape.dim] for v in [*model.graph.value_info, *model.graph.output]}
    total = sum(int(np.prod(shapes[node.output[0]])) * int(np.prod(weights[node.input[1]][1:])) for node in model.graph.node if node.op_type == "Conv")
    used = {name for node in model.graph.node if node.op_type in ("Conv", "ConvTranspose", "Gemm") for name in node.input}
    return sum(int(np.prod(shape)) for name, shape in weights.items() if name in used), total


class WithRegions(nn.Module):
    """Fast R-CNN from pixels and regions to what the head says of them."""

    def __init__(self, net: Fast):
        super().__init__()
        self.net = net

    def forward(self, pixels: Tensor, regions: Tensor) -> tuple[Tensor, Tensor]:
        config = self.net.config
        heads = self.net.heads_of(normalise(pixels, config.mean, config.std), regions)
        return heads.scores.softmax(dim=1), heads.regression


def export(model: SmrNet, file: Path, pixels: Tensor, regions: Tensor | None) -> dict[str, np.ndarray]:
    """Writes the network as ONNX; inputs for it, of one picture [3, H, W]."""
    inputs = {"pixels": pixels[None].numpy()}
    if isinstance(model, Fast):
        assert regions is not None
        inputs["regions"] = regions.numpy()
        with torch.no_grad():
            torch.onnx.export(WithRegions(model).eval(), (pixels[None], regions), str(file), dynamo=False, opset_version=detector.OPSET, input_names=[*inputs])
    else:
        detector.export(model, file)
    return inputs


def milliseconds(file: Path, inputs: Callable[[Any], dict[str, np.ndarray]]) -> float:
    """Of processor time, as cores are shared with other work: the median of some runs on one thread. `inputs` knows what the session asks for."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    given, taken = inputs(session), []
    for _ in range(RUNS + 1):
        began = time.process_time()
        session.run(None, given)
        taken.append(time.process_time() - began)
    return 1000 * float(np.median(taken[1:]))  # the first warms up
