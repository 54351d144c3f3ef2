"""`Detector`: a picture in, snaps out."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from smr_gpu import _native, pictures
from smr_gpu.detections import Detections

if TYPE_CHECKING:
    import PIL.Image

Picture: TypeAlias = "str | os.PathLike[str] | NDArray[np.uint8] | NDArray[np.uint16] | PIL.Image.Image"
"""A file (PNG, JPEG, BMP, TIFF), an array of height × width (× channels), or a picture of Pillow."""

Order: TypeAlias = Literal[
    "RGB", "BGR", "RGBA", "BGRA", "GRAY", "YUYV", "BAYER_RGGB", "BAYER_BGGR", "BAYER_GRBG", "BAYER_GBRG"
]
"""How an array's channels lie. With "RGB" two dimensions or one channel are grey, and a fourth is alpha; "BGR",
as OpenCV has it, likewise. Alpha is ignored. Of a Bayer filter there is one channel, of YUYV there are two."""

Gel: TypeAlias = Literal["all"] | tuple[int, int, int, int]
"""The part of a frame that shows the gel: "all", or x, y, width and height in pixels."""


@dataclass(frozen=True)
class Savings:
    """What is left out where a picture does not need it; where that leaves a box in doubt, a second run leaves
    nothing out. `Savings.none()` leaves nothing out."""

    contact: bool = True
    """Where nothing touches the gel the network does not run."""
    regions: bool = True
    """The network runs only where something touches the gel."""
    proposals: bool = False
    """Only the likeliest places reach the network's last part. May lose a snap."""
    scales: bool = False
    """The deepest of the network's three scales is left out. May lose a snap."""
    margin_mm: float = 1.0
    """Gel round a contact that the network sees, in millimetres; 0 to 60."""
    most_of_input: float = 0.55
    """Share of the network's input above which all of it is computed; 0 to 1."""
    doubt: float = 0.6
    """How far from the asked-for score to 0 a box is in doubt; 0 to 1."""
    most_proposals: int = 32
    """Proposals of 320 × 320 pixels of input that reach the last part; 1 to 100."""

    @classmethod
    def none(cls) -> Savings:
        """Nothing is left out."""
        return cls(contact=False, regions=False)


class Detector:
    """Finds snaps in pictures. Build it once: it loads the weights, opens the device and compiles the shaders.

    Threads may share it; as many pictures as `in_flight` says are computed at a time. While it computes, other
    Python threads run: none of them may write to an array that it was given. A process that is forked from one
    with a detector gets `errors.ForkError`.
    """

    def __init__(
        self,
        weights: str | os.PathLike[str] | bytes = "small",
        device: str = "auto",
        sensor: str | os.PathLike[str] | None = None,
        *,
        mm_per_pixel: float | None = None,
        gel: Gel | None = None,
        strict_scale: bool = False,
        input_size: int | None = None,
        savings: Savings = Savings(),
        reference: Picture | None = None,
        score: float = 0.5,
        counts_above: float | None = None,
        iou: float = 0.5,
        max_detections: int = 100,
        classes: Sequence[str] = (),
        timeout: float = 120.0,
        rebuild_on_loss: bool = True,
        in_flight: int = 2,
        batch: int = 2,
        precision: Literal["f32", "f16", "bf16", "int8"] = "f32",
        tuned_kernels: str | os.PathLike[str] | None = None,
        bounds_checks: bool = False,
    ) -> None:
        """Builds a detector.

        Args:
            weights: "small", which is in the package; "large" or another name that `smr-gpu weights` lists; a
                file; or a file's bytes.
            device: "auto" (a GPU, else the CPU), "gpu" (software adapters too), "cpu", "reference" (in f64,
                slow), an adapter's index, or part of its name.
            sensor: "paper", "gelsight-mini", "digit", "plain", or a sensor file (JSON).
            mm_per_pixel: millimetres of gel for a pixel of the frames that come, 0.0005 to 1; None for the
                sensor's. Without either, 40 mm along the gel's shorter side are assumed, and snaps may be missed.
            gel: the part of each frame that shows the gel; None for what the sensor says.
            strict_scale: refuse frames whose scale would be assumed.
            input_size: longer side of the gel in the network's input in pixels, a multiple of 32; None for the
                scale that the weights know.
            savings: what may be left out.
            reference: a frame without contact; None for the sensor's. An array is in RGB.
            score: detections have a score above this; 0 to 1.
            counts_above: the score from which a box counts, where `score` is lower to see others besides.
            iou: of two boxes of a class that overlap by more, the one with the lower score goes; 0 to 1.
            max_detections: at most so many a picture; 1 to 100.
            classes: names of the wanted classes; empty for all.
            timeout: longest wait for one picture in seconds.
            rebuild_on_loss: open a lost GPU anew, once a call.
            in_flight: pictures that are computed at a time.
            batch: pictures of a size that a GPU takes together.
            precision: how a GPU stores maps and weights.
            tuned_kernels: folder of the kernels that `smr-gpu tune` measured.
            bounds_checks: let the GPU check the shaders' bounds; slower.

        Raises:
            errors.NoWeightsError, errors.WeightsError: the weights.
            errors.NoAdapterError, errors.DeviceError: the device.
            errors.SensorError: the sensor's file.
            errors.ParamError: an argument out of its range, or an unknown class, sensor or device.
        """
        options = {
            "weights": weights,
            "device": device,
            "sensor": None if sensor is None else os.fspath(sensor),
            "mm_per_pixel": mm_per_pixel,
            "gel": gel,
            "strict_scale": strict_scale,
            "input_size": input_size,
            "savings": savings,
            "reference": None if reference is None else pictures.given(reference, "RGB"),
            "score": score,
            "counts_above": counts_above,
            "iou": iou,
            "max_detections": max_detections,
            "classes": list(classes),
            "timeout": timeout,
            "rebuild_on_loss": rebuild_on_loss,
            "in_flight": in_flight,
            "batch": batch,
            "precision": precision,
            "tuned_kernels": tuned_kernels,
            "bounds_checks": bounds_checks,
        }
        self._native = _native.Detector(options)

    @overload
    def __call__(
        self,
        picture: Picture,
        *,
        order: Order = "RGB",
        gel: Gel | None = None,
        mm_per_pixel: float | None = None,
        crop: tuple[int, int, int, int] | None = None,
    ) -> Detections: ...

    @overload
    def __call__(
        self,
        picture: list[Any] | tuple[Picture, ...],
        *,
        order: Order = "RGB",
        gel: Gel | None = None,
        mm_per_pixel: float | None = None,
        crop: tuple[int, int, int, int] | None = None,
    ) -> list[Detections]: ...

    def __call__(
        self,
        picture: Any,
        *,
        order: Order = "RGB",
        gel: Gel | None = None,
        mm_per_pixel: float | None = None,
        crop: tuple[int, int, int, int] | None = None,
    ) -> Detections | list[Detections]:
        """Finds the snaps in a picture, or in each of a list or an array of N × height × width × channels.

        Arrays are of uint8, or of uint16 where 65 535 is white. Rows may be apart, as in a part of a larger
        array; other layouts, and uint16, are copied first.

        Args:
            picture: see `Picture`.
            order: how an array's channels lie.
            gel: the part that shows the gel; None for what the detector knows.
            mm_per_pixel: the scale; None for what the detector knows.
            crop: x, y, width and height in pixels of what the network sees; boxes stay the whole picture's.

        Returns:
            `Detections`; of several pictures a list of them.

        Raises:
            errors.ParamError: another type, shape or order.
            errors.PictureError: an empty picture, or a file that is none.
            errors.SensorError, errors.ScaleError: a frame that cannot be the sensor's, or have this scale.
            errors.Error: what the device reports.
        """
        said = {"gel": gel, "mm_per_pixel": mm_per_pixel, "crop": crop}
        if pictures.is_batch(picture):
            given = [pictures.given(each, order) for each in picture]
            return [Detections._of(found) for found in self._native.detect_many(given, said)]
        return Detections._of(self._native.detect(pictures.given(picture, order), said))

    async def detect_async(self, picture: Picture, **said: Any) -> Detections:
        """One picture, with the arguments of a call, in a thread of the loop's: on the CPU too the loop goes on."""
        return await asyncio.to_thread(lambda: self(picture, **said))

    def stream(
        self,
        frames: Iterable[Picture],
        *,
        reuse: bool = False,
        order: Order = "RGB",
        gel: Gel | None = None,
        mm_per_pixel: float | None = None,
        crop: tuple[int, int, int, int] | None = None,
    ) -> Iterator[Detections]:
        """Finds the snaps in frames as they come, in their order and in bounded memory.

        On a GPU up to `in_flight` times `batch` frames are taken ahead of the results. They are copied, so that
        `frames` may give the same array again and again. An error ends it, behind the results of the frames
        before.

        Args:
            frames: pictures, such as a camera's frames.
            reuse: for frames of one camera: one that equals the last computed one within the sensor's noise has
                that one's detections and is `reused`. Frames are taken one by one then.
            order, gel, mm_per_pixel, crop: of each frame, as for a call.
        """
        said = {"gel": gel, "mm_per_pixel": mm_per_pixel, "crop": crop}
        given = (pictures.given(frame, order) for frame in frames)
        if reuse:
            camera = self._native.camera()
            results: Iterator[dict[str, Any]] = (camera.detect(frame, said) for frame in given)
        else:
            results = self._native.stream(given, said)
        return map(Detections._of, results)

    @property
    def classes(self) -> list[str]:
        """Names of the classes; a label is a place in it."""
        return self._native.classes

    @property
    def adapter(self) -> str:
        """What runs the network."""
        return self._native.adapter

    @property
    def remarks(self) -> list[str]:
        """What went otherwise than asked for, a line each."""
        return self._native.remarks

    def __repr__(self) -> str:
        return repr(self._native).replace("GpuDetector", "Detector", 1)
