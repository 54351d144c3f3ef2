"""What the tests share: the samples, the program, a detector."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import smr_gpu

ROOT = Path(__file__).parents[3]
SAMPLES = sorted((ROOT / "samples").glob("*.png"))
DEVICE = os.environ.get("SMR_GPU_TEST_DEVICE", "cpu")


@pytest.fixture(scope="session")
def detector():
    return smr_gpu.Detector(device=DEVICE)


@pytest.fixture(scope="session")
def mixed():
    """The array of samples/mixed.png, 1000 × 1000 × 3, with a hook and more."""
    return np.array(Image.open(ROOT / "samples/mixed.png").convert("RGB"))


@pytest.fixture(scope="session")
def program():
    """The program's `detect --json` of pictures, an object each."""
    path = Path(os.environ.get("SMR_GPU_PROGRAM", ROOT / "target/release/smr-gpu"))

    def detect(*args):
        command = [path, "detect", "--json", "--weights", "small", "--device", DEVICE, *args]
        run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
        return [json.loads(line) for line in run.stdout.splitlines()]

    return detect


def same(one, other):
    """Whether two answers have the same bits, whatever time they took."""
    names = ("boxes", "scores", "labels", "center_mm", "center_std_mm", "yaw_deg", "yaw_std_deg", "whole")
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in names)
