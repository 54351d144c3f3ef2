"""What a run of `fit` was asked for, kept beside it, and the pictures that it names. Needs no torch."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from .errors import Failure, some
from .files import whole
from .labels import DataSet, Folder, check_labelled, data_set, read_folders
from .sensor import Sensor
from .split import digest, hold_out

FILE = "run.json"


@dataclass
class Request:
    """The arguments of a run, as JSON has them."""

    data: list[str]
    val: list[str]
    steps: int
    mix: list[str] = field(default_factory=list)
    mix_share: float = 0.5
    split: float | None = None
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
        """What there is to learn from, and what is only looked at, what is held out too. Raises `Failure`."""
        sensor = Sensor.open(self.sensor) if self.sensor else None
        own, mix, val = (read_folders(option, list(map(Path, paths)), sensor) for option, paths in (("--data", self.data), ("--mix", self.mix), ("--val", self.val)))
        _apart("--mix", mix, own)
        data = data_set(own + mix, self.classes, self.directed)
        check_labelled(val, data.classes)
        data.folders, data.mix, data.mix_share = own, mix, self.mix_share if mix else 0.0
        if self.split is not None:
            _apart("--val, beside --split", val, own)
            data.folders, data.held_out, data.remarks = hold_out(own, self.split)
            away = {digest(picture) for folder in data.held_out for picture in folder.pictures}
            again = [str(picture.path) for folder in mix for picture in folder.pictures if digest(picture) in away]
            if again:
                raise Failure(f"--mix: expected no picture that is held out, got {some(again)}")
            val = val + data.held_out
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
            # A run of a version that knew fewer options had their defaults.
            return Request(**json.loads(file.read_text(encoding="utf-8")))
        except (ValueError, TypeError) as error:
            raise Failure(f"{file}: expected the arguments of a run, got {type(error).__name__}: {error}") from None


def _apart(option: str, folders: list[Folder], others: list[Folder]) -> None:
    """Raises `Failure` for what is among the folders of --data too."""
    known = {folder.path.resolve() for folder in others}
    twice = [str(folder.path) for folder in folders if folder.path.resolve() in known]
    if twice:
        raise Failure(f"{option}: expected other folders than --data, got {some(twice)}")
