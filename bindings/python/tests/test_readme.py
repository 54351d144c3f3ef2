"""The README's snippets run as they stand."""

import re
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from conftest import ROOT
from PIL import Image

README = (Path(__file__).parents[1] / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with what the snippets name."""
    monkeypatch.chdir(tmp_path)
    picture = Image.open(ROOT / "samples/mixed.png").convert("RGB")
    picture.save("picture.png")
    frames = np.stack([np.array(picture)] * 5)
    iio.imwrite("press.mp4", frames, plugin="pyav", codec="mpeg4", fps=25)
    return tmp_path


def run(at, capsys):
    exec(compile(SNIPPETS[at], f"README.md, snippet {at + 1}", "exec"), {})
    return capsys.readouterr().out


def test_there_are_three():
    assert len(SNIPPETS) == 3


def test_an_image(folder, capsys):
    out = run(0, capsys).splitlines()
    assert sorted(line.split()[0] for line in out) == ["A", "A", "B"]
    with Image.open("found.png") as drawn:
        assert drawn.size == (1000, 1000)


def test_a_video(folder, capsys):
    assert len(run(1, capsys).splitlines()) == 5


def test_a_batch(folder, capsys):
    assert "(2, 1000, 1000, 3)" in run(2, capsys)
