"""The network for other programs: in PyTorch, as ONNX and for ncnn."""

import subprocess
import sys
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "weights/training"))

from smr_gpu_train import model, weightfile  # noqa: E402

BACKBONE = ["backbone.cbam3", "backbone.cbam4", "backbone.cbam5"]
FEATURES = ["fusion.fused", "rpn.cls", "rpn.bbox"]


def load(file: Path, dtype: torch.dtype = torch.float32) -> model.SmrNet:
    return weightfile.load(file, dtype)


def plain_cbam(gates: model.Cbam, x: Tensor) -> Tensor:
    """CBAM in operations that exporters know."""
    channel, spatial = gates.channel, gates.spatial
    mlp = lambda pooled: channel.fc2(F.relu(channel.fc1(pooled.flatten(1))))  # noqa: E731
    gate = mlp(F.adaptive_avg_pool2d(x, 1)) + mlp(F.adaptive_max_pool2d(x, 1))
    x = x * gate.sigmoid()[:, :, None, None]
    pooled = torch.cat([x.amax(dim=1, keepdim=True), x.mean(dim=1, keepdim=True)], dim=1)
    return x * spatial.bn(spatial.conv(pooled)).sigmoid()


class Backbone(nn.Module):
    """A picture's tensor to the maps at strides 8, 16 and 32."""

    def __init__(self, net: model.SmrNet):
        super().__init__()
        self.net = net

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        stages = {}
        self.net.backbone(x, stages, scales=3)
        return tuple(stages[name] for name in BACKBONE)


class Features(nn.Module):
    """A picture's tensor to the fused map and the RPN heads."""

    def __init__(self, net: model.SmrNet):
        super().__init__()
        self.net = net

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        fused = self.net.features(x, {})
        return fused, self.net.rpn.cls(fused), self.net.rpn.bbox(fused)


class RoiHead(nn.Module):
    """Pooled regions [R, C, 7, 7] to scores and boxes."""

    def __init__(self, net: model.SmrNet):
        super().__init__()
        self.net = net

    def forward(self, pooled: Tensor) -> tuple[Tensor, ...]:
        heads = self.net.roi_head(pooled, {})
        return heads.scores, heads.regression


def export(weights: Path, x: Tensor, regions: int, folder: Path) -> None:
    """Writes features.onnx, roi_head.onnx and backbone.ncnn.{param,bin}."""
    net = load(weights).to(memory_format=torch.contiguous_format)
    pooled = torch.zeros(regions, net.config.width, 7, 7)
    own = model.Cbam.forward
    model.Cbam.forward = plain_cbam
    try:
        with torch.no_grad():
            for name, module, example in [
                ("features", Features(net), x),
                ("roi_head", RoiHead(net), pooled),
            ]:
                file = folder / f"{name}.onnx"
                torch.onnx.export(module.eval(), (example,), file, dynamo=False, opset_version=17, input_names=["x"])
            torch.jit.trace(Backbone(net).eval(), x).save(folder / "backbone.pt")
    finally:
        model.Cbam.forward = own
    shape = ",".join(map(str, x.shape))
    pnnx = Path(sys.executable).with_name("pnnx")
    subprocess.run([pnnx, "backbone.pt", f"inputshape=[{shape}]", "fp16=0"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
