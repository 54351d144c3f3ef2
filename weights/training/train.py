"""Trains SMR-Net from a weight file or from scratch, on views of COCO folders; goes on from its checkpoint after any end.

A step depends only on the seed, its number, the number of steps planned and the folders
at hand, so a killed run goes on to the weights it would have had. OUT/run.json keeps the
arguments: `train.py --out OUT --resume` is all that a later call needs, and an argument
given again replaces the kept one. OUT/plan.json keeps what the run did: how many steps
were planned since which step, and at which step each folder came; `--plan` repeats it.
"""

import argparse
import ctypes
import json
import os
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

# Two cores shared with other work: threads that wait must sleep, not spin.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "0")

import numpy as np
import torch
from torch import Tensor

import folders
import weightfile
from distill import Distiller
from learner import Learner, measure_statistics, network_views, rate, to_learn
from losses import detection_losses
from metrics import detect_folder, figures, line
from model import NETWORKS, Config, SmrNet, Variant
from parts import cached
from pool import AREA, Pool
from truth import Truth

LOOK_EVERY = 100  # steps between looks for new folders
# What a network takes over from another beside which it learns.
SHARED = ("pixels_per_mm", "mean", "std", "anchor_sizes", "anchor_ratios")


def keep_memory() -> None:
    """Keeps freed memory in the process: returning it costs a tenth of a step in page faults."""
    try:
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(-3, 1 << 30)  # M_MMAP_THRESHOLD
        libc.mallopt(-1, 1 << 30)  # M_TRIM_THRESHOLD
    except (OSError, AttributeError):
        pass


class Run:
    """All that a checkpoint holds."""

    def __init__(self, args: argparse.Namespace):
        self.args = args
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        self.file = args.out / "checkpoint.pt"
        # Beside a step, the next one's views.
        self.loader, self.ahead = ThreadPoolExecutor(1, "loader"), None
        state = torch.load(self.file, map_location=self.device, weights_only=True) if self.file.exists() else None
        init = weightfile.load(args.init) if args.init and state is None else None
        if state is None:
            self.step, self.seconds, self.seen, self.timeline = 0, 0.0, 0, []
            self.plan = json.loads(args.plan.read_text()) if args.plan else {"steps": [[0, args.steps]], "data": []}
            self.config = self.new_config(init)
        else:
            self.step, self.seconds, self.seen, self.timeline = state["step"], state["seconds"], state["seen"], state["timeline"]
            self.plan = state["plan"]
            self.config = Config.from_dict(json.loads(state["config"]))
            if args.steps and args.steps != self.steps():
                self.plan["steps"].append([self.step, args.steps])
        self.pool = Pool(self.config.pixels_per_mm, args.room, self.device)
        for _, folder in self.timeline:
            self.take_up(folder)
        self.find_folders()
        while not len(self.pool):
            self.log(f"waiting for a complete training folder, with annotations.json: {' '.join(args.data)}")
            time.sleep(10)
            self.find_folders()
        torch.manual_seed(args.seed)
        distiller = None
        if args.teacher:
            teacher = weightfile.load(args.teacher).eval().requires_grad_(False)
            distiller = Distiller(teacher, self.config).to(self.device)
        self.learner = Learner(self.config, self.device, args.weight_decay, distiller)
        if init:
            self.learner.begin_with(init, args.init)
        self.student = None
        if args.student:
            config = replace(self.config, **NETWORKS[args.student])
            first = weightfile.load(args.student_init) if args.student_init and state is None else None
            # Its own file's anchors, mean and deviation must be this run's: both learn from the same views.
            if first and {k: getattr(first.config, k) for k in SHARED} != {k: getattr(config, k) for k in SHARED}:
                raise SystemExit(f"{args.student_init}: expected {', '.join(SHARED)} of the network that it learns from")
            self.student = Learner(config, self.device, args.weight_decay, Distiller(self.learner.model, config).to(self.device))
            if first:
                self.student.begin_with(first, args.student_init)
        if state is not None:
            self.learner.load(state)
            if self.student:
                self.student.load(state["student"])

    def new_config(self, init: SmrNet | None) -> Config:
        """A weight file brings its own; a new network takes its widths by name and the rest from --like or the defaults."""
        args = self.args
        if init:
            config = init.config
        else:
            like = weightfile.load(args.like).config if args.like else Config()
            variant = Variant(safe=not args.no_safe, msff=not args.no_msff, rw=not args.no_rw)
            kept = {k: getattr(like, k) for k in SHARED}
            config = Config(**kept, **NETWORKS[args.network], variant=variant)
        return to_learn(config)

    def take_up(self, folder: str) -> int:
        """How many pictures it brings."""
        part = cached(Path(folder), self.config.pixels_per_mm, self.args.cache or self.args.out / "cache")
        if not self.pool.add(part):
            raise SystemExit(f"{folder}: expected room for {self.pool.used + len(part.pixels)} pixels, got --room {self.args.room}")
        return len(part.sizes)

    def find_folders(self) -> None:
        """Takes up folders that were finished since the last look."""
        have = {folder for _, folder in self.timeline}
        planned = {name: step for step, name in self.plan["data"]}
        for folder in folders.found(self.args.data):
            due = planned.get(Path(folder).name, self.step + bool(planned)) <= self.step
            if due and folder not in have:
                count = self.take_up(folder)
                self.timeline.append([self.step, folder])
                self.log(f"data: {folder}, {count} pictures, from step {self.step}")

    def log(self, text: str) -> None:
        print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)

    def save(self) -> None:
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "seen": self.seen,
            "plan": self.plan,
            "timeline": self.timeline,
            **self.learner.state(),
        }
        if self.student:
            state["student"] = self.student.state()
        part = self.file.with_suffix(".part")
        torch.save(state, part)
        part.rename(self.file)
        data = [[step, Path(folder).name] for step, folder in self.timeline]
        (self.args.out / "plan.json").write_text(json.dumps({**self.plan, "data": data}) + "\n")

    def steps(self) -> int:
        """How many the whole run has, as planned at this step."""
        return [count for since, count in self.plan["steps"] if since <= self.step][-1]

    def rate(self) -> float:
        return rate(self.args.lr, self.step, self.step / self.steps())

    def load(self, step: int) -> Future[tuple[Tensor, Truth]]:
        """A step's views, made from the folders at hand now."""
        return self.loader.submit(self.pool.batch, step, self.args.area, self.args.seed)

    def train_step(self) -> dict[str, float]:
        began = time.monotonic()
        pixels, truth = (self.ahead or self.load(self.step)).result()
        # New folders may come before such a step.
        self.ahead = self.load(self.step + 1) if (self.step + 1) % LOOK_EVERY else None
        loaded = time.monotonic()
        images = network_views(pixels, self.config, self.device)
        # The choice of anchors and proposals draws from torch's generator.
        torch.manual_seed(self.args.seed * 1_000_003 + self.step)
        # Both ways of running must come out right: with conv5_x, and without it where it is left out.
        share = self.args.without_deepest if self.config.leaves_deepest else 0.0
        scales = 2 if share > 0 and float(torch.rand(())) < share else 3
        losses, fused = detection_losses(self.learner.model, images, truth, self.learner.extra, scales=scales)
        report = {"norm": self.learner.learn(sum(losses.values()), self.rate())}
        if self.student:
            more, _ = detection_losses(self.student.model, images, truth, self.student.extra, fused.detach(), scales)
            student_rate = self.rate() * self.args.student_lr / self.args.lr
            report |= {"student_norm": self.student.learn(sum(more.values()), student_rate)}
            losses |= {f"student_{k}": v for k, v in more.items()}
        self.step += 1
        self.seen += len(images)
        for learner in self.learners():
            learner.average(self.step)
        timing = {"load_s": loaded - began, "step_s": time.monotonic() - began}
        return {**{k: v.item() for k, v in (losses | report).items()}, **timing}

    def learners(self) -> list[Learner]:
        return [self.learner, *([self.student] if self.student else [])]

    def validate(self, limit: int | None) -> None:
        for folder in self.args.val:
            if (folder / "annotations.json").exists():
                for name, learner in zip(("", "student "), self.learners()):
                    found = line(figures(*detect_folder(learner.ema, folder, limit, self.device)))
                    self.log(f"val step {self.step} {name}{folder.name}: {found}")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--resume", action="store_true", help="go on from OUT/checkpoint.pt, with the arguments in OUT/run.json")
    parser.add_argument("--data", nargs="+", help="COCO folders or globs; new matches are taken up as they appear")
    parser.add_argument("--val", type=Path, nargs="+", default=[], help="COCO folders that choose nothing but are reported")
    parser.add_argument("--val-pictures", type=int, default=60, help="the first of each folder")
    parser.add_argument("--steps", type=int, help="of the whole run, earlier calls included")
    parser.add_argument("--plan", type=Path, help="plan.json of an earlier run, to repeat it")
    parser.add_argument("--init", type=Path, help="weight file to start from, with its configuration; by default from scratch")
    parser.add_argument("--network", choices=NETWORKS, default="large", help="of a run from scratch")
    parser.add_argument("--like", type=Path, help="weight file that lends a run from scratch its anchors, mean and deviation")
    parser.add_argument("--teacher", type=Path, help="weight file of a network to learn from")
    parser.add_argument("--student", choices=NETWORKS, help="a network that learns beside this one, on the same views, also from what this one says of them")
    parser.add_argument("--student-init", type=Path, help="weight file from which that network starts; by default from scratch")
    parser.add_argument("--student-lr", type=float, default=1e-3)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--room", type=int, default=10**9, help="for so many pixels of small pictures, of three bytes each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--area", type=int, default=AREA, help="pixels of a batch")
    parser.add_argument("--lr", type=float, default=4e-4)
    parser.add_argument("--weight-decay", type=float, default=0.02)
    parser.add_argument("--checkpoint-minutes", type=float, default=4)
    parser.add_argument("--val-minutes", type=float, default=20)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--without-deepest", type=float, default=0.0, help="share of the steps that compute nothing of conv5_x")
    parser.add_argument("--keep-statistics", action="store_true", help="batch norm as the --init file has it: a view is then seen as in use, whatever its batch")
    parser.add_argument("--no-safe", action="store_true", help="ablation: no attention in the backbone")
    parser.add_argument("--no-msff", action="store_true", help="ablation: conv4_x alone")
    parser.add_argument("--no-rw", action="store_true", help="ablation: concatenation in place of the weights")
    args = parser.parse_args()
    file = args.out / "run.json"
    if args.resume:
        # What was kept replaces the defaults; then the command line speaks again.
        kept = json.loads(file.read_text())
        paths = {a.dest: a for a in parser._actions if a.type is Path}
        for name, value in kept.items():
            if name in paths and value is not None:
                kept[name] = [Path(v) for v in value] if isinstance(value, list) else Path(value)
        parser.set_defaults(**kept)
        args = parser.parse_args()
    elif (args.out / "checkpoint.pt").exists():
        parser.error(f"{args.out} holds a run: give --resume to go on with it")
    if not args.data or not (args.steps or args.plan):
        parser.error("give --data, and --steps or --plan")
    folders.refuse_missing("--data", args.data)
    folders.refuse_missing("--val", [str(folder) for folder in args.val])
    if args.keep_statistics and not args.init:
        parser.error("--keep-statistics: give the --init file whose statistics they are")
    if args.init and (args.like or args.no_safe or args.no_msff or args.no_rw):
        parser.error("--init brings its own configuration")
    args.out.mkdir(parents=True, exist_ok=True)
    plain = {k: [str(p) for p in v] if k == "val" else str(v) if isinstance(v, Path) else v for k, v in vars(args).items()}
    file.write_text(json.dumps({k: v for k, v in plain.items() if k not in ("out", "resume")}, indent=1) + "\n")
    return args


def main() -> None:
    args = arguments()
    keep_memory()
    torch.set_num_threads(args.threads)
    run = Run(args)
    run.log(f"step {run.step} of {run.steps()}, {sum(p.numel() for p in run.learner.model.parameters()) / 1e6:.1f} M parameters, {run.config.to_dict()}")
    for learner in run.learners():
        learner.model.train()
        if args.keep_statistics:
            learner.stand()
    saved = validated = run.seconds
    recent: list[dict] = []
    clock = time.monotonic()
    while run.step < run.steps():
        recent.append(run.train_step())
        if run.step % LOOK_EVERY == 0:
            run.find_folders()
        if run.step % 20 == 0:
            mean = {k: float(np.mean([r[k] for r in recent])) for k in recent[0]}
            text = " ".join(f"{k} {v:.4f}" for k, v in mean.items())
            run.log(f"step {run.step} min {run.seconds / 60:.1f} lr {run.rate():.2e} {text} seen {run.seen}")
            recent = []
        if run.seconds - validated > args.val_minutes * 60:
            run.validate(args.val_pictures)
            validated = run.seconds
        now = time.monotonic()
        run.seconds, clock = run.seconds + now - clock, now
        if run.seconds - saved > args.checkpoint_minutes * 60:
            run.save()
            saved = run.seconds
    run.save()
    run.log(f"done: step {run.step}, {run.seconds / 60:.1f} min, {run.seen} views")
    if not args.keep_statistics:
        for learner in run.learners():
            measure_statistics(learner.ema, run.pool, args.area, args.seed)
            learner.ema.eval()
    run.save()
    run.validate(None)


if __name__ == "__main__":
    main()
