"""Whether labels of `other_renderers.py` say what its pictures show."""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))

from scipy.ndimage import distance_transform_edt

from other_renderers import BESIDE, BUILT_IN, BUILT_IN_OF, GAP_MM, LOOKS, PRESSED, SNAPS, Relief, draw, hook, lit, own, pair, stud


def bracket(root: Path) -> Relief:
    """A plate of 8 x 4 mm, 1 mm under a step at its +x end that covers the half of that end towards +y; from a map with a black border."""
    levels = np.zeros((110, 200), np.uint16)
    levels[15:95, 20:180] = 1
    levels[55:95, 150:180] = 65535
    Image.fromarray(levels).save(root / "map.png")
    return Relief.read(f"{root}/map.png:0.05:1.0")


def departure(picture: np.ndarray) -> np.ndarray:
    """How far a map of the normals is from flat gel's grey, in levels."""
    return abs(picture.astype(int) - 128).max(-1)


def test_boxes_hold_what_changes() -> None:
    """In a map of the normals flat gel is grey, and in a box is what is not; boxes lie in the picture; hooks have a yaw."""
    width, height = LOOKS["normals"][1:]
    seen = set()
    for seed in range(30):
        picture, labels = draw("normals", "snaps", np.random.default_rng(seed))
        assert picture.shape == (height, width, 3)
        changed = departure(picture) > 20
        for label in labels:
            left, top, box_width, box_height = label["bbox"]
            assert left >= 0 and top >= 0 and left + box_width <= width and top + box_height <= height
            box = changed[top : top + box_height, left : left + box_width]
            # Its outline is a slope: more than half a box's length in pixels.
            assert box.sum() > max(box_width, box_height) / 2, (seed, label)
            assert (label["yaw_deg"] is None) == (label["category_id"] == 2)
            seen.add(label["category_id"])
    assert seen == {1 + i for i in range(len(SNAPS))}


def test_a_hook_points_to_its_barb() -> None:
    """A hook's relief is steepest at its barb, which lies from the box's middle towards its yaw."""
    right = total = 0
    for seed in range(60):
        picture, labels = draw("normals", "snaps", np.random.default_rng(seed))
        change = (departure(picture) - 20).clip(0)
        for label in labels:
            if label["yaw_deg"] is None:
                continue
            left, top, width, height = label["bbox"]
            box = change[top : top + height, left : left + width]
            y, x = np.indices(box.shape)
            yaw = np.radians(label["yaw_deg"])
            along = (x + 0.5 - width / 2) * np.cos(yaw) + (y + 0.5 - height / 2) * np.sin(yaw)
            right += (box * along).sum() > 0
            total += 1
    # Of hooks whose barb alone presses the steep face may lie behind the middle.
    assert total > 20 and right >= 0.8 * total, (right, total)


def test_look_alikes_have_no_label() -> None:
    for look in LOOKS:
        assert draw(look, "none", np.random.default_rng(3))[1] == []
        assert draw(look, "round", np.random.default_rng(3), BUILT_IN_OF["round"])[1] == []


def test_a_wall_is_in_no_box() -> None:
    """A hook is where it is without its wall, and points away from it: behind hooks more changes than without."""
    behind_hooks = np.zeros(2)
    hooks = 0
    for seed in range(40):
        with_wall, without = (draw("normals", scene, np.random.default_rng(seed)) for scene in ("wall", "snaps"))
        if not without[1] or without[1][0]["yaw_deg"] is None:
            continue
        # The first part's shape is drawn before its wall; what follows differs.
        assert with_wall[1][0] == without[1][0]
        hooks += 1
        (left, top, width, height), yaw = without[1][0]["bbox"], np.radians(without[1][0]["yaw_deg"])
        y, x = np.indices(with_wall[0].shape[:2]) + 0.5
        x, y = x - left - width / 2, y - top - height / 2
        behind = (x * np.cos(yaw) + y * np.sin(yaw) < 0) & (np.hypot(x, y) * LOOKS["normals"][0] < 7)
        behind_hooks += [(departure(picture) > 20)[behind].sum() for picture, _ in (with_wall, without)]
    # A low wall may not touch, and one that does hides the slope of the root.
    assert hooks > 5 and behind_hooks[0] > 1.3 * behind_hooks[1], (hooks, behind_hooks)


def test_dots_lie_on_the_gel() -> None:
    """They darken what discs of 0.4 to 0.8 mm cover, 1.8 to 3 mm apart, 1.4 to 15.5 %, evenly spread."""
    for seed in range(10):
        marked, plain = (draw("normals", scene, np.random.default_rng(seed))[0].astype(int) for scene in ("markers", "snaps"))
        dark = plain.sum(-1) - marked.sum(-1) > 90
        assert 0.01 < dark.mean() < 0.16, seed
        quarters = [dark[:200, :200], dark[:200, 200:], dark[200:, :200], dark[200:, 200:]]
        assert min(q.mean() for q in quarters) > 0.6 * max(q.mean() for q in quarters), seed


def test_pairs_lie_close_and_whole() -> None:
    """The nearest pixels of two contacts are a gap apart, to the pixels that it was sought in; neither reaches the edge."""
    seen = set()
    for seed in range(12):
        mm, width, height = LOOKS["lamps-near"]
        half = np.array([width, height]) * mm / 2
        x, y = np.meshgrid((np.arange(width) + 0.5) * mm - half[0], (np.arange(height) + 0.5) * mm - half[1])
        first, second = pair(np.random.default_rng(seed), "pairs", BUILT_IN, x, y, half, mm)
        gap = distance_transform_edt(~first.contact())[second.contact()].min() * mm
        assert GAP_MM[0] - 2 * mm <= gap <= GAP_MM[1] + 2 * mm, (seed, gap)
        picture, labels = draw("lamps-near", "pairs", np.random.default_rng(seed))
        assert len(labels) == 2
        for left, top, box_width, box_height in (label["bbox"] for label in labels):
            assert left > 0 and top > 0 and left + box_width < width and top + box_height < height
        seen.add(tuple(sorted(label["category_id"] for label in labels)))
    assert seen == {(1, 1), (1, 2), (2, 2)}


def test_small_snaps_are_small() -> None:
    """A hook of at most 5 x 2.6 mm lies in a box of at most 5.7 mm however it is turned, a stud in one of 5 mm."""
    mm = LOOKS["lamps"][0]
    longest = {1: 0.0, 2: 0.0}
    for seed in range(40):
        for label in draw("lamps", "small", np.random.default_rng(seed), BUILT_IN_OF["small"])[1]:
            longest[label["category_id"]] = max(longest[label["category_id"]], *(mm * v for v in label["bbox"][2:]))
    assert 4 < longest[1] <= 5.7 + mm and 4 < longest[2] <= 5 + mm, longest


def test_a_coat_darkens_with_depth_alone() -> None:
    """Where the gel is deeper it is darker, whatever its slope, and grey."""
    depth = np.abs(np.random.default_rng(1).normal(0, 0.5, (20, 20)))
    picture = lit("coat", depth, 0.05, np.random.default_rng(2))
    assert (np.diff(picture[..., 0].ravel()[np.argsort(depth.ravel())]) <= 0).all()
    assert (picture == picture[..., :1]).all()


def test_a_seed_is_a_picture() -> None:
    first, second, other = (draw("lamps-near", "snaps", np.random.default_rng(seed))[0] for seed in (1, 1, 2))
    assert (first == second).all() and (first != other).any()


def test_a_map_is_a_part_about_its_middle() -> None:
    """x runs to the right and y down from the middle of what is not black, and heights are 0 at the highest."""
    with tempfile.TemporaryDirectory() as root:
        part = bracket(Path(root))
        for text, wanted in (("map.png", "MM_PER_PIXEL"), ("map.png:0:1", "MM_PER_PIXEL"), ("map.png:0.05:x", "could not convert"), ("8.png:0.05:1", "16 bits"), ("black.png:0.05:1", "black"), ("none.png:0.05:1", "No such file")):
            Image.fromarray(np.ones((4, 4), np.uint8)).save(Path(root) / "8.png")
            Image.fromarray(np.zeros((4, 4), np.uint16)).save(Path(root) / "black.png")
            try:
                Relief.read(f"{root}/{text}")
                raise AssertionError(text)
            except (ValueError, OSError) as error:
                assert wanted in str(error), (text, error)
    at = np.array([[3.5, 1], [3.5, -1], [-3.5, 1], [3.9, 1.9], [4.1, 1], [3.5, 2.1]])
    heights = part(np.random.default_rng(0), *at.T)
    assert np.allclose(heights, [0, -1, -1, 0, BESIDE, BESIDE], atol=1e-4), heights


def test_what_is_easily_taken_for_a_part() -> None:
    with tempfile.TemporaryDirectory() as root:
        part = bracket(Path(root))
    block, cut = part.look_alikes()
    rng, at = np.random.default_rng(0), np.array([[3.5, 1], [-3.5, 1], [4.1, 1]])
    assert np.allclose(block(rng, *at.T), [0, 0, BESIDE])
    # Of 8 mm the first two thirds: the step at the other end is gone, and what was lower is the highest.
    assert np.allclose(cut(rng, *np.array([[-2.5, 1], [2.5, 1], [2.75, 1]]).T), [0, 0, BESIDE], atol=1e-4)
    assert cut.heights.shape[1] == round(part.heights.shape[1] * 2 / 3)
    # What it lacks is the highest, so any press tells; of a part whose step lies at the other end, one that reaches the plate 1 mm below, as tilted as it may be.
    assert cut.least_mm == PRESSED[0] and block.least_mm == PRESSED[0]
    turned = Relief(part.heights[:, ::-1], part.mm).look_alikes()[1]
    assert 1.2 < turned.least_mm <= PRESSED[1], turned.least_mm
    # A block has no other block.
    assert len(block.look_alikes()) == 1
    kinds = own({"bracket": part, "block": block}, {"block"})
    assert hook in kinds.others and stud in kinds.others and len(kinds.others) == 5 + 3 + 2
    assert kinds.directed == {"bracket"}


def test_a_part_of_a_map_lies_in_its_box_and_points_as_its_map() -> None:
    """Where the step presses, in the middle of the end that the yaw points to and beside it towards +y, is most to see."""
    with tempfile.TemporaryDirectory() as root:
        part = bracket(Path(root))
    kinds = own({"bracket": part, "plain": part.look_alikes()[0]}, {"plain"})
    mm, width, height = LOOKS["normals"]
    along, across, seen = [], [], set()
    for seed in range(60):
        picture, labels = draw("normals", "snaps", np.random.default_rng(seed), kinds)
        change = (departure(picture) - 20).clip(0)
        for label in labels:
            left, top, box_width, box_height = label["bbox"]
            assert left >= 0 and top >= 0 and left + box_width <= width and top + box_height <= height
            box = change[top : top + box_height, left : left + box_width]
            assert (box > 0).sum() > max(box_width, box_height) / 2
            seen.add(label["category_id"])
            assert (label["yaw_deg"] is None) == (label["category_id"] == 2)
            # Of those that the plate presses with the step, boxes are larger than the step's.
            if label["category_id"] == 2 or max(box_width, box_height) * mm < 4.5:
                continue
            y, x = np.indices(box.shape)
            x, y, yaw = x + 0.5 - box_width / 2, y + 0.5 - box_height / 2, np.radians(label["yaw_deg"])
            along.append((box * (x * np.cos(yaw) + y * np.sin(yaw))).sum() > 0)
            across.append((box * (y * np.cos(yaw) - x * np.sin(yaw))).sum() > 0)
    assert seen == {1, 2}
    assert len(along) > 10 and np.mean(along) > 0.9 and np.mean(across) > 0.9, (along, across)
    assert draw("lamps", "none", np.random.default_rng(3), kinds)[1] == []


if __name__ == "__main__":
    test_a_map_is_a_part_about_its_middle()
    test_what_is_easily_taken_for_a_part()
    test_a_part_of_a_map_lies_in_its_box_and_points_as_its_map()
    test_boxes_hold_what_changes()
    test_a_hook_points_to_its_barb()
    test_look_alikes_have_no_label()
    test_a_wall_is_in_no_box()
    test_dots_lie_on_the_gel()
    test_pairs_lie_close_and_whole()
    test_small_snaps_are_small()
    test_a_coat_darkens_with_depth_alone()
    test_a_seed_is_a_picture()
    print("ok")
