"""Every layout of the same pixels gives the same answer; what is no picture is refused by name."""

import numpy as np
import pytest
from conftest import DEVICE, ROOT, same
from PIL import Image

import smr_gpu
from smr_gpu import errors


def layouts(rgb):
    """The same picture in other layouts, with its order."""
    wide = np.zeros((rgb.shape[0], rgb.shape[1] + 24, 3), np.uint8)
    wide[:, 8:-16] = rgb
    alpha = np.full((*rgb.shape[:2], 1), 9, np.uint8)
    every = np.zeros((2 * rgb.shape[0], 2 * rgb.shape[1], 3), np.uint8)
    every[::2, ::2] = rgb
    return {
        "part of a wider array": (wide[:, 8:-16], "RGB"),
        "rows upwards": (rgb[::-1].copy()[::-1], "RGB"),
        "columns to the left": (rgb[:, ::-1].copy()[:, ::-1], "RGB"),
        "every other pixel": (every[::2, ::2], "RGB"),
        "channels turned": (rgb[:, :, ::-1], "BGR"),
        "BGR": (rgb[:, :, ::-1].copy(), "BGR"),
        "Fortran's order": (np.asfortranarray(rgb), "RGB"),
        "channels first, moved": (np.moveaxis(np.moveaxis(rgb, 2, 0).copy(), 0, 2), "RGB"),
        "RGBA": (np.concatenate([rgb, alpha], 2), "RGB"),
        "BGRA": (np.concatenate([rgb[:, :, ::-1], alpha], 2), "BGRA"),
        "16 bits": (rgb.astype(np.uint16) * 257, "RGB"),
        "16 bits, the other end first": ((rgb.astype(np.uint16) * 257).astype(">u2"), "RGB"),
        "read-only": (np.frombuffer(rgb.tobytes(), np.uint8).reshape(rgb.shape), "RGB"),
        "Pillow": (Image.fromarray(rgb), "RGB"),
        "Pillow, with alpha": (Image.fromarray(rgb).convert("RGBA"), "RGB"),
        "a file": (ROOT / "samples/mixed.png", "RGB"),
        "a file's name": (str(ROOT / "samples/mixed.png"), "RGB"),
    }


def test_layouts_of_the_same_pixels_give_the_same_bits(detector, mixed):
    want = detector(mixed)
    assert len(want) >= 2
    wrong = [name for name, (picture, order) in layouts(mixed).items() if not same(detector(picture, order=order), want)]
    assert wrong == []


def test_layouts_of_grey_give_the_same_bits(detector, mixed):
    grey = mixed[:, :, 1].copy()
    want = detector(np.stack([grey] * 3, 2))
    assert len(want) >= 1
    for picture in (grey, grey[:, :, None], mixed[:, :, 1], grey.astype(np.uint16) * 257, Image.fromarray(grey)):
        assert same(detector(picture), want)
    assert same(detector(Image.fromarray(grey).convert("P")), want)


def test_sixteen_bits_are_rounded_as_the_library_does():
    array, order = smr_gpu.pictures.given(np.array([[0, 128, 129, 257, 32768, 65535]], np.uint16), "GRAY")
    assert (array.tolist(), order) == ([[0, 0, 1, 1, 128, 255]], "gray8")


def test_frames_have_a_scale_a_gel_and_a_crop_of_their_own(detector, mixed):
    found = detector(mixed, mm_per_pixel=0.04, gel=(100, 0, 900, 1000), crop=(400, 550, 300, 400))
    assert (found.scale_from, found.gel, found.gel_assumed) == ("stated", (100, 0, 900, 1000), False)
    assert found.part == (400, 550, 300, 400)
    whole = detector(mixed, mm_per_pixel=0.04, gel="all")
    assert whole.gel == (0, 0, 1000, 1000) and whole.assumption is None
    assert detector(mixed).assumption == "1000 × 1000: assumed 0.0400 mm a pixel"


@pytest.mark.parametrize(
    ("picture", "order", "message"),
    [
        (np.zeros((8, 8, 3), np.float32), "RGB", "expected an array of uint8 or uint16, got float32"),
        (np.zeros((8, 8, 3), np.int8), "RGB", "expected an array of uint8 or uint16, got int8"),
        (np.zeros((8, 8), bool), "RGB", "expected an array of uint8 or uint16, got bool"),
        (np.zeros((8, 8), np.uint32), "RGB", "expected an array of uint8 or uint16, got uint32"),
        (None, "RGB", "expected an array of uint8 or uint16, got object"),
        (np.zeros((8, 8, 5), np.uint8), "RGB", "expected a channel count of 1 or 3 or 4 in the order RGB, got 8 × 8 × 5"),
        (np.zeros((8, 8, 3), np.uint8), "GRAY", "expected a channel count of 1 in the order GRAY, got 8 × 8 × 3"),
        (np.zeros(8, np.uint8), "RGB", "expected height × width or height × width × channels, got 8"),
        (np.zeros((1, 1, 1, 8, 8), np.uint8), "RGB", "expected height × width or height × width × channels"),
        (np.zeros((8, 8, 3), np.uint8), "GBR", "parameter `order`: expected RGB, BGR, RGBA, BGRA, GRAY"),
    ],
)
def test_arrays_that_are_no_picture(detector, picture, order, message):
    with pytest.raises(errors.ParamError) as caught:
        detector(picture, order=order)
    assert message in str(caught.value)
    assert isinstance(caught.value, smr_gpu.Error) and caught.value.op == "detect"


def test_an_empty_array(detector):
    for size in ((0, 0, 3), (0, 5), (5, 0, 4)):
        with pytest.raises(errors.PictureError, match="expected at least 1 × 1 pixel, got"):
            detector(np.zeros(size, np.uint8))


def test_files_that_are_no_picture(detector, tmp_path):
    text = tmp_path / "text.png"
    text.write_text("no picture")
    with pytest.raises(errors.PictureError) as caught:
        detector(text)
    assert str(caught.value) == f"{text}: expected a PNG, JPEG, BMP or TIFF picture, got something else"
    assert caught.value.file == str(text)
    with pytest.raises(errors.PictureError, match="missing.png: No such file"):
        detector(tmp_path / "missing.png")


def test_a_frame_of_another_size_than_the_sensors(mixed):
    detector = smr_gpu.Detector(device=DEVICE, sensor="gelsight-mini")
    with pytest.raises(errors.SensorError, match="gelsight-mini.*expected frames of the shape of 320 × 240.*1000 × 1000"):
        detector(mixed)
    strict = smr_gpu.Detector(device=DEVICE, strict_scale=True)
    with pytest.raises(errors.ScaleError, match="1000 × 1000 pixels") as caught:
        strict(mixed)
    assert (caught.value.width, caught.value.height) == (1000, 1000)
