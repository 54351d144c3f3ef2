"""How a detector is built, and what it refuses."""

import json
import pickle

import numpy as np
import pytest
from conftest import DEVICE, ROOT, same

import smr_gpu
from smr_gpu import errors


def test_weights_by_name_file_or_bytes(detector, mixed):
    file = ROOT / "weights/smrnet-s.safetensors"
    for weights in (file, str(file), file.read_bytes()):
        assert same(smr_gpu.Detector(weights, DEVICE)(mixed), detector(mixed))
    assert detector.classes == ["A", "B"]
    assert repr(detector).startswith("Detector(classes A, B, sensor none named, on ")
    assert detector.adapter in repr(detector) and detector.remarks == []


def test_savings_are_the_librarys(detector, mixed):
    whole = smr_gpu.Detector(device=DEVICE, savings=smr_gpu.Savings.none())(mixed)
    assert (whole.contact, whole.regions, whole.left_out) == (None, None, [])
    assert detector(mixed).contact is True
    bare = detector(np.full((200, 200), 120, np.uint8))
    assert (len(bare), bare.contact, bare.regions.shape) == (0, False, (0, 4))
    assert bare.left_out == ["the network: nothing touches the gel"]


def test_a_reference_frame(mixed, tmp_path):
    # Nothing differs from what is declared to be the gel without contact.
    assert len(smr_gpu.Detector(device=DEVICE, reference=mixed)(mixed)) == 0


def test_a_sensor_file(mixed, tmp_path):
    file = tmp_path / "bench.json"
    file.write_text(json.dumps({"name": "bench", "frame": [1000, 1000], "mm_per_pixel": 0.04}))
    found = smr_gpu.Detector(device=DEVICE, sensor=file)(mixed)
    assert (found.scale_from, found.gel_assumed) == ("sensor", False)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"weights": "nobody"}, errors.NoWeightsError, "expected `nobody` in one of"),
        ({"weights": "no/such.safetensors"}, errors.WeightsError, "no/such.safetensors"),
        ({"weights": b"no weights"}, errors.WeightsError, "weights"),
        ({"device": "no such adapter"}, errors.NoAdapterError, "no GPU adapter for `no such adapter`"),
        ({"device": "-1"}, errors.ParamError, "parameter `device`: expected `auto`, `gpu`, `cpu`"),
        ({"sensor": "nobody"}, errors.ParamError, "expected paper, gelsight-mini, digit, plain or a file, got `nobody`"),
        ({"precision": "f8"}, errors.ParamError, "parameter `precision`: expected `f32`, `f16`, `bf16` or `int8`, got `f8`"),
        ({"classes": ["C"]}, errors.ParamError, "parameter `classes`: expected A, B, got `C`"),
        ({"score": 1.5}, errors.ParamError, "parameter `score`: expected a number from 0 to 1, got 1.5"),
        ({"iou": float("nan")}, errors.ParamError, "parameter `iou`: expected a number from 0 to 1, got NaN"),
        ({"max_detections": 0}, errors.ParamError, "parameter `max_detections`: expected 1 to 100, got 0"),
        ({"input_size": 100}, errors.ParamError, "parameter `input_size`: expected"),
        ({"timeout": -1.0}, errors.ParamError, "parameter `timeout`: expected seconds from 0 on, got -1"),
        ({"mm_per_pixel": 2.0}, errors.ParamError, "parameter `scale`: expected 0.0005 to 1 mm a pixel, got 2"),
        ({"gel": "some"}, errors.ParamError, "expected `all` or X,Y,WIDTH,HEIGHT in pixels, got some"),
        ({"savings": smr_gpu.Savings(doubt=2.0)}, errors.ParamError, "parameter `doubt`: expected a number from 0 to 1"),
    ],
)
def test_options_that_are_refused(options, error, message):
    with pytest.raises(error) as caught:
        smr_gpu.Detector(**{"device": "cpu", **options})
    assert message in str(caught.value)
    assert isinstance(caught.value, smr_gpu.Error)


def test_sensor_files_that_are_wrong(tmp_path):
    file = tmp_path / "wrong.json"
    for text, message in [
        ("{", "EOF while parsing"),
        ('{"name": "x", "frames": 3}', "unknown field `frames`"),
        ('{"name": "x", "frame": [100, 100], "mm_per_pixel": 0.01}', "expected a field of 10 to 60 mm"),
    ]:
        file.write_text(text)
        with pytest.raises(errors.SensorError, match=message) as caught:
            smr_gpu.Detector(device="cpu", sensor=file)
        assert caught.value.sensor == str(file)


def test_errors_have_one_base_and_cross_processes(detector):
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and kind.__module__ == errors.__name__]
    assert len(kinds) == 19 and all(issubclass(kind, smr_gpu.Error) for kind in kinds)
    with pytest.raises(errors.ParamError) as caught:
        detector(np.zeros((2, 2)))
    copy = pickle.loads(pickle.dumps(caught.value))
    assert (str(copy), copy.got) == (str(caught.value), "float64")
