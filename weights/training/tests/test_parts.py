"""Parts are of the pictures that are there. `python test_parts.py`"""

import json
import math
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from smr_gpu_train import parts
from smr_gpu_train.errors import Failure
from smr_gpu_train.labels import read_folder
from smr_gpu_train.pictures import entries

SIDE = 120  # pixels of 0.1 mm: a field that a sensor can have


def write(folder: Path, shades: list[int], snaps: list[int] = (), size: int = SIDE) -> None:
    """Even pictures, and beside each shade how many snaps of 4 x 4 it has; `size` is what the labels state."""
    images = [{"id": i, "file_name": f"{i}.png", "width": size, "height": size, "mm_per_pixel": 0.1} for i in range(len(shades))]
    for image, shade in zip(images, shades):
        Image.new("L", (SIDE, SIDE), shade).save(folder / image["file_name"])
    annotations = [{"image_id": i, "category_id": 1, "bbox": [1, 2, 4, 4], "yaw_deg": 90, "whole": True} for i, count in enumerate(snaps) for _ in range(count)]
    (folder / "annotations.json").write_text(json.dumps({"images": images, "categories": [{"id": 1, "name": "A"}], "annotations": annotations}))


def part_of(folder: Path, cache: Path, pixels_per_mm: float = 4) -> parts.Part:
    return parts.cached(read_folder(folder), ["A"], ["A"], pixels_per_mm, cache)[0]


def shades(folder: Path, cache: Path, pixels_per_mm: float = 4) -> list[int]:
    part = part_of(folder, cache, pixels_per_mm)
    side = round(SIDE * 0.1 * pixels_per_mm * parts.JITTER)
    assert (part.sizes == side).all() and np.allclose(part.scales, pixels_per_mm * parts.JITTER)
    pictures = part.pixels.reshape(len(part.sizes), side * side, 3)
    assert (pictures == pictures[:, :1, :1]).all()
    return pictures[:, 0, 0].tolist()


def cache_is_of_the_content(folder: Path, cache: Path) -> None:
    write(folder, [10, 20])
    assert shades(folder, cache) == [10, 20]
    # The same number of pictures of the same names, sizes and times.
    stat = (folder / "1.png").stat()
    write(folder, [10, 30])
    assert (folder / "1.png").stat().st_size == stat.st_size
    assert shades(folder, cache) == [10, 30], "replaced pictures train on old pixels"
    write(folder, [30, 10])
    assert shades(folder, cache) == [30, 10], "pictures changed places"
    assert shades(folder, cache, 2) == [30, 10]
    assert len(list(cache.iterdir())) == 4
    print("ok replaced pictures are read again")


def cache_is_used(folder: Path, cache: Path) -> None:
    write(folder, [10, 20])
    assert shades(folder, cache) == [10, 20]
    pack, parts.pack = parts.pack, None
    try:
        assert shades(folder, cache) == [10, 20]
    finally:
        parts.pack = pack
    print("ok the same pictures are not")


def snaps_are_in_small_pixels(folder: Path, cache: Path) -> None:
    """Half the pixels, half the box; of pictures with none, two and nine none is left out."""
    write(folder, [10, 20, 30], [0, 2, parts.SNAPS + 1])
    part = part_of(folder, cache)
    assert part.snaps.shape == (3, parts.SNAPS + 1, 7)
    assert (part.snaps[0] == 0).all() and (part.snaps[1, 2:] == 0).all() and (part.snaps[2, :, 4] == 1).all()
    assert np.allclose(part.snaps[1, :2], [0.5, 1, 2.5, 3, 1, math.pi / 2, 1])
    # One of a single pixel is none, and is counted.
    write(folder, [10], [1])
    assert (part_of(folder, cache, 2).snaps == 0).all()
    pictures = entries(read_folder(folder), ["A"], ["A"])
    assert (parts.narrow(pictures, 2), parts.narrow(pictures, 4)) == (1, 0)
    print("ok snaps are scaled with their pictures")


def other_sizes_are_refused(folder: Path, cache: Path) -> None:
    write(folder, [10], size=SIDE + 1)
    try:
        part_of(folder, cache)
    except Failure as error:
        assert "0.png: expected (121, 121) pixels (height, width) as labelled, got (120, 120)" in str(error)
    else:
        raise AssertionError("a picture of another size than stated was taken")
    print("ok a picture of another size than stated is refused")


if __name__ == "__main__":
    parts.jpeg = lambda picture, _: picture  # would change shades
    for test in (cache_is_of_the_content, cache_is_used, snaps_are_in_small_pixels, other_sizes_are_refused):
        with tempfile.TemporaryDirectory() as root:
            folder, cache = Path(root) / "set", Path(root) / "cache"
            folder.mkdir()
            test(folder, cache)
