"""Table III: whether a robot that goes where a detector says closes the snap. The model is docs/results/installation.md."""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from ..errors import Failure
from ..files import whole
from ..pictures import Entry
from .plan import FULL, Plan
from .runner import CLASSES, Progress
from .score import CONF
from .tables import of_set, read_found, shown

HOOK_MM = (8.0, 4.0)  # a stud goes in or not, whatever its size
CLEARANCE_MM, LEAD_IN_MM = 0.1, 0.4
STIFFNESS, FORCE = 15.0, 6.0  # N/mm, N
ARM_MM, CALIBRATION_MM, CALIBRATION_DEG, FIXTURE_DEG = 0.03, 0.05, 0.3, 1.0
DRAWS = 500
PAPER = (49, 50)  # of the paper's assemblies, real ones, that closed
TAKEN_UP_MM = min(LEAD_IN_MM, FORCE / STIFFNESS)


@dataclass
class Found:
    """Detections of one picture; `yaw` in degrees, NaN where there is none, `deviations` of x and y in mm and of yaw in degrees, None where none are stated."""

    boxes: np.ndarray  # [K, 4], pixels
    scores: np.ndarray  # [K]
    labels: np.ndarray  # [K], from 1
    yaw: np.ndarray  # [K]
    deviations: np.ndarray | None = None  # [K, 3]


@dataclass
class Trials:
    """One a row."""

    kind: np.ndarray  # A: 1, B: 2
    taken: np.ndarray  # what it is taken for; 0: a miss
    true_yaw: np.ndarray  # degrees, 0 of B
    offset: np.ndarray  # [N, 2], mm, found less true; NaN of a miss
    turn: np.ndarray  # degrees, found less true; NaN where the detector says none
    score: np.ndarray  # 0 of a miss
    deviations: np.ndarray  # [N, 3], NaN where none are stated

    @property
    def stated(self) -> bool:
        """Whether the detector states deviations."""
        return not np.isnan(self.deviations[:, 0]).all()


def trials_of(pictures: Sequence[Entry], found: Sequence[Found]) -> Trials:
    """Raises `Failure` where the numbers of pictures differ."""
    if len(pictures) != len(found):
        raise Failure(f"expected detections of {len(pictures)} pictures, got {len(found)}")
    rows: list[tuple] = []
    none = (math.nan,) * 3
    for entry, each in zip(pictures, found):
        centres = (each.boxes[:, :2] + each.boxes[:, 2:]) / 2
        for box, label, yaw, is_whole in zip(entry.snaps.boxes, entry.snaps.labels, entry.snaps.yaw, entry.snaps.whole):
            if not is_whole:
                continue
            inside = (each.scores >= CONF) & (centres >= box[:2]).all(axis=1) & (centres <= box[2:]).all(axis=1)
            true_yaw = 0.0 if math.isnan(yaw) else math.degrees(yaw)
            if not inside.any():
                rows.append((label, 0, true_yaw, *none, 0.0, *none))
                continue
            best = int(np.flatnonzero(inside)[each.scores[inside].argmax()])
            stated = none if each.deviations is None else tuple(each.deviations[best])
            offset = (centres[best] - (box[:2] + box[2:]) / 2) * entry.mm_per_pixel
            turn = (each.yaw[best] - true_yaw + 180) % 360 - 180
            rows.append((label, each.labels[best], true_yaw, *offset, turn, each.scores[best], *stated))
    table = np.array(rows, float).reshape(-1, 10)
    return Trials(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2], table[:, 3:5], table[:, 5], table[:, 6], table[:, 7:])


def needed(kind: np.ndarray, true_yaw: np.ndarray, offset: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The least play `r` in mm at which it closes, of offsets [..., 2] in mm and turns in degrees."""
    length, width = HOOK_MM
    angle, off = np.radians(true_yaw), np.radians(turn)
    along = np.abs(offset[..., 0] * np.cos(angle) + offset[..., 1] * np.sin(angle))
    across = np.abs(offset[..., 1] * np.cos(angle) - offset[..., 0] * np.sin(angle))
    sin, cos = np.abs(np.sin(off)), np.cos(off)
    hook = np.maximum(along + (length * cos + width * sin - length) / 2, across + (length * sin + width * cos - width) / 2)
    return np.where(kind == 1, hook, np.hypot(offset[..., 0], offset[..., 1]))


def arm(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Errors of arm and calibration: [..., 2] in mm, and in degrees."""
    return rng.normal(0, math.hypot(ARM_MM, CALIBRATION_MM), (*shape, 2)), rng.normal(0, CALIBRATION_DEG, shape)


def least_play(trials: Trials, seed: int = 1) -> np.ndarray:
    """Of each trial the least play in mm at which it closes, infinite of a miss and of a confusion. The draws are the same for all detectors."""
    rng = np.random.default_rng(seed)
    offset, turn = arm(rng, trials.kind.shape)
    fixture = rng.normal(0, FIXTURE_DEG, trials.kind.shape)
    play = needed(trials.kind, trials.true_yaw, trials.offset + offset, turn + np.where(np.isnan(trials.turn), fixture, trials.turn))
    return np.where(trials.taken == trials.kind, play, np.inf)


def likely(trials: Trials, play: float, seed: int = 2) -> np.ndarray:
    """How likely each trial closes, by what the robot knows: kind and yaw as found, and the deviations that the detector states. 0 where nothing is found."""
    rng = np.random.default_rng(seed)
    offset, turn = arm(rng, (DRAWS,))
    own = rng.normal(0, 1, (DRAWS, 3))
    stated = trials.deviations
    yaw = np.where(np.isnan(stated[:, 2]), 0, stated[:, 2])
    where = own[None, :, :2] * stated[:, None, :2] + offset
    turns = own[None, :, 2] * yaw[:, None] + turn
    known = trials.true_yaw + np.nan_to_num(trials.turn)
    closes = needed(trials.taken[:, None], known[:, None], where, turns) <= play
    return np.where(trials.taken == 0, 0, closes.mean(axis=1))


def exact(successes: int, trials: int) -> list[float]:
    """A share with its 95 % interval, Clopper and Pearson's."""
    interval = binomtest(successes, trials).proportion_ci(method="exact")
    return [successes / trials, float(interval.low), float(interval.high)]


def refusals(play: np.ndarray, order: np.ndarray, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Share refused, and the share of the others that close with play `at`, when the trials of the lowest `order` are refused one by one. Trials of one value are refused together."""
    best = np.argsort(-order, kind="stable")
    closed = np.cumsum(play[best] <= at)
    last = np.append(np.diff(order[best]) != 0, True)  # of those with the same value
    tried = np.arange(1, len(best) + 1)[last]
    return 1 - tried / len(best), closed[last] / tried


def of_json(file: Path, pictures: Sequence[tuple[str, Entry]]) -> list[Found]:
    """What `smr-gpu detect --json` printed of the pictures of these sets, in their order."""
    try:
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        kept = {(Path(line["file"]).parts[-3], Path(line["file"]).name): line["detections"] for line in lines}
        return [_found(kept[name, entry.path.name]) for name, entry in pictures]
    except OSError as error:
        raise Failure(f"{file}: {error.strerror}") from None
    except (ValueError, KeyError, IndexError) as error:
        raise Failure(f"{file}: expected what `smr-gpu detect --json` prints of all pictures, got {type(error).__name__}: {error}") from None


def _found(detections: list[dict[str, Any]]) -> Found:
    def column(read: Any, width: tuple[int, ...] = ()) -> np.ndarray:
        return np.array([read(each) for each in detections], float).reshape(len(detections), *width)

    def number(value: float | None) -> float:
        return math.nan if value is None else value

    boxes, scores = column(lambda each: each["box"], (4,)), column(lambda each: each["score"])
    labels = column(lambda each: CLASSES.index(each["class"]) + 1).astype(int)
    stated = column(lambda each: [*map(number, each["center_std_mm"] or [None, None]), number(each["yaw_std_deg"])], (3,))
    return Found(boxes, scores, labels, column(lambda each: number(each["yaw_deg"])), stated)


def of_numbers(kept: list) -> list[Found]:
    """What a run found in some pictures, as tables.read_found has it."""
    return [Found(np.array(boxes, float).reshape(-1, 4), np.array(scores, float), np.array(labels, int), np.full(len(scores), math.nan)) for boxes, scores, labels in kept]


def markdown(methods: dict[str, Trials], plays: dict[str, np.ndarray]) -> str:
    """Table III, of each method's trials and their least plays."""
    lines = ["| | snap | trials | misses | confusions | closed, %: without a lead-in | with it | with it, the tenth refused that it trusts least |", "|---|---|---|---|---|---|---|---|"]
    bare, eased = CLEARANCE_MM, CLEARANCE_MM + TAKEN_UP_MM
    for name, trials in methods.items():
        trust = likely(trials, eased) if trials.stated else trials.score
        for label, kind in enumerate(CLASSES, start=1):
            own = trials.kind == label
            count, play, taken = int(own.sum()), plays[name][own], trials.taken[own]
            if not count:
                continue
            kept = play[np.argsort(-trust[own], kind="stable")[: count - count // 10]]
            shares = [shown(exact(int((each <= at).sum()), len(each))) for each, at in ((play, bare), (play, eased), (kept, eased))]
            missed, confused = (taken == 0).sum(), ((taken != label) & (taken != 0)).sum()
            lines.append(f"| {name} | {kind} | {count} | {missed} | {confused} | {' | '.join(shares)} |")
    lines.append(f"| the paper's SMR-Net, real | both | {PAPER[1]} | – | – | – | {shown(exact(*PAPER))} | – |")
    return "\n".join(lines) + "\n"


def refusing(trials: Trials, play: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """`refusals` by the score, and by stated deviations where there are some, without a lead-in."""
    orders = {"score": trials.score}
    if trials.stated:
        orders["stated deviations"] = likely(trials, CLEARANCE_MM)
    return {by: refusals(play, order, CLEARANCE_MM) for by, order in orders.items()}


def write(args: argparse.Namespace, plan: Plan) -> None:
    """OUT/installation.md, installation.png and refusals.png, of each network's first complete run and of the files that are given.

    The figures are without the ablations."""
    from . import charts

    names = plan.installation
    pictures = [(name, entry) for name in names for entry in of_set(args.data, name)]
    entries = [entry for _, entry in pictures]
    methods: dict[str, Trials] = {}
    ablations = set[str]()
    for title, file in args.detections:
        methods[title] = trials_of(entries, of_json(file, pictures))
    for run in plan.runs:
        title = run.row.titled(run.network)
        if title in methods or not Progress.load(args.out / run.name).complete:
            continue
        kept = read_found(args.out / run.name, names)
        if kept is not None:
            methods[title] = trials_of(entries, of_numbers(kept))
            if run.row.model == "smr" and run.row.name != FULL:
                ablations.add(title)
    if not methods:
        raise Failure(f"{args.out}: expected detections of a complete run in the sets {', '.join(names)}, or --detections, got none")
    plays = {name: least_play(trials) for name, trials in methods.items()}
    with whole(args.out / "installation.md") as part:
        part.write_text(markdown(methods, plays), encoding="utf-8")
    drawn = {name: trials for name, trials in methods.items() if name not in ablations}
    charts.clearance({name: (trials.kind, plays[name]) for name, trials in drawn.items()}, args.out / "installation.png")
    charts.refusals({name: refusing(trials, plays[name]) for name, trials in drawn.items()}, args.out / "refusals.png")
    print(f"{args.out / 'installation.md'}, installation.png, refusals.png: {len(methods)} methods")
