"""Pictures with what was found drawn in, by Pillow."""

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import PIL.Image

    from smr_gpu.detections import Detections

# Okabe and Ito's palette, a colour a class: as the program draws.
COLOURS = [(230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (204, 121, 167)]


def draw(picture: Any, found: "Detections") -> "PIL.Image.Image":
    """The picture in RGB with what was found, the best on top."""
    from PIL import Image, ImageDraw, ImageFont

    if isinstance(picture, (str, os.PathLike)):
        canvas = Image.open(picture).convert("RGB")
    elif isinstance(picture, Image.Image):
        canvas = picture.convert("RGB")
    else:
        canvas = Image.fromarray(np.squeeze(np.ascontiguousarray(picture))).convert("RGB")
    ink = ImageDraw.Draw(canvas)
    side = min(canvas.size)
    line, letters = max(side // 330, 1), max(side / 42, 9.0)
    font = ImageFont.load_default(letters)
    for snap in reversed(list(found)):
        colour = COLOURS[snap.label % len(COLOURS)]
        x1, y1, x2, y2 = snap.box
        ink.rectangle(snap.box, outline=colour, width=line)
        if snap.yaw_deg is not None:
            _arrow(ink, snap.box, math.radians(snap.yaw_deg), colour, line)
        text = f"{snap.class_name} {snap.score:.2f}"
        top = y1 - 1.3 * letters if y1 > 1.3 * letters else y2
        ink.rectangle(ink.textbbox((x1, top), text, font=font), fill=colour)
        ink.text((x1, top), text, fill="black", font=font)
    return canvas


def _arrow(ink: Any, box: tuple[float, ...], yaw: float, colour: tuple[int, int, int], line: int) -> None:
    """Through the box's middle, half its diagonal long, in the direction in which the barb points."""
    x1, y1, x2, y2 = box
    (x, y), half = ((x1 + x2) / 2, (y1 + y2) / 2), math.hypot(x2 - x1, y2 - y1) / 4
    tip = (x + half * math.cos(yaw), y + half * math.sin(yaw))
    ink.line([(x - half * math.cos(yaw), y - half * math.sin(yaw)), tip], fill=colour, width=line)
    for side in (yaw + 2.6, yaw - 2.6):
        barb = (tip[0] + half / 3 * math.cos(side), tip[1] + half / 3 * math.sin(side))
        ink.line([tip, barb], fill=colour, width=line)
