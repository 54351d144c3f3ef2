"""Parts are of the pictures that are there. `python test_parts.py`"""

import json
import math
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import parts


def write(folder: Path, shades: list[int], snaps: list[int] = (), size: int = 8) -> None:
    """Even pictures of 8 x 8, and beside each shade how many snaps of 4 x 4 it has; `size` is what the labels state."""
    images = [{"id": i, "file_name": f"{i}.png", "width": size, "height": size, "mm_per_pixel": 0.1} for i in range(len(shades))]
    for image, shade in zip(images, shades):
        Image.new("L", (8, 8), shade).save(folder / image["file_name"])
    annotations = [{"image_id": i, "category_id": 1, "bbox": [1, 2, 4, 4], "yaw_deg": 90, "whole": True} for i, count in enumerate(snaps) for _ in range(count)]
    (folder / "annotations.json").write_text(json.dumps({"images": images, "categories": [{"id": 1, "name": "A"}], "annotations": annotations}))


def shades(folder: Path, cache: Path, pixels_per_mm: float = 4) -> list[int]:
    part = parts.cached(folder, pixels_per_mm, cache)
    side = round(0.8 * pixels_per_mm * parts.JITTER)
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
    read, parts.read_picture = parts.read_picture, None
    try:
        assert shades(folder, cache) == [10, 20]
        moved = folder.rename(folder.with_name("elsewhere")).rename(folder.parent / "again" / folder.name)
        assert shades(moved, cache) == [10, 20]
    finally:
        parts.read_picture = read
    print("ok the same pictures are not, wherever they lie")


def snaps_are_in_small_pixels(folder: Path, cache: Path) -> None:
    """Of pictures with none, two and one too many the last is left out; half the pixels, half the box."""
    write(folder, [10, 20, 30], [0, 2, parts.SNAPS + 1])
    part = parts.cached(folder, 4, cache)
    assert len(part.sizes) == len(part.snaps) == 2
    assert (part.snaps[0] == 0).all() and (part.snaps[1, 2:] == 0).all()
    assert np.allclose(part.snaps[1, :2], [0.5, 1, 2.5, 3, 1, math.pi / 2, 1])
    # One of a single pixel is none.
    write(folder, [10], [1])
    assert (parts.cached(folder, 2, cache).snaps == 0).all()
    print("ok snaps are scaled with their pictures")


def other_sizes_are_refused(folder: Path, cache: Path) -> None:
    write(folder, [10], size=9)
    try:
        parts.cached(folder, 4, cache)
    except SystemExit as error:
        assert "0.png: expected (9, 9) pixels (height, width), got (8, 8)" in str(error)
    else:
        raise AssertionError("a picture of another size than stated was taken")
    print("ok a picture of another size than stated is refused")


if __name__ == "__main__":
    for test in (cache_is_of_the_content, cache_is_used, snaps_are_in_small_pixels, other_sizes_are_refused):
        with tempfile.TemporaryDirectory() as root:
            folder, cache = Path(root) / "set", Path(root) / "cache"
            folder.mkdir()
            (Path(root) / "again").mkdir()
            test(folder, cache)
