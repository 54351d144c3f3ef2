"""What a run of `fit` was asked for, kept beside it, and the pictures that it names. Needs no torch."""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from .errors import Failure
from .files import whole
from .labels import DataSet, Folder, check_labelled, data_set, read_folders
from .sensor import Sensor

FILE = "run.json"


@dataclass
class Request:
    """The arguments of a run, as JSON has them."""

    data: list[str]
    val: list[str]
    steps: int
    classes: list[str] | None = None
    directed: list[str] | None = None
    sensor: str | None = None
    init: str | None = None
    network: str = "large"
    no_safe: bool = False
    no_msff: bool = False
    no_rw: bool = False
    pixels_per_mm: float | None = None
    mean: list[float] | None = None
    std: list[float] | None = None
    anchor_sizes: list[float] | None = None
    anchor_ratios: list[float] | None = None
    seed: int = 1
    area: int = 12 * 192 * 192
    lr: float = 4e-4
    weight_decay: float = 0.02
    threads: int = 1
    keep_statistics: bool = False
    checkpoint_minutes: float = 4
    val_minutes: float = 20
    val_pictures: int = 60

    def pictures(self) -> tuple[DataSet, list[Folder]]:
        """What there is to learn from, and what is only looked at. Raises `Failure`."""
        sensor = Sensor.open(self.sensor) if self.sensor else None
        data = data_set(read_folders("--data", list(map(Path, self.data)), sensor), self.classes, self.directed)
        val = read_folders("--val", list(map(Path, self.val)), sensor)
        check_labelled(val, data.classes)
        return data, val

    def save(self, out: Path) -> None:
        with whole(out / FILE) as part:
            part.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def load(out: Path) -> "Request":
        file = out / FILE
        if not file.is_file():
            raise Failure(f"{out}: expected a run with {FILE}, got none")
        try:
            kept = json.loads(file.read_text(encoding="utf-8"))
            return Request(**{each.name: kept[each.name] for each in fields(Request)})
        except (ValueError, KeyError, TypeError) as error:
            raise Failure(f"{file}: expected the arguments of a run, got {type(error).__name__}: {error}") from None
