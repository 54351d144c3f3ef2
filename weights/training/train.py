"""Trains SMR-Net, from scratch or from a weight file: first on crops at the final scale, then on whole pictures with a falling rate.

A step depends only on the seed, its number, the plan (how many steps each phase
has) and the folders at hand. So a killed run goes on from its checkpoint to the
same weights. Given --minutes instead of steps, the run sets the numbers from its
own speed and keeps them in plan.json, with the step at which each folder came;
--plan plan.json repeats the run.
"""

import argparse
import ctypes
import glob
import json
import math
import os
import time
from pathlib import Path

# Two cores shared with other work: threads that wait must sleep, not spin.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "0")

import numpy as np
import torch
from torch import nn

import weightfile
from data import Chunk, batch_at, normalise
from losses import detection_losses
from metrics import detect_folder, figures
from model import Config, SmrNet, Variant

CROP_SHARE = 0.5  # of --minutes
WARMUP = 150  # steps
EMA_EVERY, EMA_DECAY = 4, 0.998


def keep_memory() -> None:
    """Keeps freed memory in the process: returning it costs a tenth of a step in page faults."""
    try:
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(-3, 1 << 30)  # M_MMAP_THRESHOLD
        libc.mallopt(-1, 1 << 30)  # M_TRIM_THRESHOLD
    except (OSError, AttributeError):
        pass


def centres(values: np.ndarray, count: int) -> list[float]:
    """One-dimensional k-means from the quantiles."""
    middle = np.quantile(values, (np.arange(count) + 0.5) / count)
    for _ in range(50):
        nearest = np.abs(values[:, None] - middle).argmin(axis=1)
        middle = np.array([values[nearest == k].mean() if (nearest == k).any() else middle[k] for k in range(count)])
    return middle.tolist()


def choose_anchors(chunk: Chunk, sizes: int = 4) -> tuple[list[float], list[float]]:
    """Sizes by k-means of the boxes' square-rooted area; three ratios, the outer ones met or passed by a fifth of the boxes."""
    extent = np.concatenate([b[:, 2:] - b[:, :2] for b in chunk.boxes])
    size = centres(np.log(np.sqrt(extent.prod(axis=1))), sizes)
    slant = np.abs(np.log(extent[:, 1] / extent[:, 0]))
    ratio = round(float(np.exp(np.quantile(slant, 0.8))), 2)
    return [float(round(math.exp(s))) for s in size], [round(1 / ratio, 3), 1.0, ratio]


class Run:
    """All that a checkpoint holds."""

    def __init__(self, args: argparse.Namespace):
        self.args = args
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        self.file = args.out / "checkpoint.pt"
        self.chunks: list[Chunk] = []
        state = torch.load(self.file, map_location=self.device, weights_only=True) if self.file.exists() else None
        init = weightfile.load(args.init) if args.init and state is None else None
        if state is None:
            self.step, self.seconds, self.seen = 0, 0.0, 0
            self.plan = {"crop": args.crop_steps, "full": [[0, args.full_steps]] if args.full_steps else [], "data": []}
            if args.plan:
                self.plan = json.loads(args.plan.read_text())
            self.timeline: list[list] = []
            self.find_chunks()
            while not self.chunks:
                self.log("waiting for a complete training folder")
                time.sleep(10)
                self.find_chunks()
            # A weight file brings its own configuration: its tensors have no other meaning.
            self.config = init.config if init else self.measure_config()
            if self.config.input_size != args.size:
                raise SystemExit(f"{args.init}: made for pictures of {self.config.input_size}, not --size {args.size}")
        else:
            self.step, self.seconds, self.seen, self.timeline = state["step"], state["seconds"], state["seen"], state["timeline"]
            self.plan = state["plan"]
            if args.crop_steps:
                self.plan["crop"] = args.crop_steps
            if args.full_steps:
                self.plan["full"].append([self.step, args.full_steps])
            self.config = Config.from_dict(json.loads(state["config"]))
            self.chunks = [Chunk(Path(folder), args.size, args.cache) for _, folder in self.timeline]
        torch.manual_seed(args.seed)
        self.model = SmrNet(self.config).to(self.device, memory_format=torch.channels_last)
        self.ema = SmrNet(self.config).to(self.device, memory_format=torch.channels_last).eval()
        decay = [p for p in self.model.parameters() if p.ndim > 1]
        plain = [p for p in self.model.parameters() if p.ndim <= 1]
        groups = [{"params": decay, "weight_decay": args.weight_decay}, {"params": plain, "weight_decay": 0.0}]
        self.optimizer = torch.optim.AdamW(groups, args.lr, betas=(0.9, 0.99), fused=True)
        if state is None:
            if init:
                self.model.load_state_dict(init.state_dict())
            self.ema.load_state_dict(self.model.state_dict())
        else:
            self.model.load_state_dict(state["model"])
            self.ema.load_state_dict(state["ema"])
            self.optimizer.load_state_dict(state["optimizer"])

    def measure_config(self) -> Config:
        """A new network's configuration, from the arguments and the pictures at hand."""
        args = self.args
        pixels = np.concatenate([c.pictures for c in self.chunks]).reshape(-1, 3)[::97].astype(np.float64) / 255
        sizes, ratios = choose_anchors(self.chunks[0])
        return Config(
            input_size=args.size,
            mean=[round(v, 4) for v in pixels.mean(axis=0).tolist()],
            std=[round(v, 4) for v in pixels.std(axis=0).tolist()],
            anchor_sizes=sizes,
            anchor_ratios=ratios,
            variant=Variant(safe=not args.no_safe, msff=not args.no_msff, rw=not args.no_rw),
            picture_size=int(round(self.chunks[0].geometry[0, 0] * args.size)),
        )

    def find_chunks(self) -> None:
        """Takes up folders that were finished since the last look."""
        have = {folder for _, folder in self.timeline}
        planned = {name: step for step, name in self.plan["data"]}
        for pattern in self.args.data:
            for folder in sorted(glob.glob(str(pattern))):
                due = planned.get(Path(folder).name, self.step + bool(planned)) <= self.step
                if due and folder not in have and (Path(folder) / "annotations.json").exists():
                    self.chunks.append(Chunk(Path(folder), self.args.size, self.args.cache))
                    self.timeline.append([self.step, folder])
                    self.log(f"data: {folder}, {len(self.chunks[-1])} pictures, from step {self.step}")

    def log(self, text: str) -> None:
        print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)

    def save(self) -> None:
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "seen": self.seen,
            "plan": self.plan,
            "timeline": self.timeline,
            "config": json.dumps(self.config.to_dict()),
            "model": self.model.state_dict(),
            "ema": self.ema.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        part = self.file.with_suffix(".part")
        torch.save(state, part)
        part.rename(self.file)
        data = [[step, Path(folder).name] for step, folder in self.timeline]
        (self.args.out / "plan.json").write_text(json.dumps({**self.plan, "data": data}) + "\n")

    def full_steps(self) -> int | None:
        """How many steps the whole-picture phase has, as known at this step."""
        known = [count for since, count in self.plan["full"] if since <= self.step]
        return known[-1] if known else None

    def rate(self) -> float:
        """Warm up, stay, then a half cosine to zero over the whole-picture phase."""
        rate = self.args.lr * min(1.0, (self.step + 1) / WARMUP)
        full = self.full_steps()
        if self.plan["crop"] is not None and full and self.step >= self.plan["crop"]:
            done = (self.step - self.plan["crop"]) / full
            rate *= 0.5 * (1 + math.cos(math.pi * min(1.0, done)))
        return rate

    def train_step(self) -> dict[str, float]:
        args = self.args
        whole = self.plan["crop"] is not None and self.step >= self.plan["crop"]
        batch, crop = (args.full_batch, args.size) if whole else (args.batch, args.crop)
        pixels, targets = batch_at(self.chunks, self.step, args.seed, batch, crop)
        images = normalise(pixels, self.config.mean, self.config.std).to(self.device, memory_format=torch.channels_last)
        targets = [{k: v.to(self.device) for k, v in t.items()} for t in targets]
        for group in self.optimizer.param_groups:
            group["lr"] = self.rate()
        # The choice of anchors and proposals draws from torch's generator.
        torch.manual_seed(args.seed * 1_000_003 + self.step)
        losses = detection_losses(self.model, images, targets)
        self.optimizer.zero_grad()
        sum(losses.values()).backward()
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), 10.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.step += 1
        self.seen += batch
        if self.step % EMA_EVERY == 0:
            keep = min(EMA_DECAY, self.step / (self.step + 50)) ** EMA_EVERY
            average, now = self.ema.state_dict(), self.model.state_dict()
            floats = [k for k in now if now[k].is_floating_point()]
            torch._foreach_lerp_([average[k] for k in floats], [now[k] for k in floats], 1 - keep)
        return {**{k: v.item() for k, v in losses.items()}, "norm": norm.item()}

    @torch.no_grad()
    def recompute_statistics(self, pictures: int) -> None:
        """The averaged weights' batch norm statistics, from whole pictures without augmentation."""
        norms = [m for m in self.ema.modules() if isinstance(m, nn.BatchNorm2d)]
        for m in norms:
            m.reset_running_stats()
            m.momentum = None  # a plain average
        self.ema.train()
        rng = np.random.default_rng(self.args.seed)
        every = np.concatenate([np.stack([np.full(len(c), i), np.arange(len(c))], 1) for i, c in enumerate(self.chunks)])
        for part in np.array_split(rng.permutation(every)[:pictures], max(1, min(pictures, len(every)) // 8)):
            pixels = torch.stack([torch.from_numpy(self.chunks[i].pictures[j]).permute(2, 0, 1).float() for i, j in part])
            images = normalise(pixels, self.config.mean, self.config.std).to(self.device, memory_format=torch.channels_last)
            self.ema.features(images, {})
        self.ema.eval()

    def validate(self, limit: int | None) -> None:
        self.ema.eval()
        row = figures(*detect_folder(self.ema, self.args.val, limit, self.device), self.config.mm_per_pixel, 0.5)
        text = ", ".join(
            f"{k}: IoU {r['iou']:.4f} AP50 {r['ap50']:.4f} AP50:95 {r['ap50_95']:.4f} centre {r['centre_median_mm']:.3f} mm"
            for k, r in row.items()
        )
        self.log(f"val step {self.step}: {text}, false {row['all']['false_per_picture']:.2f} a picture")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", required=True, help="COCO folders or globs; new matches are taken up as they appear")
    parser.add_argument("--val", type=Path, help="COCO folder that chooses nothing but is reported")
    parser.add_argument("--val-pictures", type=int, default=100)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--init", type=Path, help="weight file to start from, with its configuration; by default from scratch")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, help="length of the whole run, earlier calls included")
    parser.add_argument("--crop-steps", type=int, help="steps on crops; by default set from --minutes")
    parser.add_argument("--full-steps", type=int, help="steps on whole pictures; by default set from --minutes")
    parser.add_argument("--plan", type=Path, help="plan.json of an earlier run, to repeat it")
    parser.add_argument("--size", type=int, default=320)
    parser.add_argument("--crop", type=int, default=160)
    parser.add_argument("--batch", type=int, default=12)
    parser.add_argument("--full-batch", type=int, default=8)
    parser.add_argument("--lr", type=float, default=5e-4)
    parser.add_argument("--weight-decay", type=float, default=0.02)
    parser.add_argument("--checkpoint-minutes", type=float, default=4)
    parser.add_argument("--val-minutes", type=float, default=8)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--no-safe", action="store_true", help="ablation: no attention in the backbone")
    parser.add_argument("--no-msff", action="store_true", help="ablation: conv4_x alone")
    parser.add_argument("--no-rw", action="store_true", help="ablation: concatenation in place of the weights")
    args = parser.parse_args()
    by_minutes = args.plan is None and args.full_steps is None
    if args.minutes is None and (by_minutes or args.plan is None and args.crop_steps is None):
        parser.error("give --minutes, or --plan, or both --crop-steps and --full-steps")
    if args.init and (args.no_safe or args.no_msff or args.no_rw):
        parser.error("--init brings its own variant")
    args.cache = args.cache or args.out / "cache"
    args.out.mkdir(parents=True, exist_ok=True)
    keep_memory()
    torch.set_num_threads(args.threads)

    run = Run(args)
    run.log(f"step {run.step}, {sum(p.numel() for p in run.model.parameters()) / 1e6:.1f} M parameters, {run.config.to_dict()}")
    run.model.train()
    saved = validated = run.seconds
    recent: list[dict] = []
    measured, clock = None, time.monotonic()
    while True:
        plan = run.plan
        if plan["crop"] is None and run.seconds > CROP_SHARE * args.minutes * 60:
            plan["crop"] = run.step
            run.log(f"plan: {run.step} steps on crops")
        whole = plan["crop"] is not None and run.step >= plan["crop"]
        if whole and by_minutes:
            # The machine may be shared: look again every hundred steps, and first after twenty.
            measured = measured or (run.step, run.seconds)
            taken = run.step - measured[0]
            if taken >= (100 if plan["full"] else 20):
                each = (run.seconds - measured[1]) / taken
                total = run.step - plan["crop"] + max(1, int((args.minutes * 60 - run.seconds) / each))
                if not plan["full"] or abs(total / run.full_steps() - 1) > 0.03:
                    plan["full"].append([run.step, total])
                    run.log(f"plan: {total} steps on whole pictures at {each:.2f} s a step")
                measured = (run.step, run.seconds)
        if whole and run.full_steps() is not None and run.step >= plan["crop"] + run.full_steps():
            break
        recent.append(run.train_step())
        if run.step % 100 == 0:
            run.find_chunks()
        if run.step % 20 == 0:
            mean = {k: float(np.mean([r[k] for r in recent])) for k in recent[0]}
            text = " ".join(f"{k} {v:.4f}" for k, v in mean.items())
            run.log(f"step {run.step} min {run.seconds / 60:.1f} lr {run.rate():.2e} {text} seen {run.seen}")
            recent = []
        if run.seconds - validated > args.val_minutes * 60 and args.val and (args.val / "annotations.json").exists():
            run.validate(args.val_pictures)
            validated = run.seconds
        now = time.monotonic()
        run.seconds, clock = run.seconds + now - clock, now
        if run.seconds - saved > args.checkpoint_minutes * 60:
            run.save()
            saved = run.seconds
    run.recompute_statistics(400)
    run.save()
    run.log(f"done: step {run.step}, {run.seconds / 60:.1f} min, {run.seen} pictures seen, plan {run.plan}")
    if args.val:
        run.validate(None)


if __name__ == "__main__":
    main()
