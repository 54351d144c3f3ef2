"""A run that is killed and resumed ends with the bits of an uninterrupted run. `python test_resume.py`"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

import weightfile
from export import random_model
from model import NETWORKS, Config

HERE = Path(__file__).parent
STEPS = 11


def draw(folder: Path, count: int) -> None:
    """A COCO folder of plain shapes."""
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(0)
    images, annotations = [], []
    for i in range(count):
        picture = Image.new("RGB", (256, 256), (120, 130, 140))
        x, y, w, h = (int(v) for v in rng.integers(40, 100, 4))
        kind = int(rng.integers(1, 3))
        pen = ImageDraw.Draw(picture)
        (pen.rectangle if kind == 1 else pen.ellipse)([x, y, x + w, y + h], outline=(200, 90, 90), width=6)
        picture.save(folder / "images" / f"{i}.png")
        images.append({"id": i, "file_name": f"images/{i}.png", "width": 256, "height": 256, "mm_per_pixel": 0.1})
        annotations.append({"id": i + 1, "image_id": i, "category_id": kind, "bbox": [x, y, w, h], "yaw_deg": 90.0 * int(rng.integers(4)), "whole": True})
    categories = [{"id": 1, "name": "A"}, {"id": 2, "name": "B"}]
    (folder / "annotations.json").write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))


def start(data: Path, out: Path, teacher: Path) -> subprocess.Popen:
    command = [sys.executable, str(HERE / "train.py"), "--out", str(out)]
    if (out / "checkpoint.pt").exists():
        command += ["--resume"]
    else:
        # Zero minutes between checkpoints: one after each step.
        command += ["--data", str(data), "--network", "small", "--teacher", str(teacher), "--student", "small", "--steps", str(STEPS), "--area", str(2 * 160 * 160)]
        command += ["--checkpoint-minutes", "0"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def step_of(checkpoint: Path) -> int:
    return torch.load(checkpoint, weights_only=True)["step"] if checkpoint.exists() else 0


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        draw(root / "data", 6)
        weightfile.save(random_model(Config(**NETWORKS["small"]), 1), root / "teacher.safetensors")
        runs = {name: (root / "data", root / name, root / "teacher.safetensors") for name in ("whole", "killed")}
        assert start(*runs["whole"]).wait() == 0
        for until in (3, 7):
            process = start(*runs["killed"])
            while step_of(root / "killed" / "checkpoint.pt") < until:
                assert process.poll() is None, "ended before it could be killed"
                time.sleep(0.05)
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            at = step_of(root / "killed" / "checkpoint.pt")
            assert at < STEPS, "finished before it could be killed"
            print(f"killed after step {at}")
        assert start(*runs["killed"]).wait() == 0
        one, other = (torch.load(root / name / "checkpoint.pt", weights_only=True) for name in ("whole", "killed"))
        assert one["step"] == other["step"] == STEPS
        for of, (one, other) in {"": (one, other), "student ": (one["student"], other["student"])}.items():
            for part in ("model", "ema", "distiller"):
                for name, tensor in one[part].items():
                    assert torch.equal(tensor, other[part][name]), f"{of}{part} {name} differs"
        print(f"two networks of {len(one['model'])} tensors, their averages and projections: equal bits")


if __name__ == "__main__":
    main()
