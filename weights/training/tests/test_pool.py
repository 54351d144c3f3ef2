"""Views from a pool show what their labels say. `python test_pool.py`"""

import json
import math
import tempfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from smr_gpu_train import parts, pool
from smr_gpu_train.config import Config
from smr_gpu_train.labels import read_folder
from smr_gpu_train.pictures import entries

PIXELS_PER_MM = 8.0
CONFIG = Config(pixels_per_mm=PIXELS_PER_MM)  # of classes A, which has a direction, and B
BLACK, BACK, SNAP, TIP = 0, 60, 160, 250


def write(folder: Path, sizes: list[tuple[int, int]], mm_per_pixel: float) -> None:
    """Pictures of a box each, a hook whose barb is the bright half to which its yaw points; black lines the frame."""
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(5)
    images, annotations = [], []
    for i, (width, height) in enumerate(sizes):
        picture = np.full((height, width, 3), BACK, np.uint8)
        picture[[0, -1]] = picture[:, [0, -1]] = BLACK
        w, h = (int(v) for v in rng.integers(60, 110, 2))
        x, y = int(rng.integers(5, width - w - 5)), int(rng.integers(5, height - h - 5))
        yaw = int(rng.integers(4))
        picture[y : y + h, x : x + w] = SNAP
        tip = [(slice(y, y + h), slice(x + w // 2, x + w)), (slice(y + h // 2, y + h), slice(x, x + w)), (slice(y, y + h), slice(x, x + w // 2)), (slice(y, y + h // 2), slice(x, x + w))]
        picture[tip[yaw]] = TIP
        Image.fromarray(picture).save(folder / "images" / f"{i}.png")
        images.append({"id": i, "file_name": f"images/{i}.png", "width": width, "height": height, "mm_per_pixel": mm_per_pixel})
        annotations.append({"id": i, "image_id": i, "category_id": 1, "bbox": [x, y, w, h], "yaw_deg": 90.0 * yaw, "whole": True})
    (folder / "annotations.json").write_text(json.dumps({"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "A"}]}))


def packed(folder: Path) -> parts.Part:
    return parts.pack(entries(read_folder(folder), CONFIG.classes, CONFIG.directed), PIXELS_PER_MM, 1)


def views_show_their_labels(root: Path) -> None:
    write(root / "set", [(300, 260), (420, 300), (300, 300), (340, 500), (600, 450), (280, 320)] * 4, 0.1)
    pictures = pool.Pool(CONFIG, 10**7, "cpu")
    part = packed(root / "set")
    part.save(root / "part.npz")
    assert pictures.add(parts.Part.load(root / "part.npz")) and len(pictures) == 24
    assert not pool.Pool(CONFIG, 1000, "cpu").add(part), "no room"
    snaps = cut = ignored = 0
    directions = set()
    pool.photometric = lambda x, seed: x
    for step in range(40):
        pixels, truth = pictures.batch(step, 16 * 192 * 192, 7)
        again, _ = pictures.batch(step, 16 * 192 * 192, 7)
        assert torch.equal(pixels, again), "a batch depends on its step and seed alone"
        for i, picture in enumerate(pixels[:, 0]):
            shown = picture > (BACK + SNAP) / 2
            found = torch.zeros_like(shown)
            for k in range(parts.SNAPS):
                for box, label in ((truth.boxes[i, k], truth.labels[i, k]), (truth.ignored[i, k], 0)):
                    x1, y1, x2, y2 = (round(v) for v in box.tolist())
                    if x2 <= x1:
                        continue
                    found[max(0, y1 - 2) : y2 + 2, max(0, x1 - 2) : x2 + 2] = True
                    inner = picture[y1 + 2 : y2 - 2, x1 + 2 : x2 - 2]
                    if not label:
                        ignored += 1
                        continue
                    snaps += 1
                    assert (inner > SNAP - 10).all(), f"step {step}, view {i}: the box shows less than a snap"
                    if not truth.whole[i, k]:
                        cut += 1
                        continue
                    yaw = truth.yaw[i, k].item()
                    half = torch.where(inner > (SNAP + TIP) / 2)
                    across = half[1].float().mean() - (inner.shape[1] - 1) / 2, half[0].float().mean() - (inner.shape[0] - 1) / 2
                    assert math.cos(yaw) * across[0] + math.sin(yaw) * across[1] > 5, f"step {step}, view {i}: the barb is elsewhere"
                    directions.add(round(math.degrees(yaw)) % 360)
            assert not (shown & ~found).any(), f"step {step}, view {i}: a snap without a box"
    assert snaps > 300 and cut > 10 and ignored > 5 and directions == {0, 90, 180, 270}, (snaps, cut, ignored, directions)
    print(f"ok {snaps} snaps lie in their boxes, {cut} of them cut; {ignored} are to be ignored")


def scales_are_the_networks(root: Path) -> None:
    """A snap of 10 mm is 64 to 100 pixels long, on whatever frame."""
    write(root / "fine", [(500, 500)] * 4, 0.05)
    write(root / "coarse", [(320, 300)] * 4, 0.11)
    pictures = pool.Pool(CONFIG, 10**7, "cpu")
    for name in ("fine", "coarse"):
        pictures.add(packed(root / name))
    generator = torch.Generator().manual_seed(1)
    index, sizes, _ = pictures._choose(200, (128, 128), False, generator)
    millimetres = torch.tensor([25.0] * 4 + [320 * 0.11] * 4)[index]
    ratio = sizes[:, 1] / millimetres / PIXELS_PER_MM
    assert 0.79 < ratio.min() < 0.85 and 1.18 < ratio.max() < 1.26, (ratio.min(), ratio.max())
    print("ok scales vary by a quarter about the network's")


def mixed_in_views_are_their_share(root: Path) -> None:
    """However many pictures there are, and however well they fill the window; without a mix nothing changes."""
    write(root / "few", [(320, 300)] * 3, 0.1)
    write(root / "many", [(250, 260)] * 40, 0.1)
    few, many = (packed(root / name) for name in ("few", "many"))
    views = 4000
    for share in (0.2, 0.5, 0.9):
        pictures = pool.Pool.of([few], CONFIG, "cpu", [many], share)
        for whole, window in ((False, (128, 128)), (True, (320, 320))):
            index, _, _ = pictures._choose(views, window, whole, torch.Generator().manual_seed(3))
            got = (index >= 3).float().mean().item()
            # Three deviations of a binomial.
            assert abs(got - share) < 3 * math.sqrt(share * (1 - share) / views), (share, whole, got)
            times = torch.bincount(index, minlength=43).float()
            if not whole:
                assert times[:3].min() > 0.8 * times[:3].mean() and times[3:].min() > 0, times
    alone, unmixed = pool.Pool(CONFIG, 10**7, "cpu"), pool.Pool.of([few, many], CONFIG, "cpu", [], 0.5)
    alone.add(few), alone.add(many)
    for step in range(4):
        one, other = (pictures.batch(step, 16 * 192 * 192, 7) for pictures in (alone, unmixed))
        assert torch.equal(one[0], other[0]) and torch.equal(one[1].boxes, other[1].boxes)
    print("ok mixed in pictures have their share of the views")


def snap(box: list, label: int, degrees: float) -> tuple[torch.Tensor, ...]:
    """One snap of one picture: its box, label and yaw."""
    return torch.tensor([[box]], dtype=torch.float32), torch.tensor([[label]]), torch.tensor([[degrees]]).deg2rad()


def turns(_: Path) -> None:
    # A 4 x 2 snap with its box at (10, 20) in a crop of 100 x 60, its barb 30 degrees below +x: right and down.
    cases = {
        (False, False, False): ([10, 20, 14, 22], 30),
        (True, False, False): ([86, 20, 90, 22], 150),  # left and down
        (False, True, False): ([10, 38, 14, 40], -30),  # right and up
        (True, True, False): ([86, 38, 90, 40], -150),  # half a turn
        (False, False, True): ([20, 10, 22, 14], 60),  # x for y
        (True, False, True): ([20, 86, 22, 90], -60),  # a quarter turn: right becomes up
        (False, True, True): ([38, 10, 40, 14], 120),  # the other: right becomes down
        (True, True, True): ([38, 86, 40, 90], -120),
    }
    yes, crop = torch.tensor([[True]]), torch.tensor([[100.0, 60.0]])
    for (across, down, side), (box, degrees) in cases.items():
        for label, yaw in ((1, 30.0), (2, math.nan)):
            flips = torch.tensor([[across, down]]), torch.tensor([side])
            truth = pool.orient(*snap([10, 20, 14, 22], label, yaw), yes, yes, ~yes, crop, *flips)
            assert truth.boxes.tolist() == [[box]] and truth.labels.item() == label, (across, down, side)
            assert not truth.ignored.any()
            off = (math.degrees(truth.yaw.item()) - degrees + 180) % 360 - 180
            # A part without a direction stays without.
            assert math.isnan(off) if label == 2 else abs(off) < 1e-4, f"{across}, {down}, {side}: {off}"
    print("ok turns: 8")


def cuts(_: Path) -> None:
    def one(box: list, label: int, degrees: float) -> tuple:
        corner, crop = torch.tensor([[[10.0, 10.0]]]), torch.tensor([[[100.0, 100.0]]])
        moved, keep, ignored, uncut = pool.cut(*snap(box, label, degrees), torch.tensor([False, True, False]), corner, crop)
        return moved[0, 0].tolist(), keep.item(), ignored.item(), uncut.item()

    assert one([30, 40, 50, 60], 1, 0.0) == ([20, 30, 40, 50], True, False, True)
    # A fifth is lost at the left: a hook that stands upright and a ring are cut, a slanted hook's box is not known.
    left = [6, 40, 26, 60]
    assert one(left, 1, 90.0) == ([0, 30, 16, 50], True, False, False)
    assert one(left, 2, math.nan) == ([0, 30, 16, 50], True, False, False)
    assert one(left, 1, 45.0) == ([0, 30, 16, 50], False, True, False)
    assert one(left, 1, math.nan) == ([0, 30, 16, 50], False, True, False)
    # Half is lost; all is lost; a row that is no snap.
    assert one([0, 40, 20, 60], 2, math.nan) == ([0, 30, 10, 50], False, True, False)
    assert one([0, 40, 9, 60], 2, math.nan)[1:3] == (False, False)
    assert one([0, 0, 0, 0], 0, 0.0)[1:3] == (False, False)
    print("ok cuts: 8")


if __name__ == "__main__":
    for test in (turns, cuts, views_show_their_labels, scales_are_the_networks, mixed_in_views_are_their_share):
        with tempfile.TemporaryDirectory() as root:
            test(Path(root))
