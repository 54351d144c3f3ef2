"""What Python gets is what the program prints, to the bit."""

import numpy as np
import pytest
from conftest import DEVICE, SAMPLES

import smr_gpu


@pytest.mark.parametrize("options", [{}, {"sensor": "plain", "mm_per_pixel": 0.041}, {"score": 0.2, "classes": ["B"]}])
def test_samples_equal_the_program(program, options):
    flags = {"sensor": "--sensor", "mm_per_pixel": "--mm-per-pixel", "score": "--conf"}
    args = [text for name, flag in flags.items() if name in options for text in (flag, str(options[name]))]
    args += [text for name in options.get("classes", ()) for text in ("--class", name)]
    detector = smr_gpu.Detector(device=DEVICE, **options)
    lines = program(*args, *SAMPLES)
    snaps = 0
    for path, line in zip(SAMPLES, lines, strict=True):
        found = detector(path)
        snaps += len(found)
        for name, key in [
            ("boxes", "box"),
            ("scores", "score"),
            ("center_mm", "center_mm"),
            ("center_std_mm", "center_std_mm"),
            ("yaw_deg", "yaw_deg"),
            ("yaw_std_deg", "yaw_std_deg"),
            ("whole", "whole"),
        ]:
            array = getattr(found, name)
            want = np.array([snap[key] for snap in line["detections"]], np.float32).reshape(array.shape)
            np.testing.assert_array_equal(array, want, err_msg=f"{path}: {name}")
        assert found.labels.tolist() == [snap["class_index"] for snap in line["detections"]]
        assert found.names == [snap["class"] for snap in line["detections"]]
        assert (found.width, found.height) == (line["width"], line["height"])
        for name in ("gel", "part"):
            assert len(getattr(found, name)) == 4
        assert found.gel == tuple(line["gel"][side] for side in ("x", "y", "width", "height"))
        assert np.float32(found.mm_per_pixel) == np.float32(line["mm_per_pixel"])
        for name in ("gel_assumed", "scale_from", "contact", "left_out", "precision"):
            assert getattr(found, name) == line[name], name
        regions = found.regions if found.regions is None else found.regions.tolist()
        assert regions == (line["regions"] and [list(part.values()) for part in line["regions"]])
        assert list(found.stages_ms) == [stage["stage"] for stage in line["timings_ms"]["stages"]]
    assert snaps >= 2
