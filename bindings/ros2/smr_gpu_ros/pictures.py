"""From image messages to arrays that the detector reads, and to RGB for drawing."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from sensor_msgs.msg import CompressedImage, Image

# The order of the channels as smr_gpu calls it, the type of a channel, and their number, by ROS's encoding.
_ENCODINGS: dict[str, tuple[str, type, int]] = {
    **{f"mono{bits}": ("GRAY", kind, 1) for bits, kind in ((8, np.uint8), (16, np.uint16))},
    **{
        f"{order.lower()}{bits}": (order, kind, len(order))
        for order in ("RGB", "BGR", "RGBA", "BGRA")
        for bits, kind in ((8, np.uint8), (16, np.uint16))
    },
    **{
        f"bayer_{pattern.lower()}{bits}": (f"BAYER_{pattern}", kind, 1)
        for pattern in ("RGGB", "BGGR", "GRBG", "GBRG")
        for bits, kind in ((8, np.uint8), (16, np.uint16))
    },
    **{name: ("YUYV", np.uint8, 2) for name in ("yuyv", "yuv422_yuy2")},
    **{name: ("UYVY", np.uint8, 2) for name in ("uyvy", "yuv422")},
}
# As many as the library takes from a file.
_MOST_PIXELS = 33_554_432


class Unreadable(Exception):
    """A message that holds no picture that can be read; says what was expected and what came."""


def read(message: Image | CompressedImage) -> tuple[NDArray[Any], str]:
    """The picture as height × width (× channels) of uint8 or uint16, and its order for `smr_gpu.Detector`.

    The array of an `Image` of 8 bits shares the message's memory.

    Raises:
        Unreadable: an unknown encoding, a size that the data has not, or a damaged file.
    """
    return _decoded(message) if isinstance(message, CompressedImage) else _raw(message)


def _raw(message: Image) -> tuple[NDArray[Any], str]:
    if message.encoding not in _ENCODINGS:
        raise Unreadable(f"encoding: expected {', '.join(_ENCODINGS)}, got `{message.encoding}`")
    order, kind, channels = _ENCODINGS[message.encoding]
    dtype = np.dtype(kind)
    height, width = message.height, message.width
    row = width * channels * dtype.itemsize
    if height == 0 or width == 0:
        raise Unreadable(f"size: expected at least 1 × 1, got {width} × {height}")
    if message.step < row:
        raise Unreadable(f"step: expected at least {row} bytes for {width} pixels, got {message.step}")
    # The last row may end with its pixels.
    needed = message.step * (height - 1) + row
    if len(message.data) < needed:
        raise Unreadable(f"data: expected at least {needed} bytes, got {len(message.data)}")
    if dtype.itemsize == 2 and message.is_bigendian:
        dtype = dtype.newbyteorder(">")
    strides = (message.step, channels * dtype.itemsize, dtype.itemsize)
    array = np.ndarray((height, width, channels), dtype, message.data, strides=strides)
    if order == "UYVY":
        array, order = np.ascontiguousarray(array[..., ::-1]), "YUYV"
    return array, order


def _decoded(message: CompressedImage) -> tuple[NDArray[Any], str]:
    if "compressedDepth" in message.format:
        raise Unreadable(f"format: expected jpeg or png, got `{message.format}`")
    try:
        with Pillow.open(io.BytesIO(message.data), formats=("JPEG", "PNG")) as picture:
            if picture.width * picture.height > _MOST_PIXELS:
                raise Unreadable(f"size: expected at most {_MOST_PIXELS} pixels, got {picture.width} × {picture.height}")
            has_16_bits = picture.mode.startswith("I;16")
            array = np.asarray(picture if has_16_bits or picture.mode == "L" else picture.convert("RGB"))
    # Pillow raises many kinds for damaged files.
    except (OSError, SyntaxError, ValueError, EOFError, Pillow.DecompressionBombError) as error:
        raise Unreadable(f"format: expected a whole jpeg or png, got `{message.format}`: {error}") from error
    return array, "RGB"


def to_rgb(array: NDArray[Any], order: str) -> NDArray[np.uint8]:
    """The picture in RGB of 8 bits, to draw on: its colours are near those that the detector sees."""
    if array.dtype.itemsize == 2:
        array = (array >> 8).astype(np.uint8)
    if array.ndim == 2:
        array = array[..., np.newaxis]
    if order.startswith("BAYER"):
        return _from_bayer(array[..., 0], order.removeprefix("BAYER_"))
    if order == "YUYV":
        return _from_yuyv(array)
    if array.shape[2] == 1:
        return np.repeat(array, 3, axis=2)
    return array[..., 2::-1] if order.startswith("BGR") else array[..., :3]


def _from_bayer(array: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """Each cell of 2 × 2 in its own colour."""
    height, width = array.shape
    array = np.pad(array, ((0, height % 2), (0, width % 2)), mode="edge")
    cell = {at: array[at // 2 :: 2, at % 2 :: 2].astype(np.uint16) for at in range(4)}
    planes = [sum(cell[at] for at in range(4) if pattern[at] == colour) // pattern.count(colour) for colour in "RGB"]
    small = np.stack(planes, axis=-1).astype(np.uint8)
    return small.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]


def _from_yuyv(array: NDArray[np.uint8]) -> NDArray[np.uint8]:
    width = array.shape[1]
    colour = array[:, : width // 2 * 2, 1].reshape(array.shape[0], -1, 2).repeat(2, axis=1)
    colour = np.pad(colour, ((0, 0), (0, width % 2), (0, 0)), mode="edge")
    both = np.ascontiguousarray(np.concatenate([array[..., :1], colour], axis=2))
    return np.asarray(Pillow.fromarray(both, "YCbCr").convert("RGB"))
