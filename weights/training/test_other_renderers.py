"""Whether labels of `other_renderers.py` say what its pictures show."""

import numpy as np

from other_renderers import LOOKS, SNAPS, draw


def test_boxes_hold_what_changes() -> None:
    """In a map of the normals flat gel is grey, and in a box is what is not; boxes lie in the picture; hooks have a yaw."""
    width, height = LOOKS["normals"][1:]
    seen = set()
    for seed in range(30):
        picture, labels = draw("normals", True, np.random.default_rng(seed))
        assert picture.shape == (height, width, 3)
        changed = abs(picture.astype(int) - 128).max(-1) > 20
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
        picture, labels = draw("normals", True, np.random.default_rng(seed))
        change = (abs(picture.astype(int) - 128).max(-1) - 20).clip(0)
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
        assert draw(look, False, np.random.default_rng(3))[1] == []


def test_a_seed_is_a_picture() -> None:
    first, second, other = (draw("lamps-near", True, np.random.default_rng(seed))[0] for seed in (1, 1, 2))
    assert (first == second).all() and (first != other).any()


if __name__ == "__main__":
    test_boxes_hold_what_changes()
    test_a_hook_points_to_its_barb()
    test_look_alikes_have_no_label()
    test_a_seed_is_a_picture()
    print("ok")
