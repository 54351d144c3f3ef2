"""The cache of small pictures is of the pictures that are there. `python test_data.py`"""

import json
import tempfile
from pathlib import Path

from PIL import Image

import data


def write(folder: Path, shades: list[int]) -> None:
    images = [{"id": i, "file_name": f"{i}.png", "width": 8, "height": 8, "mm_per_pixel": 0.1} for i in range(len(shades))]
    for image, shade in zip(images, shades):
        Image.new("L", (8, 8), shade).save(folder / image["file_name"])
    (folder / "annotations.json").write_text(json.dumps({"images": images, "categories": [], "annotations": []}))


def shades(folder: Path, cache: Path, pixels_per_mm: float = 5) -> list[int]:
    chunk = data.Chunk(folder, pixels_per_mm, cache)
    side = round(0.8 * pixels_per_mm)
    pictures = [chunk.picture(i) for i in range(len(chunk))]
    assert all(p.shape == (side, side, 3) and (p == p[0, 0, 0]).all() for p in pictures)
    return [int(p[0, 0, 0]) for p in pictures]


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
    assert shades(folder, cache, 2.5) == [30, 10]
    assert len(list(cache.iterdir())) == 4
    print("ok replaced pictures are read again")


def cache_is_used(folder: Path, cache: Path) -> None:
    write(folder, [10, 20])
    assert shades(folder, cache) == [10, 20]
    read, data.read_picture = data.read_picture, None
    try:
        assert shades(folder, cache) == [10, 20]
        moved = folder.rename(folder.with_name("elsewhere")).rename(folder.parent / "again" / folder.name)
        assert shades(moved, cache) == [10, 20]
    finally:
        data.read_picture = read
    print("ok the same pictures are not, wherever they lie")


if __name__ == "__main__":
    for test in (cache_is_of_the_content, cache_is_used):
        with tempfile.TemporaryDirectory() as root:
            folder, cache = Path(root) / "set", Path(root) / "cache"
            folder.mkdir()
            (Path(root) / "again").mkdir()
            test(folder, cache)
