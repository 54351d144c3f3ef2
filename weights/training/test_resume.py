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

HERE = Path(__file__).parent
PLAN = ["--crop-steps", "6", "--full-steps", "5", "--size", "128", "--crop", "96", "--batch", "2", "--full-batch", "2"]


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
        images.append({"id": i, "file_name": f"images/{i}.png", "width": 256, "height": 256})
        annotations.append({"id": i + 1, "image_id": i, "category_id": kind, "bbox": [x, y, w, h]})
    categories = [{"id": 1, "name": "A"}, {"id": 2, "name": "B"}]
    (folder / "annotations.json").write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))


def start(data: Path, out: Path) -> subprocess.Popen:
    command = [sys.executable, str(HERE / "train.py"), "--data", str(data), "--out", str(out), *PLAN]
    # Zero minutes between checkpoints: one after each step.
    return subprocess.Popen([*command, "--checkpoint-minutes", "0"], stdout=subprocess.DEVNULL)


def step_of(checkpoint: Path) -> int:
    return torch.load(checkpoint, weights_only=True)["step"] if checkpoint.exists() else 0


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        draw(root / "data", 6)
        assert start(root / "data", root / "whole").wait() == 0
        for until in (3, 8):  # killed once in each phase
            process = start(root / "data", root / "killed")
            while step_of(root / "killed" / "checkpoint.pt") < until:
                assert process.poll() is None, "ended before it could be killed"
                time.sleep(0.05)
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            at = step_of(root / "killed" / "checkpoint.pt")
            assert at < 11, "finished before it could be killed"
            print(f"killed after step {at}")
        assert start(root / "data", root / "killed").wait() == 0
        one, other = (torch.load(root / name / "checkpoint.pt", weights_only=True) for name in ("whole", "killed"))
        assert one["step"] == other["step"] == 11
        for part in ("model", "ema"):
            for name, tensor in one[part].items():
                assert torch.equal(tensor, other[part][name]), f"{part} {name} differs"
        print(f"{len(one['model'])} tensors, twice: equal bits")


if __name__ == "__main__":
    main()
