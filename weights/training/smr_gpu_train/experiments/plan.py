"""What is to be trained, on what, and how it is judged: a JSON file. Needs no torch."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from ..config import NETWORKS
from ..errors import Failure

MODELS = ("smr", "faster", "fast", "yolo")
BACKBONES = ("vgg16", "resnet34")
USES = ("train", "val", "test", "negative", "installation")
FULL = "full"  # the row that the others are compared with


@dataclass
class Set:
    """Simulated pictures: `smr-gpu simulate` with these arguments. `negative` ones show no snap; those of `installation` are for Table III alone."""

    name: str
    use: str
    count: int
    seed: int
    options: list[str]
    group: str = ""  # test sets of one group are judged as one; by default a set is one of its own

    def __post_init__(self) -> None:
        self.group = self.group or self.name


@dataclass
class Row:
    """One method or ablation."""

    name: str
    title: str
    model: str
    safe: bool = True
    msff: bool = True
    rw: bool = True
    dilation: bool = True  # False: branches 2 and 3 of MSFF-Net are plain 3 x 3
    every_block: bool = False  # attention after every residual block, not after each stage alone
    backbone: str = "vgg16"  # of faster and fast
    size: str = "n"  # of yolo

    def titled(self, network: str) -> str:
        """Its title with the widths, where there are several."""
        return f"{self.title}, {network}" if self.model == "smr" else self.title

    @property
    def in_a_weight_file(self) -> bool:
        """Whether one can say all that this network is."""
        if self.model == "faster":
            return self.backbone == "resnet34"
        return self.model == "smr" and self.dilation and not self.every_block


@dataclass
class Run:
    row: Row
    network: str  # widths: small or large; of baselines their own
    seed: int

    @property
    def name(self) -> str:
        return f"{self.row.name}-{self.network}-{self.seed}"


@dataclass
class Plan:
    views: int  # of each run, about
    sets: list[Set]
    rows: dict[str, Row]
    runs: list[Run]  # in the order in which they are to be made
    area: int = 12 * 192 * 192  # pixels of a batch
    lr: float = 4e-4
    weight_decay: float = 0.02
    threads: int = 1
    points: int = 9  # validations, evenly spread
    val_pictures: int = 40  # the first of each validation set
    pose: bool = False  # as the paper's network: no direction, no stated deviations
    search: str = "quality"  # mode of selective search: fast or quality
    searchers: int = 1  # processes that search at once
    yolo_batch: int = 16
    installation: list[str] = field(default_factory=list)  # sets of Table III
    inputs: list[int] = field(default_factory=list)  # sides at which the full network is evaluated too; it is trained for 320
    checkpoint_minutes: float = 4

    def of_use(self, *uses: str) -> list[Set]:
        return [each for each in self.sets if each.use in uses]


Kind = TypeVar("Kind")


def _made(kind: type[Kind], where: str, values: Any) -> Kind:
    try:
        return kind(**values)
    except TypeError as error:
        raise Failure(f"{where}: {str(error).replace(f'{kind.__name__}.__init__() ', '')}") from None


def _among(where: str, got: str, known: Any) -> None:
    if got not in known:
        raise Failure(f"{where}: expected one of {', '.join(known)}, got {got}")


def read(file: Path) -> Plan:
    """Raises `Failure` for what is no plan."""
    try:
        given = json.loads(file.read_text(encoding="utf-8"))
        sets, rows, runs = given.pop("sets"), given.pop("rows"), given.pop("runs")
        kept = [_made(Set, f"{file}: sets: {each.get('name')}", each) for each in sets]
        named = {name: _made(Row, f"{file}: rows: {name}", {"name": name, **row}) for name, row in rows.items()}
        for each in kept:
            _among(f"{file}: sets: {each.name}: use", each.use, USES)
        for row in named.values():
            _among(f"{file}: rows: {row.name}: model", row.model, MODELS)
            _among(f"{file}: rows: {row.name}: backbone", row.backbone, BACKBONES)
        ordered = []
        for row, network, *seeds in runs:
            _among(f"{file}: runs", row, named)
            _among(f"{file}: runs: {row}", network, NETWORKS if named[row].model == "smr" else ("own",))
            ordered += [Run(named[row], network, int(seed)) for seed in seeds]
    except OSError as error:
        raise Failure(f"{file}: expected a plan, got {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise Failure(f"{file}: expected a plan, got {type(error).__name__}: {error}") from None
    for name in given.get("installation", ()):
        _among(f"{file}: installation", name, [each.name for each in kept])
    names = [run.name for run in ordered]
    if len({*names}) < len(names):
        raise Failure(f"{file}: expected each run once, got one twice")
    return _made(Plan, str(file), {**given, "sets": kept, "rows": named, "runs": ordered})
