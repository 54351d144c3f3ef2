"""Pictures are read as the program reads them. `python tests/test_pictures.py`"""

import struct
import tempfile
import unittest
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from smr_gpu_train.errors import Failure
from smr_gpu_train.pictures import from_16, read_picture


def deep_png(values: np.ndarray, colour: int) -> bytes:
    """A PNG of 16 bits a channel, which Pillow cannot write in colour."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width = values.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    header = struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


class Pictures(unittest.TestCase):
    def setUp(self) -> None:
        kept = tempfile.TemporaryDirectory()
        self.addCleanup(kept.cleanup)
        self.file = Path(kept.name) / "picture"

    def test_16_bits_are_rounded(self) -> None:
        # 128 is the first that is 1, 65407 the first that is 255.
        self.assertEqual(from_16(np.array([0, 128, 129, 257, 385, 386, 65406, 65407, 65535])).tolist(), [0, 0, 1, 1, 1, 2, 254, 255, 255])
        values = np.random.default_rng(1).integers(0, 65536, (4, 5, 4), dtype=np.uint16)
        for channels, colour in ((1, 0), (2, 4), (3, 2), (4, 6)):
            self.file.write_bytes(deep_png(values[:, :, :channels], colour))
            wanted = from_16(values[:, :, :3] if channels > 2 else values[:, :, :1].repeat(3, 2))
            self.assertTrue(np.array_equal(read_picture(self.file), wanted), channels)
        for order in ("<u2", ">u2"):
            Image.fromarray(values[:, :, 0].astype(order)).save(self.file, "TIFF")
            self.assertTrue(np.array_equal(read_picture(self.file), from_16(values[:, :, :1].repeat(3, 2))), order)

    def test_pictures_stand_upright(self) -> None:
        pixels = np.zeros((16, 8, 3), np.uint8)
        pixels[:8, :, 0] = 200  # the upper half is red
        exif = Image.Exif()
        exif[0x0112] = 6  # to be turned clockwise: the upper half is the right one then
        for kind in ("PNG", "JPEG", "TIFF"):
            Image.fromarray(pixels).save(self.file, kind, exif=exif)
            read = read_picture(self.file)
            self.assertEqual(read.shape, (8, 16, 3), kind)
            self.assertTrue(read[:, 9:, 0].min() > 150 > 50 > read[:, :7, 0].max(), kind)

    def test_grey_is_repeated_and_transparency_left_out(self) -> None:
        for mode in ("L", "LA", "RGBA", "P", "1"):
            Image.new("RGBA", (3, 2), (255, 255, 255, 0)).convert(mode).save(self.file, "PNG")
            self.assertTrue((read_picture(self.file) == 255).all(), mode)

    def test_what_is_no_picture_is_said(self) -> None:
        for data in (b"", b"text", b"\x89PNG\r\n\x1a\n" + bytes(20), deep_png(np.zeros((4, 4, 3), np.uint16), 2)[:45]):
            self.file.write_bytes(data)
            with self.assertRaisesRegex(Failure, "expected a PNG, JPEG, BMP or TIFF, got"):
                read_picture(self.file)
        Image.fromarray(np.zeros((4, 4), np.float32)).save(self.file, "TIFF")
        with self.assertRaisesRegex(Failure, "expected 8 bits a channel"):
            read_picture(self.file)


if __name__ == "__main__":
    unittest.main()
