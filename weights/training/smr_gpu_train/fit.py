"""Trains SMR-Net from a weight file or from scratch, on views of labelled pictures.

A step depends only on the seed, its number, the number of steps and the pictures, so a run that was stopped or killed
goes on to the weights it would have had. OUT/run.json keeps what was asked for, OUT/checkpoint.pt how far it has come,
OUT/history.jsonl how, OUT/weights.safetensors what came of it.
"""

import ctypes
import json
import pickle
import signal
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchvision.ops import box_iou

from . import boxes as bx
from . import history, split, weightfile
from .config import ANCHOR_RATIOS, ANCHOR_SIZES, NETWORKS, Config, Variant
from .data import scaled, whole_tiles
from .errors import Failure, counted
from .files import locked, whole
from .history import History
from .labels import DataSet, Folder
from .learner import Learner, measure_statistics, network_views, rate
from .losses import detection_losses
from .metrics import detect_all, figures, line
from .model import SmrNet
from .parts import Part, cached, narrow
from .pictures import Entry, entries
from .pool import Pool
from .request import Request
from .truth import Truth

STOPPED = 130
SCALE_PER_MM = 8.0


def keep_memory() -> None:
    """Keeps freed memory in the process: returning it costs a tenth of a step in page faults."""
    try:
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(-3, 1 << 30)  # M_MMAP_THRESHOLD
        libc.mallopt(-1, 1 << 30)  # M_TRIM_THRESHOLD
    except (OSError, AttributeError):
        pass


def log(text: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


def parts_of(data: DataSet, pixels_per_mm: float, out: Path) -> tuple[list[Part], list[str]]:
    """Each folder's small pictures, those that are mixed in last, and the keys of their content."""
    found = [cached(folder, data.classes, data.directed, pixels_per_mm, out / "cache") for folder in data.folders + data.mix]
    return [part for part, _ in found], [key for _, key in found]


def look(parts: list[Part]) -> tuple[list[float], list[float]]:
    """Mean and deviation of the channels, 0 to 1."""
    count = sum(len(part.pixels) for part in parts)
    mean = sum(part.pixels.sum(axis=0, dtype=np.float64) for part in parts) / count
    # A folder at a time, so that few of its pixels are floats at once.
    square = sum(np.square(part.pixels, dtype=np.float32).sum(axis=0, dtype=np.float64) for part in parts) / count
    std = np.sqrt(np.maximum(square - mean**2, 0))
    return [round(float(v) / 255, 4) for v in mean], [max(0.001, round(float(v) / 255, 4)) for v in std]


def new_config(asked: Request, data: DataSet, init: SmrNet | None, out: Path) -> Config:
    """A weight file brings its own; a new network takes its widths by name and the rest from the arguments or the pictures."""
    if init is not None:
        return init.config.to_learn(data.classes, data.directed)
    variant = Variant(safe=not asked.no_safe, msff=not asked.no_msff, rw=not asked.no_rw)
    scale = asked.pixels_per_mm or SCALE_PER_MM
    mean, std = look(parts_of(data, scale, out)[0]) if asked.mean is None or asked.std is None else (asked.mean, asked.std)
    own: dict[str, Any] = {"mean": asked.mean or mean, "std": asked.std or std, "anchor_sizes": asked.anchor_sizes or ANCHOR_SIZES, "anchor_ratios": asked.anchor_ratios or ANCHOR_RATIOS}
    return Config(pixels_per_mm=scale, variant=variant, **own, **NETWORKS[asked.network]).to_learn(data.classes, data.directed)


def unreached(config: Config, pictures: list[Entry]) -> int:
    """How many snaps no anchor overlaps by half: the network can hardly learn to find these."""
    cells, count = bx.cell_anchors(config.anchor_sizes, config.anchor_ratios), 0
    for entry in pictures:
        scale = entry.mm_per_pixel * config.pixels_per_mm
        height, width = (whole_tiles(scaled(side, scale)) // config.stride for side in entry.size)
        anchors = bx.grid_anchors(cells, height, width, config.stride)
        overlaps = box_iou(torch.from_numpy(entry.snaps.boxes).to(anchors.dtype) * scale, anchors)
        count += int((overlaps.amax(dim=1) < 0.5).sum())
    return count


def read_checkpoint(file: Path, device: str = "cpu") -> dict[str, Any]:
    """Raises `Failure` for what is none."""
    try:
        state: dict[str, Any] = torch.load(file, map_location=device, weights_only=True)
        return state
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise Failure(f"{file}: expected a checkpoint of fit, got {type(error).__name__}") from None


class Run:
    """All that a checkpoint holds."""

    def __init__(self, asked: Request, data: DataSet, val: list[Folder], out: Path):
        self.asked, self.out = asked, out
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        self.file, self.history = out / "checkpoint.pt", History(out / history.FILE)
        state = read_checkpoint(self.file, self.device) if self.file.exists() else None
        init = weightfile.load(Path(asked.init)) if asked.init and state is None else None
        if state is None:
            self.step, self.seconds, self.seen, self.measured = 0, 0.0, 0, asked.keep_statistics
            self.recent: list[dict[str, float]] = []  # losses that were not said yet
            self.config = new_config(asked, data, init, out)
        else:
            self.step, self.seconds, self.seen, self.measured = state["step"], state["seconds"], state["seen"], state["measured"]
            self.recent = state.get("recent", [])
            self.config = Config.from_dict(json.loads(state["config"]))
        parts, self.keys = parts_of(data, self.config.pixels_per_mm, out)
        if state is not None and self.keys != state["keys"]:
            raise Failure(f"{out}: expected the pictures and labels that the run began with, got others: begin a new one")
        own = len(data.folders)
        self.pool = Pool.of(parts[:own], self.config, self.device, parts[own:], data.mix_share)
        pictures = [entry for folder in data.folders + data.mix for entry in entries(folder, data.classes, data.directed)]
        thin = narrow(pictures, self.config.pixels_per_mm)
        if thin:
            log(f"{counted(thin, 'box', 'boxes')} narrower than 2 pixels of the network's input left out")
        far = unreached(self.config, pictures)
        if far:
            log(f"{counted(far, 'snap')} that no anchor overlaps by half: hard to find; --anchor-sizes and --anchor-ratios say others")
        self.val = [(folder.path, entries(folder, data.classes, data.directed)) for folder in val]
        torch.manual_seed(asked.seed)
        self.learner = Learner(self.config, self.device, asked.weight_decay)
        if init is not None:
            new = self.learner.begin_with(init)
            if new:
                log(f"{asked.init}: its heads say nothing of {', '.join(new)}, which begin anew")
        if state is not None:
            self.learner.load(state)
        # Beside a step, the next one's views.
        self.loader = ThreadPoolExecutor(1, "loader")
        self.ahead: Future[tuple[Tensor, Truth]] | None = None

    def save(self) -> None:
        """The checkpoint, whole or not at all."""
        state = {"step": self.step, "seconds": self.seconds, "seen": self.seen, "measured": self.measured, "recent": self.recent, "keys": self.keys, **self.learner.state()}
        with whole(self.file, RuntimeError) as part:
            torch.save(state, part)

    def load(self, step: int) -> Future[tuple[Tensor, Truth]]:
        """A step's views."""
        return self.loader.submit(self.pool.batch, step, self.asked.area, self.asked.seed)

    def train_step(self) -> dict[str, float]:
        asked = self.asked
        pixels, truth = (self.ahead or self.load(self.step)).result()
        self.ahead = self.load(self.step + 1)
        images = network_views(pixels, self.config, self.device)
        # The choice of anchors and proposals draws from torch's generator.
        torch.manual_seed(asked.seed * 1_000_003 + self.step)
        losses = detection_losses(self.learner.model, images, truth)
        total = torch.stack([*losses.values()]).sum()
        norm = self.learner.learn(total, rate(asked.lr, self.step, asked.steps))
        self.step += 1
        self.seen += len(images)
        self.learner.average(self.step)
        return {k: v.item() for k, v in ({"loss": total.detach()} | losses | {"norm": norm}).items()}

    def validate(self, limit: int | None) -> None:
        """On the first pictures of each folder, or on all."""
        rows = {str(path): figures(*detect_all(self.learner.ema, pictures[:limit], self.device), self.config.classes) for path, pictures in self.val}
        if rows:
            self.history.add({"step": self.step, "val": rows})
        for path, found in rows.items():
            log(f"val step {self.step} {path}: {line(found)}")

    def train(self, stopped: Callable[[], bool]) -> bool:
        """To the end, or until it is stopped; whether it came to the end. Either way there is a checkpoint of it then."""
        asked, model = self.asked, self.learner.model
        model.train()
        if asked.keep_statistics:
            self.learner.stand()
        every = max(1, min(20, asked.steps // 10))
        saved = validated = began = self.seconds
        first, clock = self.step, time.monotonic()
        while self.step < asked.steps and not stopped():
            self.recent.append(self.train_step())
            now = time.monotonic()
            self.seconds, clock = self.seconds + now - clock, now
            if self.step % every == 0:
                means = {k: float(np.mean([r[k] for r in self.recent])) for k in self.recent[0]}
                left = (self.seconds - began) / (self.step - first) * (asked.steps - self.step)
                self.history.add({"step": self.step, "steps": asked.steps, "seconds_left": left, **means})
                log(f"step {self.step} of {asked.steps}, {left / 60:.1f} min left: " + " ".join(f"{k} {v:.4f}" for k, v in means.items()))
                self.recent = []
            # What comes after the last step is evaluated in the end.
            if self.seconds - validated > asked.val_minutes * 60 and self.step < asked.steps:
                self.validate(asked.val_pictures)
                validated = self.seconds
            if self.seconds - saved > asked.checkpoint_minutes * 60 and self.step < asked.steps:
                self.save()
                saved = self.seconds
        self.save()
        return self.step >= asked.steps

    def finish(self) -> Path:
        """Batch norm statistics, and the weight file."""
        if not self.measured:
            measure_statistics(self.learner.ema, self.pool, self.asked.area, self.asked.seed, self.asked.steps)
            self.learner.ema.eval()
            self.measured = True
            self.save()
        file = self.out / "weights.safetensors"
        weightfile.save(self.learner.ema, file)
        return file


class Stopping:
    """Ctrl-C and a request to end let the step end; a second one does not wait."""

    def __init__(self) -> None:
        self.asked = False
        self.before = {number: signal.signal(number, self.take) for number in (signal.SIGINT, signal.SIGTERM)}

    def take(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        log("stopping after this step")

    def back(self) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)


TIMED = 4  # steps of an estimate, after one that warms up


def estimate(asked: Request, data: DataSet, val: list[Folder], out: Path) -> int:
    """Checks all that a run does and times a few steps; the last line says what there is and how long a step takes, as JSON.

    Of files only the small pictures are written, which a run would write too.
    """
    torch.set_num_threads(asked.threads)
    keep_memory()
    fit = Run(asked, data, val, out)
    fit.learner.model.train()
    if asked.keep_statistics:
        fit.learner.stand()
    try:
        fit.train_step()
        began = time.monotonic()
        for _ in range(TIMED):
            fit.train_step()
        seconds = (time.monotonic() - began) / TIMED
    finally:
        fit.loader.shutdown(wait=True, cancel_futures=True)
    counts = data.counts()
    said = {"pictures": counts.pictures, "without_snap": counts.bare, "snaps": counts.snaps, "directed": data.directed}
    print(json.dumps(said | {"device": fit.device, "threads": asked.threads, "seconds_per_step": seconds, "steps": asked.steps}), flush=True)
    return 0


def run(asked: Request, data: DataSet, val: list[Folder], out: Path) -> int:
    with locked(out) as ours:
        if not ours:
            raise Failure(f"{out}: expected a run that no other process trains, got one that another does")
        return _run(asked, data, val, out)


def _run(asked: Request, data: DataSet, val: list[Folder], out: Path) -> int:
    torch.set_num_threads(asked.threads)
    keep_memory()
    asked.save(out)
    fit = Run(asked, data, val, out)
    if asked.split is not None:
        split.save(out, asked.split, data.held_out)
    fit.history.back(fit.step, asked.steps)
    size = sum(p.numel() for p in fit.learner.model.parameters()) / 1e6
    log(f"step {fit.step} of {asked.steps} on {fit.device}, {asked.threads} threads, {size:.1f} M parameters, {fit.config.to_dict()}")
    stopping = Stopping()
    try:
        ended = fit.train(lambda: stopping.asked)
    finally:
        fit.loader.shutdown(wait=True, cancel_futures=True)
        stopping.back()
    if not ended:
        log(f"stopped after step {fit.step}: `smr-gpu-train fit --out {out} --resume` goes on, `export --run {out}` writes the weights as they are")
        return STOPPED
    file = fit.finish()
    fit.validate(None)
    log(f"done: {asked.steps} steps, {fit.seconds / 60:.1f} min, {fit.seen} views: {file}")
    return 0
