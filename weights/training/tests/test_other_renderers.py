"""Whether labels of `other_renderers.py` say what its pictures show."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from other_renderers import LOOKS, SNAPS, draw


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


def test_a_seed_is_a_picture() -> None:
    first, second, other = (draw("lamps-near", "snaps", np.random.default_rng(seed))[0] for seed in (1, 1, 2))
    assert (first == second).all() and (first != other).any()


if __name__ == "__main__":
    test_boxes_hold_what_changes()
    test_a_hook_points_to_its_barb()
    test_look_alikes_have_no_label()
    test_a_wall_is_in_no_box()
    test_dots_lie_on_the_gel()
    test_a_seed_is_a_picture()
    print("ok")
