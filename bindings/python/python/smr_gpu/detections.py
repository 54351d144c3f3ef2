"""`Detections`: what a picture holds."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from smr_gpu import drawing

if TYPE_CHECKING:
    import pandas
    import PIL.Image
    import supervision

# The arrays with a row for each snap, and what a row of each is.
_ROWS: dict[str, tuple[type, tuple[int, ...]]] = {
    "boxes": (np.float32, (4,)),
    "scores": (np.float32, ()),
    "labels": (np.int64, ()),
    "center_mm": (np.float32, (2,)),
    "center_std_mm": (np.float32, (2,)),
    "yaw_deg": (np.float32, ()),
    "yaw_std_deg": (np.float32, ()),
    "whole": (np.float32, ()),
}


@dataclass(frozen=True)
class Detection:
    """One snap; None where the class has no direction, or the weights do not tell."""

    class_name: str
    label: int
    score: float
    box: tuple[float, float, float, float]
    center_mm: tuple[float, float]
    center_std_mm: tuple[float, float] | None
    yaw_deg: float | None
    yaw_std_deg: float | None
    whole: float | None


@dataclass(frozen=True, eq=False)
class Detections:
    """What a picture holds, N snaps, the best first.

    `found[mask]`, `found[2:]` and `found[[0, 3]]` are `Detections` of some of them, `found[0]` and iteration give
    one as a `Detection`.
    """

    boxes: NDArray[np.float32]
    """N × 4: corners x1, y1, x2, y2 in pixels of the picture; pixel i covers [i, i + 1]."""
    scores: NDArray[np.float32]
    """N: confidence from 0 to 1."""
    labels: NDArray[np.int64]
    """N: places in `classes`, from 0; there is no background class."""
    center_mm: NDArray[np.float32]
    """N × 2: centres of the boxes on the gel in millimetres, from its middle, x right and y down."""
    center_std_mm: NDArray[np.float32]
    """N × 2: standard deviations of those; NaN where the weights do not tell."""
    yaw_deg: NDArray[np.float32]
    """N: direction in which a snap's barb points, in degrees in −180 to 180, 0 along x and 90 along y; NaN for a
    class without direction."""
    yaw_std_deg: NDArray[np.float32]
    """N: standard deviation of that, in degrees."""
    whole: NDArray[np.float32]
    """N: probability that the picture's edge does not cut the snap; NaN where the weights do not tell."""
    classes: list[str]
    """Names of all classes."""
    width: int
    """Of the picture, in pixels."""
    height: int
    """Of the picture, in pixels."""
    gel: tuple[int, int, int, int]
    """x, y, width and height in pixels of the part that shows the gel."""
    gel_assumed: bool
    """Whether nobody said so."""
    part: tuple[int, int, int, int]
    """x, y, width and height in pixels of what the network may see."""
    mm_per_pixel: float
    """Millimetres on the gel for a pixel of the picture."""
    scale_from: Literal["stated", "sensor", "assumed"]
    """How that is known."""
    assumption: str | None
    """What was assumed of scale and gel; None where all was stated."""
    contact: bool | None
    """Whether something touches the gel; None where nobody looked."""
    regions: NDArray[np.uint32] | None
    """R × 4: x, y, width and height in pixels of the parts that the network ran on; None for all of it."""
    left_out: list[str]
    """What was left out, and why."""
    looked_again: bool
    """Whether a box was in doubt, so that a second run left nothing out."""
    reused: bool
    """Whether the frame is as one before it in a stream, so that its detections are that one's."""
    precision: Literal["f32", "f16", "bf16", "int8"]
    """How maps and weights were stored."""
    stages_ms: dict[str, float]
    """Milliseconds by stage; without those of a GPU that has no timestamps."""
    total_ms: float
    """Milliseconds from picture to detections."""

    @classmethod
    def _of(cls, found: dict[str, Any]) -> "Detections":
        for name, (dtype, row) in _ROWS.items():
            found[name] = np.array(found[name], dtype).reshape(-1, *row)
        for name in ("gel", "part"):
            found[name] = tuple(found[name])
        if found["regions"] is not None:
            found["regions"] = np.array(found["regions"], np.uint32).reshape(-1, 4)
        return cls(**found)

    @property
    def names(self) -> list[str]:
        """Class names of the snaps, N of them."""
        return [self.classes[label] for label in self.labels]

    def __len__(self) -> int:
        return len(self.scores)

    def __iter__(self) -> Iterator[Detection]:
        return map(self._snap, range(len(self)))

    @overload
    def __getitem__(self, which: int) -> Detection: ...

    @overload
    def __getitem__(self, which: Any) -> "Detections": ...

    def __getitem__(self, which: Any) -> "Detection | Detections":
        if isinstance(which, (int, np.integer)) and not isinstance(which, bool):
            return self._snap(range(len(self))[int(which)])
        which = which if isinstance(which, slice) else np.asarray(which)
        if isinstance(which, np.ndarray) and which.size == 0:
            which = which.astype(bool if which.dtype == bool else int)
        return replace(self, **{name: getattr(self, name)[which] for name in _ROWS})

    def _snap(self, at: int) -> Detection:
        label = int(self.labels[at])
        row = {name: _plain(getattr(self, name)[at]) for name in _ROWS if name not in ("boxes", "scores", "labels")}
        box, score = tuple(self.boxes[at].tolist()), float(self.scores[at])
        return Detection(self.classes[label], label, score, box, **row)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and strings, for JSON, under the names that are here; None for NaN."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        for name in [*_ROWS, "regions"]:
            values[name] = None if values[name] is None else _without_nan(values[name].tolist())
        return {**values, "names": self.names, "gel": list(self.gel), "part": list(self.part)}

    def to_supervision(self) -> "supervision.Detections":
        """For the package `supervision`; what it has no name for is in `data`."""
        import supervision

        rest = ("center_mm", "center_std_mm", "yaw_deg", "yaw_std_deg", "whole")
        data = {"class_name": np.array(self.names, dtype=str), **{name: getattr(self, name) for name in rest}}
        return supervision.Detections(
            xyxy=self.boxes, confidence=self.scores, class_id=self.labels, data=data
        )

    def to_pandas(self) -> "pandas.DataFrame":
        """A row a snap."""
        import pandas

        columns: dict[str, Any] = {"class": self.names, "label": self.labels, "score": self.scores}
        columns |= {name: self.boxes[:, axis] for axis, name in enumerate(("x1", "y1", "x2", "y2"))}
        for name in ("center", "center_std"):
            both = getattr(self, f"{name}_mm")
            columns |= {f"{name}_x_mm": both[:, 0], f"{name}_y_mm": both[:, 1]}
        columns |= {name: getattr(self, name) for name in ("yaw_deg", "yaw_std_deg", "whole")}
        return pandas.DataFrame(columns)

    def plot(self, picture: Any) -> "PIL.Image.Image":
        """The picture with boxes, names, scores and directions drawn in; needs Pillow.

        Args:
            picture: a file, an array in RGB or grey of uint8, or a picture of Pillow.
        """
        return drawing.draw(picture, self)


def _plain(value: Any) -> Any:
    """A row as a number, or a tuple of numbers; None for NaN."""
    if np.isnan(value).any():
        return None
    return tuple(value.tolist()) if value.ndim else float(value)


def _without_nan(values: Any) -> Any:
    if isinstance(values, list):
        return [_without_nan(value) for value in values]
    return None if values != values else values
