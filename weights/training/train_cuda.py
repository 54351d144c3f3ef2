"""Trains a network for so many seconds on pictures that `render.py` renders meanwhile; made for a CUDA card.

The rate follows the clock: a warm-up, then half a cosine to zero when the time is up. In the last part of the time
batch norm stands still, with statistics measured then, so that a view is seen as in use. Not to be repeated to the
bit: which pictures a step sees depends on how quickly they come. OUT/log tells.
"""

import argparse
import threading
import time
from pathlib import Path
from queue import Queue

import torch

import weightfile
from learner import Learner, measure_statistics, network_views, rate, to_learn
from losses import detection_losses
from parts import Part
from pool import Pool

LOG_EVERY = 50


def incoming(parts: Path) -> Queue:
    """A queue of the parts that lie in a folder, and come to lie there, in the order of their seeds."""
    queue: Queue = Queue(2)

    def watch() -> None:
        seen = set()
        while True:
            for file in sorted(parts.glob("*.npz")):
                if file.name not in seen:
                    seen.add(file.name)
                    queue.put(Part.load(file))
            time.sleep(0.5)

    threading.Thread(target=watch, daemon=True).start()
    return queue


class Training:
    def __init__(self, args: argparse.Namespace):
        self.args, self.began = args, time.monotonic()
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
        init = weightfile.load(args.init)
        config = self.config = to_learn(init.config)
        self.learner = Learner(config, self.device, args.weight_decay)
        self.learner.begin_with(init, args.init)
        self.pool = Pool(config.pixels_per_mm, args.room, self.device)
        self.queue = incoming(args.parts)
        self.step = self.seen = 0
        self.standing = False

    def log(self, text: str) -> None:
        with open(self.args.out / "log", "a") as file:
            file.write(f"{time.monotonic() - self.began:6.1f} {text}\n")

    def done(self) -> float:
        """Share of the time."""
        return (time.monotonic() - self.began) / self.args.seconds

    def take_up(self, least: int) -> None:
        """What has come, and waits until there are so many pictures."""
        while len(self.pool) < least or not self.queue.empty():
            if not self.pool.add(self.queue.get()):
                if len(self.pool) < least:
                    raise SystemExit(f"--room: {self.args.room} pixels are full with {len(self.pool)} pictures, expected room for {least}")
                self.queue = Queue()  # full: what comes is left

    def measure_statistics(self) -> None:
        """Batch norm from now on uses what it is on average over such batches."""
        model, ema = self.learner.model, self.learner.ema
        measure_statistics(model, self.pool, self.args.area, self.args.seed)
        self.stand()
        ema.load_state_dict({k: v for k, v in model.state_dict().items() if "running" in k}, strict=False)

    def stand(self) -> None:
        self.learner.stand()
        self.standing = True

    def train_step(self) -> dict[str, torch.Tensor]:
        pixels, truth = self.pool.batch(self.step, self.args.area, self.args.seed)
        losses, _ = detection_losses(self.learner.model, network_views(pixels, self.config, self.device), truth)
        norm = self.learner.learn(sum(losses.values()), rate(self.args.lr, self.step, self.done()))
        self.step += 1
        self.seen += len(pixels)
        self.learner.average(self.step)
        return {**{k: v.detach() for k, v in losses.items()}, "norm": norm}

    def run(self) -> None:
        self.take_up(self.args.least)
        self.log(f"begins with {len(self.pool)} pictures on {self.device}")
        self.learner.model.train()
        if self.args.standing >= 1:
            self.stand()
        last, recent = time.monotonic(), []
        while self.done() < 1:
            if not self.standing and self.done() > 1 - self.args.standing:
                self.measure_statistics()
                self.log(f"step {self.step}: batch norm stands still")
            recent.append(self.train_step())
            if self.step % LOG_EVERY == 0:
                self.take_up(0)
                mean = {k: float(torch.stack([r[k] for r in recent]).mean()) for k in recent[0]}
                text = " ".join(f"{k} {v:.4f}" for k, v in mean.items())
                now = time.monotonic()
                self.log(f"step {self.step} {1000 * (now - last) / len(recent):.0f} ms pictures {len(self.pool)} seen {self.seen} {text}")
                last, recent = now, []
        if not self.standing:
            self.measure_statistics()
        weightfile.save(self.learner.ema, self.args.out / "weights.safetensors")
        self.log(f"done: step {self.step}, {self.seen} views, {len(self.pool)} pictures")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--parts", type=Path, required=True, help="folder that render.py writes to")
    parser.add_argument("--init", type=Path, required=True, help="weight file to start from")
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--least", type=int, default=1000, help="pictures to begin with")
    parser.add_argument("--room", type=int, default=6 * 10**9, help="for so many pixels, of three bytes each")
    parser.add_argument("--area", type=int, default=96 * 192 * 192, help="pixels of a batch")
    parser.add_argument("--lr", type=float, default=8e-4)
    parser.add_argument("--weight-decay", type=float, default=0.05)
    parser.add_argument("--standing", type=float, default=0.35, help="share of the time in which batch norm stands still; 1 keeps the file's statistics")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    Training(args).run()


if __name__ == "__main__":
    main()
