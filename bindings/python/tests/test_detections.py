"""What is done with an answer."""

import json

import numpy as np
import pytest
from conftest import ROOT


@pytest.fixture(scope="module")
def found(detector, mixed):
    found = detector(mixed)
    assert sorted(set(found.names)) == ["A", "B"]
    return found


def test_arrays_have_torchvisions_names_and_shapes(found):
    count = len(found)
    for name, shape, dtype in [
        ("boxes", (count, 4), np.float32),
        ("scores", (count,), np.float32),
        ("labels", (count,), np.int64),
        ("center_mm", (count, 2), np.float32),
        ("center_std_mm", (count, 2), np.float32),
        ("yaw_deg", (count,), np.float32),
    ]:
        array = getattr(found, name)
        assert (array.shape, array.dtype) == (shape, dtype), name
    assert (np.diff(found.scores) <= 0).all()
    # The centre in millimetres is that of the box, from the middle of 1000 × 1000 pixels of 0.04 mm.
    middles = (found.boxes[:, :2] + found.boxes[:, 2:]) / 2
    np.testing.assert_allclose(found.center_mm, (middles - 500) * 0.04, atol=1e-4)


def test_masks_indices_and_iteration(found):
    hooks = found[found.labels == 0]
    assert hooks.names == ["A"] * len(hooks) and 0 < len(hooks) < len(found)
    assert (hooks.width, hooks.classes) == (1000, ["A", "B"])
    np.testing.assert_array_equal(found[1:].scores, found.scores[1:])
    np.testing.assert_array_equal(found[[1, 0]].boxes, found.boxes[[1, 0]])
    assert len(found[[]]) == 0 and len(found[found.scores > 2]) == 0
    snaps = list(found)
    assert snaps[-1] == found[-1] and len(snaps) == len(found)
    assert [snap.score for snap in snaps] == found.scores.tolist()
    for snap in snaps:
        assert (snap.yaw_deg is None) == (snap.class_name == "B")
    with pytest.raises(IndexError):
        found[len(found)]


def test_a_dictionary_for_json(found):
    values = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert np.array_equal(np.array(values["boxes"], np.float32), found.boxes)
    assert values["names"] == found.names and values["scale_from"] == "assumed"
    assert [yaw is None for yaw in values["yaw_deg"]] == np.isnan(found.yaw_deg).tolist()


def test_supervision(found):
    other = found.to_supervision()
    assert np.array_equal(other.xyxy, found.boxes) and np.array_equal(other.class_id, found.labels)
    assert other.data["class_name"].tolist() == found.names
    assert np.array_equal(other[other.class_id == 0].data["center_mm"], found.center_mm[found.labels == 0])


def test_pandas(found):
    table = found.to_pandas()
    assert table.shape == (len(found), 14)
    assert np.array_equal(table[["x1", "y1", "x2", "y2"]].to_numpy(), found.boxes)
    assert table["center_y_mm"].tolist() == found.center_mm[:, 1].tolist()


def test_nothing_found_has_every_form(detector):
    bare = detector(np.full((200, 200, 3), 90, np.uint8))
    assert (bare.boxes.shape, bare.center_mm.shape, list(bare)) == ((0, 4), (0, 2), [])
    assert len(bare.to_supervision()) == 0 and len(bare.to_pandas()) == 0
    assert bare.to_dict()["boxes"] == []


def test_a_plot_has_boxes_in_their_class_colours(found, mixed):
    for picture in (ROOT / "samples/mixed.png", mixed):
        drawn = np.asarray(found.plot(picture))
        assert drawn.shape == mixed.shape
        for snap in found:
            x1, y1, x2, y2 = (round(side) for side in snap.box)
            colour = [(230, 159, 0), (86, 180, 233)][snap.label]
            # The left edge, below the middle.
            near = drawn[(y1 + 3 * y2) // 4, max(x1 - 3, 0) : x1 + 4]
            assert (near == colour).all(1).any()
    changed = (np.asarray(found.plot(mixed)) != mixed).any(2)
    assert 0 < changed.mean() < 0.2
