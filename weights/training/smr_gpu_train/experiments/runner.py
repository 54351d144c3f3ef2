"""Trains a plan's runs one by one. A run that was stopped or killed goes on to the weights that it would have had.

OUT/RUN/checkpoint.pt is how far a run has come, OUT/RUN/progress.json the same in words, OUT/RUN/model.pt what came of it;
beside that OUT/RUN/weights.safetensors where a weight file can hold it. Two runners share the work: each run has a lock.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import weightfile
from ..config import Config
from ..errors import Failure
from ..files import locked, whole
from ..fit import Stopping, keep_memory, log, look, parts_of, read_checkpoint
from ..labels import DataSet, check_labelled, data_set, read_folders
from ..learner import Learner, measure_statistics, network_views, rate
from ..metrics import figures
from ..model import SmrNet
from ..pictures import Entry, entries
from ..pool import MOST_VIEWS, WHOLE, WHOLE_SHARE, WINDOWS
from .models import SCALE_PER_MM, configuration, find, losses, maker, see, truth_of
from .plan import Plan, Row, Run
from .proposals import Views, searched

CLASSES, DIRECTED = ["A", "B"], ["A"]
STILL = 0.01  # AP50:95 that a run gains in its last third if it is still rising


def views_a_step(area: int) -> float:
    """How many there are on average: pool.py draws windows of several sizes."""
    def of(shapes: list[tuple[int, int]]) -> float:
        return float(np.mean([min(MOST_VIEWS, max(2, round(area / (h * w)))) for h, w in shapes]))

    return (1 - WHOLE_SHARE) * of([(side, side) for side in WINDOWS]) + WHOLE_SHARE * of([*WHOLE])


def steps(plan: Plan) -> int:
    return max(1, round(plan.views / views_a_step(plan.area)))


def rising(curve: list[tuple[int, float]]) -> bool:
    """Whether the last third of a run gained more than a point; `curve` is (views or steps, AP50:95), evenly spread."""
    return len(curve) >= 3 and curve[-1][1] - curve[len(curve) - 1 - len(curve) // 3][1] > STILL


@dataclass
class Progress:
    """OUT/RUN/progress.json"""

    step: int = 0
    steps: int = 0
    seconds: float = 0.0
    views: int = 0
    curve: list[tuple[int, float]] | None = None  # step, AP50:95 of the validation pictures
    complete: bool = False

    def save(self, out: Path) -> None:
        with whole(out / "progress.json") as part:
            part.write_text(json.dumps(vars(self)) + "\n", encoding="utf-8")

    @staticmethod
    def load(out: Path) -> "Progress":
        file = out / "progress.json"
        return Progress(**json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else Progress()


def folders(plan: Plan, data: Path, use: str) -> DataSet:
    read = read_folders("--data", [data / each.name for each in plan.of_use(use)], None)
    check_labelled(read, CLASSES)
    return data_set(read, CLASSES, DIRECTED) if use == "train" else DataSet(read, CLASSES, DIRECTED)


def pictures(plan: Plan, data: Path, use: str, limit: int | None = None) -> list[Entry]:
    return [entry for folder in folders(plan, data, use).folders for entry in entries(folder, CLASSES, DIRECTED)[:limit]]


class Training:
    """All that a checkpoint holds, and the pictures."""

    def __init__(self, plan: Plan, run: Run, data: Path, out: Path):
        self.plan, self.run, self.out = plan, run, out / run.name
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        train = folders(plan, data, "train")
        parts, self.keys = parts_of(train, SCALE_PER_MM, out)
        self.config = configuration(run.row, run.network, *look(parts), plan.pose)
        pool = Views.of(parts, self.config, self.device)
        assert isinstance(pool, Views)
        self.pool = pool
        val = pictures(plan, data, "val", plan.val_pictures)
        self.val, self.truths = [see(entry) for entry in val], [truth_of(entry) for entry in val]
        self.regions: list[Tensor] | None = None  # of the validation pictures
        if run.row.model == "fast":
            log("selective search on the pictures, once")
            self.pool.regions = searched(pictures(plan, data, "train"), plan.search, out / "cache", plan.searchers).boxes.to(self.device)
            self.regions = searched(val, plan.search, out / "cache", plan.searchers).each()
        torch.manual_seed(run.seed)
        self.learner = Learner(self.config, self.device, plan.weight_decay, maker(run.row))
        self.now = Progress(steps=steps(plan), curve=[])
        self.file = self.out / "checkpoint.pt"
        if self.file.exists():
            state = read_checkpoint(self.file, self.device)
            if state["keys"] != self.keys or state["now"]["steps"] != self.now.steps:
                raise Failure(f"{self.out}: expected the pictures and steps that the run began with, got others: begin in another folder")
            self.now = Progress(**state["now"])
            self.learner.load(state)

    def save(self) -> None:
        with whole(self.file, RuntimeError) as part:
            torch.save({"now": vars(self.now), "keys": self.keys, **self.learner.state()}, part)
        self.now.save(self.out)

    def step(self) -> float:
        plan, step, seed = self.plan, self.now.step, self.run.seed
        pixels, truth, proposals = self.pool.views(step, plan.area, seed)
        # The choice of anchors and proposals draws from torch's generator.
        torch.manual_seed(seed * 1_000_003 + step)
        found = losses(self.learner.model, network_views(pixels, self.config, self.device), truth, proposals)
        total = torch.stack([*found.values()]).sum()
        self.learner.learn(total, rate(plan.lr, step, self.now.steps))
        self.now.step += 1
        self.now.views += len(pixels)
        self.learner.average(self.now.step)
        return float(total.detach())

    def validate(self) -> None:
        found = find(self.learner.ema, self.val, self.device, self.regions)
        row = figures(self.truths, found, CLASSES)["all"]
        assert self.now.curve is not None
        self.now.curve.append((self.now.step, round(row["ap50_95"], 4)))
        log(f"{self.run.name} step {self.now.step}: IoU {100 * row['iou']:.1f}, AP50 {100 * row['ap50']:.1f}, AP50:95 {100 * row['ap50_95']:.1f} of {len(self.val)} validation pictures")

    def train(self, stopped: Callable[[], bool]) -> bool:
        """To the end, or until it is stopped; whether it came to the end. Either way there is a checkpoint then."""
        now, points = self.now, min(self.plan.points, self.now.steps)
        self.learner.model.train()
        saved, clock = now.seconds, time.monotonic()
        while now.step < now.steps and not stopped():
            loss = self.step()
            if now.step * points // now.steps > (now.step - 1) * points // now.steps:
                self.validate()
            now.seconds, clock = now.seconds + time.monotonic() - clock, time.monotonic()
            if now.step % max(1, now.steps // 50) == 0:
                log(f"{self.run.name} step {now.step} of {now.steps}, {now.seconds / now.step * (now.steps - now.step) / 60:.0f} min left: loss {loss:.3f}")
            if now.seconds - saved >= self.plan.checkpoint_minutes * 60 and now.step < now.steps:
                self.save()
                saved = now.seconds
        self.save()
        return now.step >= now.steps

    def finish(self) -> None:
        """Batch norm statistics, and the network."""
        model = self.learner.ema
        measure_statistics(model, self.pool, self.plan.area, self.run.seed, self.now.steps)
        model.eval()
        with whole(self.out / "model.pt", RuntimeError) as part:
            torch.save({"config": json.dumps(self.config.to_dict()), "state": model.state_dict()}, part)
        if self.run.row.in_a_weight_file:
            weightfile.save(model, self.out / "weights.safetensors")
        self.now.complete = True
        self.now.save(self.out)
        self.file.unlink()


def load(row: Row, out: Path, device: str = "cpu") -> SmrNet:
    """The network of a complete run, ready for inference."""
    saved: dict[str, Any] = read_checkpoint(out / "model.pt", device)
    model = maker(row)(Config.from_dict(json.loads(saved["config"]))).to(device)
    model.load_state_dict(saved["state"])
    return model.to(memory_format=torch.channels_last).eval()


def run_one(plan: Plan, run: Run, data: Path, out: Path, program: Path | None, stopped: Callable[[], bool]) -> bool:
    """Whether it came to the end."""
    if run.row.model == "yolo":
        if program is None:
            log(f"{run.name}: left out: --yolo names no program")
            return True
        from . import yolo

        return yolo.train(plan, run, data, out, program, stopped)
    training = Training(plan, run, data, out)
    if not training.train(stopped):
        return False
    training.finish()
    log(f"{run.name}: complete, {training.now.views} views in {training.now.seconds / 60:.0f} min")
    return True


def run_all(plan: Plan, runs: list[Run], data: Path, out: Path, program: Path | None) -> bool:
    """In their order, without what is complete, what another runner has, and what needs a program that is not given; whether it came to the end.

    A run that fails does not keep the others from theirs: `Failure` is raised in the end."""
    torch.set_num_threads(plan.threads)
    keep_memory()
    stopping, failed = Stopping(), list[str]()
    try:
        for run in runs:
            with locked(out / run.name) as ours:
                if not ours or Progress.load(out / run.name).complete:
                    continue
                try:
                    if not run_one(plan, run, data, out, program, lambda: stopping.asked):
                        return False
                except Failure as failure:
                    failed.append(f"{run.name}: {failure}")
                    log(failed[-1])
        if failed:
            raise Failure("; ".join(failed))
        return True
    finally:
        stopping.back()


def status(plan: Plan, runs: list[Run], out: Path) -> list[str]:
    """A table; what is left of runs not begun is estimated by those of their row and widths."""
    kept = {run.name: Progress.load(out / run.name) for run in runs}
    rows = ["| run | step | time, h | left, h | AP50:95 | |", "|---|---|---|---|---|---|"]
    pace = {(run.row.name, run.network): kept[run.name].seconds / kept[run.name].step for run in runs if kept[run.name].step}
    for run in runs:
        now = kept[run.name]
        total = now.steps or (0 if run.row.model == "yolo" else steps(plan))
        each = pace.get((run.row.name, run.network))
        left = "0" if now.complete else "" if each is None or not total else f"{each * (total - now.step) / 3600:.1f}"
        curve = now.curve or []
        state = ("complete" + (", still rising" if rising(curve) else "")) if now.complete else "begun" if now.step else ""
        rows.append(f"| {run.name} | {now.step} of {total or '?'} | {now.seconds / 3600:.2f} | {left} | {f'{100 * curve[-1][1]:.1f}' if curve else ''} | {state} |")
    done = sum(each.complete for each in kept.values())
    return [*rows, "", f"{done} of {len(runs)} runs complete, {sum(each.seconds for each in kept.values()) / 3600:.1f} h so far"]
