"""From what a caller gives to what the compiled part reads: a file's name, or an array of uint8 and its format."""

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smr_gpu import errors

# The library's format by the order that is asked for and the number of channels.
_FORMATS = {
    **{(order, 1): "gray8" for order in ("RGB", "BGR", "RGBA", "BGRA", "GRAY")},
    ("RGB", 3): "rgb8",
    ("RGB", 4): "rgba8",
    ("RGBA", 4): "rgba8",
    ("BGR", 3): "bgr8",
    ("BGR", 4): "bgra8",
    ("BGRA", 4): "bgra8",
    ("YUYV", 2): "yuyv",
    **{(f"BAYER_{pattern}", 1): f"bayer-{pattern.lower()}8" for pattern in ("RGGB", "BGGR", "GRBG", "GBRG")},
}


def given(picture: Any, order: str) -> str | tuple[NDArray[np.uint8], str]:
    """A picture for the compiled part.

    Raises:
        errors.ParamError: it is no array of a picture's shape and type, or not in this order.
    """
    if isinstance(picture, (str, os.PathLike)):
        return os.fsdecode(picture)
    if _is_pillow(picture):
        picture, order = _readable(picture), "RGB"
    array = np.asarray(picture)
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        raise errors.param("picture", "an array of uint8 or uint16", array.dtype)
    if array.ndim not in (2, 3):
        raise errors.param("picture", "height × width or height × width × channels", _shape(array))
    channels = 1 if array.ndim == 2 else array.shape[2]
    wanted = sorted({count for known, count in _FORMATS if known == order})
    if not wanted:
        raise errors.param("order", ", ".join(dict.fromkeys(known for known, _ in _FORMATS)), f"`{order}`")
    if channels not in wanted:
        counts = " or ".join(map(str, wanted))
        raise errors.param("picture", f"a channel count of {counts} in the order {order}", _shape(array))
    if array.dtype.itemsize == 2:
        # As the library rounds 16 bits: 65 535 is 255.
        array = ((array.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return array, _FORMATS[order, channels]


def is_batch(picture: Any) -> bool:
    """Whether it is several pictures: a list, a tuple, or an array of four dimensions."""
    return isinstance(picture, (list, tuple)) or (isinstance(picture, np.ndarray) and picture.ndim == 4)


def _is_pillow(picture: Any) -> bool:
    # Who has such a picture has imported it.
    pillow = sys.modules.get("PIL.Image")
    return pillow is not None and isinstance(picture, pillow.Image)


def _readable(picture: Any) -> Any:
    """A picture of Pillow in a mode that the library reads."""
    is_read = picture.mode in ("L", "RGB", "RGBA") or picture.mode.startswith("I;16")
    return picture if is_read else picture.convert("RGB")


def _shape(array: NDArray[Any]) -> str:
    return " × ".join(map(str, array.shape)) or "a single number"
