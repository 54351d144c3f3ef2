"""ONNX Runtime finds what PyTorch finds. `SMR_GPU=smr-gpu python tests/test_onnx.py`, where smr-gpu is the program"""

import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np
import onnxruntime
import torch

from smr_gpu_train import cli, weightfile
from smr_gpu_train.config import NETWORKS, Config, Variant
from smr_gpu_train.data import network_input, normalise
from smr_gpu_train.labels import read_folder
from smr_gpu_train.model import SmrNet
from smr_gpu_train.onnx import NAMES, export
from smr_gpu_train.pictures import entries

WEIGHTS = Path(__file__).parents[2] / "smrnet-s.safetensors"


def found(session: onnxruntime.InferenceSession, pixels: torch.Tensor) -> list[dict[str, np.ndarray]]:
    """Each picture's detections."""
    names = [output.name for output in session.get_outputs()]
    out = dict(zip(names, session.run(None, {"pixels": pixels.numpy()})))
    counts = (out["labels"] > 0).sum(axis=1)
    return [{name: values[i, :count] for name, values in out.items()} for i, count in enumerate(counts)]


class Onnx(unittest.TestCase):
    def setUp(self) -> None:
        kept = tempfile.TemporaryDirectory()
        self.addCleanup(kept.cleanup)
        self.root = Path(kept.name)

    def alike(self, wanted: dict[str, torch.Tensor], got: dict[str, np.ndarray], about: object) -> int:
        self.assertEqual(got["labels"].tolist(), wanted["labels"].tolist(), about)
        bounds = {"scores": 1e-4, "boxes": 0.01, "yaw_std": 0.01, "centre_std": 1e-4, "whole": 1e-4}
        for name, bound in bounds.items():
            if name in wanted:
                np.testing.assert_allclose(got[name], wanted[name].numpy(), rtol=0, atol=bound, err_msg=f"{about}: {name}")
        if "yaw" in wanted:
            # NaN where PyTorch has NaN.
            turn = (got["yaw"] - wanted["yaw"].numpy() + 180) % 360 - 180
            np.testing.assert_allclose(turn, np.where(wanted["yaw"].isnan(), np.nan, 0), rtol=0, atol=0.01, err_msg=f"{about}")
        return len(got["labels"])

    def test_detections_of_the_published_network(self) -> None:
        """50 pictures of many sizes, and two at once."""
        file = self.root / "small.onnx"
        self.assertEqual(cli.main(["onnx", "--weights", str(WEIGHTS), "--out", str(file)]), 0)
        session = onnxruntime.InferenceSession(file)
        net = weightfile.load(WEIGHTS)
        config = net.config
        self.assertEqual(Config.from_dict(json.loads(session.get_modelmeta().custom_metadata_map["config"])), config)
        total, shapes = 0, {}
        for conditions, seed in (("plain", 911), ("wide", 912)):
            folder = self.root / conditions
            subprocess.run([os.environ["SMR_GPU"], "simulate", "--out", folder, "--count", "25", "--seed", str(seed), "--conditions", conditions], check=True, capture_output=True)
            for i, entry in enumerate(entries(read_folder(folder), config.classes, config.directed)):
                pixels = network_input(entry.pixels(), config.pixels_per_mm * entry.mm_per_pixel)[0]
                wanted = net.detect(normalise(pixels, config.mean, config.std)[None].contiguous(memory_format=torch.channels_last))[0]
                (alone,) = found(session, pixels[None])
                total += self.alike(wanted, alone, (conditions, i))
                shapes.setdefault(tuple(pixels.shape), []).append((pixels, wanted))
        self.assertGreater(total, 40)
        self.assertGreater(len(shapes), 10)
        pair = next(pairs for pairs in shapes.values() if len(pairs) > 1)[:2]
        for got, (_, wanted) in zip(found(session, torch.stack([pixels for pixels, _ in pair])), pair, strict=True):
            self.alike(wanted, got, "two at once")

    def test_other_networks(self) -> None:
        """One class or five, without pose, of each ablation, and pictures of fewer anchors than are looked at."""
        for classes, directed, has_pose, variant in [
            (["clip"], [], True, Variant()),
            (list("vwxyz"), ["v", "z"], True, Variant(safe=False)),
            (["A", "B"], ["A"], False, Variant(rw=False)),
            (["A", "B"], ["A"], True, Variant(msff=False)),
        ]:
            torch.manual_seed(4)
            net = SmrNet(Config(classes=classes, directed=directed, pose=has_pose, variant=variant, **NETWORKS["small"]))
            with torch.no_grad():
                net.rpn.cls.weight.mul_(20)
                net.roi_head.cls_score.weight.mul_(40)
                net.roi_head.bbox_pred.weight.mul_(20)
            net = net.to(memory_format=torch.channels_last).eval()
            file = self.root / "random.onnx"
            export(net, file)
            session = onnxruntime.InferenceSession(file)
            self.assertEqual([output.name for output in session.get_outputs()], [*NAMES][: 7 if has_pose else 3])
            for size in ((32, 32), (96, 160)):
                pixels = torch.rand(1, 3, *size) * 255
                wanted = net.detect(normalise(pixels, net.config.mean, net.config.std).contiguous(memory_format=torch.channels_last))[0]
                (got,) = found(session, pixels)
                self.assertGreater(self.alike(wanted, got, (classes, variant, size)), 0)

    def test_a_name_that_is_none(self) -> None:
        self.assertEqual(cli.main(["onnx", "--weights", str(WEIGHTS), "--out", str(self.root / "x")]), 2)


if __name__ == "__main__":
    unittest.main()
