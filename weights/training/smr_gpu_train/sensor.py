"""How many millimetres a pixel shows and which part of a frame is gel, by the program's rules (its `src/sensor`). Needs the standard library alone.

The first that says it counts: of the scale the picture's label, then the sensor by the frame's size, then 40 mm along
the gel's shorter side; of the gel the label, then the sensor, then the middle square of a frame of the paper's 16 : 10
unless its stated scale is another, then all of the frame.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from .errors import Failure

PAPER_MM = 40.0  # along the gel's shorter side, of a picture of which nobody says its scale
FIELD_MM = (10.0, 60.0)  # along the gel's longer side
MM_PER_PIXEL = (5e-4, 1.0)
SAME_SHAPE = 0.01
SAME_SCALE = 0.25

Size = tuple[int, int]  # width, height


class Rect(NamedTuple):
    """A part of a picture, in pixels."""

    x: int
    y: int
    width: int
    height: int

    def is_in(self, size: Size) -> bool:
        x, y, width, height = self
        return x >= 0 and y >= 0 and width > 0 and height > 0 and x + width <= size[0] and y + height <= size[1]

    def scaled(self, times: tuple[float, float], size: Size) -> "Rect":
        """The same part of a picture that was scaled to `size`, in whole pixels."""

        def side(at: int, length: int, scale: float, all_: int) -> tuple[int, int]:
            first = min(_round(at * scale), all_ - 1)
            return first, max(1, min(_round((at + length) * scale), all_) - first)

        (x, width), (y, height) = side(self.x, self.width, times[0], size[0]), side(self.y, self.height, times[1], size[1])
        return Rect(x, y, width, height)

    def central(self, aspect: float) -> "Rect":
        """The largest part in its middle whose longer side is at most `aspect` times the shorter."""
        most = int(min(self.width, self.height) * aspect)
        width, height = min(self.width, most), min(self.height, most)
        return Rect(self.x + (self.width - width) // 2, self.y + (self.height - height) // 2, width, height)

    @staticmethod
    def read(value: Any) -> "Rect | None":
        """From JSON's x, y, width and height, whole numbers; `None` for what is no such part."""
        if not isinstance(value, dict):
            return None
        sides = [value.get(name) for name in Rect._fields]
        whole = all(isinstance(side, int) and not isinstance(side, bool) for side in sides)
        return Rect(*sides) if whole else None  # type: ignore[arg-type]


def _round(value: float) -> int:
    """Half away from zero, as the program does."""
    return math.floor(value + 0.5)


def _same_shape(one: Size, other: Size) -> bool:
    across, along = one[0] * other[1], one[1] * other[0]
    return abs(across - along) <= SAME_SHAPE * max(across, along)


class OwnFrame(NamedTuple):
    """A kind of frame that a sensor gives."""

    size: Size
    gel: Rect | None
    mm_per_pixel: float | None

    @property
    def window(self) -> Rect:
        return self.gel or Rect(0, 0, *self.size)


@dataclass(frozen=True)
class Sensor:
    """A sensor's frames, the one that describes it first; without any it gives frames of any size."""

    name: str
    frames: tuple[OwnFrame, ...] = ()
    mm_per_pixel: float | None = None  # of frames of any size

    def sense(self, size: Size) -> tuple[Rect, float | None]:
        """The gel and the millimetres a pixel of a frame of this size."""
        if not self.frames:
            return Rect(0, 0, *size), self.mm_per_pixel
        of_shape = [own for own in self.frames if _same_shape(size, own.size)]
        own = next((own for own in of_shape if own.size == size), of_shape[0] if of_shape else None)
        if own is not None:
            times = size[0] / own.size[0], size[1] / own.size[1]
            mm = own.mm_per_pixel
            return own.window.scaled(times, size), None if mm is None else mm / times[0]
        main = self.frames[0]
        if not _same_shape(size, main.window[2:]):
            shapes = " or ".join(f"{w} x {h}" for w, h in (own.size for own in self.frames))
            gel = "{} x {}".format(*main.window[2:])
            raise Failure(f"sensor `{self.name}`: expected frames of the shape of {shapes} pixels, or of its gel's {gel}; got {size[0]} x {size[1]}")
        mm = main.mm_per_pixel
        return Rect(0, 0, *size), None if mm is None else mm / (size[0] / main.window.width)

    @staticmethod
    def open(name: str) -> "Sensor":
        """The sensor of this name, or of this file, as `smr-gpu calibrate` writes them."""
        if name in NAMED:
            return NAMED[name]
        file = Path(name)
        if not file.is_file():
            raise Failure(f"--sensor: expected {', '.join(NAMED)} or a sensor file, got {name}")
        try:
            read = json.loads(file.read_text(encoding="utf-8-sig"))
            frames = [_own(each) for each in ([read] if read.get("frame") else []) + read.get("other_frames", [])]
            mm = read.get("mm_per_pixel")
            return Sensor(str(read["name"]), tuple(frames), None if mm is None else float(mm))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise Failure(f"{file}: expected a sensor's JSON, got {type(error).__name__}: {error}") from None


def _own(read: dict[str, Any]) -> OwnFrame:
    (width, height), gel, mm = read["frame"], read.get("gel"), read.get("mm_per_pixel")
    window = Rect.read(gel)
    if gel is not None and (window is None or not window.is_in((width, height))):
        raise ValueError(f"a gel of {gel} in {width} x {height} pixels")
    return OwnFrame((int(width), int(height)), window, None if mm is None else float(mm))


PAPER = Sensor("paper", (OwnFrame((1920, 1200), Rect(460, 100, 1000, 1000), 0.04),))
NAMED = {
    "paper": PAPER,
    "gelsight-mini": Sensor("gelsight-mini", (OwnFrame((320, 240), None, 0.0634), OwnFrame((3280, 2464), Rect(492, 370, 2296, 1724), 0.0634 * 320 / 2296))),
    "digit": Sensor("digit", tuple(OwnFrame(size, None, 19 / max(size)) for size in ((240, 320), (320, 240), (480, 640), (640, 480)))),
    "plain": Sensor("plain"),
}


class View(NamedTuple):
    """What the network sees of a frame."""

    part: Rect
    mm_per_pixel: float
    assumed: bool  # the scale is


def view(size: Size, mm: float | None, gel: Rect | None, sensor: Sensor | None) -> View:
    """By what the label says of scale and gel, and by the sensor. A message that lacks the picture's name is raised as `ValueError`."""
    if mm is not None and not MM_PER_PIXEL[0] <= mm <= MM_PER_PIXEL[1]:
        raise ValueError(f"a scale of {mm} mm a pixel, expected {MM_PER_PIXEL[0]} to {MM_PER_PIXEL[1]}")
    if gel is not None and not gel.is_in(size):
        raise ValueError(f"a gel of {', '.join(map(str, gel))}, expected a part of {size[0]} x {size[1]} pixels")
    sensed: tuple[Rect, float | None] | None = None
    if sensor is not None:
        if mm is None or gel is None:
            sensed = sensor.sense(size)
    elif gel is None and (_same_shape(size, PAPER.frames[0].size) or _same_shape(size, PAPER.frames[0].window[2:])):
        window, own = PAPER.sense(size)
        if mm is None or own is None or abs(mm / own - 1) <= SAME_SCALE:
            sensed = window, None
    part = gel or (sensed[0] if sensed else Rect(0, 0, *size))
    scale = mm if mm is not None else sensed[1] if sensed else None
    assumed = scale is None
    if scale is None:
        scale = PAPER_MM / min(part[2:])
        # Of a field that nobody stated, what the weights know in size.
        field = max(part[2:]) * scale
        part = part.central(FIELD_MM[1] / PAPER_MM)
    else:
        field = max(part[2:]) * scale
    if field < FIELD_MM[0] * 0.999 or max(part[2:]) * scale > FIELD_MM[1] * 1.001:
        raise ValueError(f"a field of {field:.3g} mm along the gel's longer side, expected {FIELD_MM[0]:g} to {FIELD_MM[1]:g}")
    return View(part, scale, assumed)
