"""Image messages of every encoding, and those that no picture can be read from."""

import array

import numpy as np
import pytest
from conftest import image
from sensor_msgs.msg import CompressedImage

from smr_gpu_ros import pictures

# Two rows of three pixels.
RGB = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
GRAY16 = np.array([[0, 256, 65535], [1, 513, 4096]], np.uint16)


@pytest.mark.parametrize("encoding, order, channels", [
    ("mono8", "GRAY", 1), ("rgb8", "RGB", 3), ("bgr8", "BGR", 3), ("rgba8", "RGBA", 4), ("bgra8", "BGRA", 4),
    ("bayer_rggb8", "BAYER_RGGB", 1), ("bayer_bggr8", "BAYER_BGGR", 1), ("bayer_grbg8", "BAYER_GRBG", 1),
    ("bayer_gbrg8", "BAYER_GBRG", 1), ("yuyv", "YUYV", 2), ("yuv422_yuy2", "YUYV", 2),
])  # fmt: skip
@pytest.mark.parametrize("padding", [0, 5])
def test_bytes_are_read_where_they_lie(encoding, order, channels, padding):
    pixels = np.arange(2 * 3 * channels, dtype=np.uint8).reshape(2, 3, channels)
    message = image(pixels, encoding, step=3 * channels + padding)
    array, got = pictures.read(message)
    assert got == order
    np.testing.assert_array_equal(array, pixels)
    assert np.shares_memory(array, np.frombuffer(message.data, np.uint8))


@pytest.mark.parametrize("is_bigendian, kind", [(0, "<u2"), (1, ">u2")])
@pytest.mark.parametrize("step", [6, 9])
def test_16_bits_in_either_order(is_bigendian, kind, step):
    array, order = pictures.read(image(GRAY16.astype(kind), "mono16", step, is_bigendian))
    assert order == "GRAY"
    assert array.tolist() == GRAY16[..., np.newaxis].tolist()


def test_uyvy_is_turned_to_yuyv():
    # U, Y, V, Y become Y, U, Y, V.
    array, order = pictures.read(image(np.array([[[1, 2], [3, 4]]], np.uint8), "yuv422"))
    assert (array.tolist(), order) == ([[[2, 1], [4, 3]]], "YUYV")


def test_the_last_row_may_end_with_its_pixels():
    message = image(RGB, "rgb8", step=16)
    message.data = message.data[:-7]
    np.testing.assert_array_equal(pictures.read(message)[0], RGB)


def changed(**fields):
    message = image(RGB, "rgb8")
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def file(kind, data):
    return CompressedImage(format=kind, data=array.array("B", data))


@pytest.mark.parametrize("message, says", [
    (changed(encoding="32FC1"), "expected mono8, .*, got `32FC1`"),
    (changed(encoding=""), "got ``"),
    (changed(width=0), "got 0 × 2"),
    (changed(step=8), "step: expected at least 9 bytes for 3 pixels, got 8"),
    (changed(height=3), "data: expected at least 27 bytes, got 18"),
    (changed(width=2**32 - 1), "step: expected at least"),
    (file("png", b""), "expected a whole jpeg or png, got `png`"),
    (file("jpeg", b"\xff\xd8\xff\xe0"), "expected a whole jpeg or png"),
    (file("16UC1; compressedDepth png", b"x" * 40), "compressedDepth"),
    (file("tiff", b"II*\0" + b"\0" * 40), "got `tiff`"),
])  # fmt: skip
def test_what_holds_no_picture_is_refused(message, says):
    with pytest.raises(pictures.Unreadable, match=says):
        pictures.read(message)


@pytest.mark.parametrize("order, pixels, want", [
    ("BGR", [[[1, 2, 3]]], [[[3, 2, 1]]]),
    ("BGRA", [[[1, 2, 3, 9]]], [[[3, 2, 1]]]),
    ("RGBA", [[[1, 2, 3, 9]]], [[[1, 2, 3]]]),
    ("GRAY", [[[7]]], [[[7, 7, 7]]]),
    # One cell: red 10, greens 20 and 40, blue 50.
    ("BAYER_RGGB", [[[10], [20]], [[40], [50]]], [[[10, 30, 50]] * 2] * 2),
    ("BAYER_GBRG", [[[20], [50]], [[10], [40]]], [[[10, 30, 50]] * 2] * 2),
    # Without colour Y alone counts.
    ("YUYV", [[[90, 128], [200, 128]]], [[[90] * 3, [200] * 3]]),
])  # fmt: skip
def test_colours_to_draw_on(order, pixels, want):
    assert pictures.to_rgb(np.array(pixels, np.uint8), order).tolist() == want


def test_grey_of_16_bits_to_draw_on():
    assert pictures.to_rgb(GRAY16[..., np.newaxis], "GRAY")[..., 0].tolist() == [[0, 1, 255], [0, 2, 16]]
