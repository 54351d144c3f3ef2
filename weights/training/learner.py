"""A network that learns: its running average, its optimiser, its rate, its batch norm, its checkpoint."""

import json
import math
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from data import CLASSES, DIRECTED, normalise
from model import Config, SmrNet
from pool import Pool

WARMUP = 200  # steps
EMA_EVERY, EMA_DECAY = 4, 0.998
STATISTICS_BATCHES = 100


def to_learn(config: Config) -> Config:
    """A configuration for training: what the labels have, and no temperature, which fits the weights that it was measured with."""
    return replace(config, classes=[*CLASSES], directed=[*DIRECTED], pose=True, temperature=1.0)


def rate(highest: float, step: int, done: float) -> float:
    """Warms up, then falls to zero along a half cosine; `done` is the share of the run."""
    return highest * min(1.0, (step + 1) / WARMUP) * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


def norms(model: nn.Module) -> list[nn.BatchNorm2d]:
    return [m for m in model.modules() if isinstance(m, nn.BatchNorm2d)]


def network_views(pixels: Tensor, config: Config, device: str) -> Tensor:
    """A batch of a pool as the network reads it."""
    return normalise(pixels, config.mean, config.std).to(device, memory_format=torch.channels_last)


@torch.no_grad()
def measure_statistics(model: SmrNet, pool: Pool, area: int, seed: int) -> None:
    """Batch norm statistics from batches such as training has, none of which a run sees; the network is left in training mode.

    Pictures one by one would leave out how they differ from each other, and give each layer an input
    that the layers before had normalised by that picture alone."""
    for m in norms(model):
        m.reset_running_stats()
        m.momentum = None  # a plain average
    model.train()
    device = str(next(model.parameters()).device)
    for i in range(STATISTICS_BATCHES):
        pixels, _ = pool.batch(10**6 + i, area, seed)
        model.features(network_views(pixels, model.config, device), {})


class Learner:
    """A network, its running average and its optimiser; `extra` is learnt with it and thrown away in the end."""

    def __init__(self, config: Config, device: str, weight_decay: float, extra: nn.Module | None = None):
        self.config, self.extra = config, extra
        self.model = SmrNet(config).to(device, memory_format=torch.channels_last)
        self.ema = SmrNet(config).to(device, memory_format=torch.channels_last).eval()
        self.ema.load_state_dict(self.model.state_dict())
        parameters = [*self.model.parameters(), *(extra.parameters() if extra else [])]
        decay, plain = [p for p in parameters if p.ndim > 1], [p for p in parameters if p.ndim <= 1]
        groups = [{"params": decay, "weight_decay": weight_decay}, {"params": plain, "weight_decay": 0.0}]
        self.optimizer = torch.optim.AdamW(groups, betas=(0.9, 0.99), fused=True)

    def learn(self, loss: Tensor, rate: float) -> Tensor:
        """One step of the optimiser; the gradient's norm. Where that is not finite, nothing is learnt."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.zero_grad()
        loss.backward()
        norm = nn.utils.clip_grad_norm_((p for g in self.optimizer.param_groups for p in g["params"]), 10.0)
        # What torch.amp.GradScaler sets: a fused optimiser then leaves the step out by itself, and no one waits for a card.
        self.optimizer.found_inf, self.optimizer.grad_scale = (~torch.isfinite(norm)).float(), None
        self.optimizer.step()
        return norm.detach()

    @torch.no_grad()
    def average(self, step: int) -> None:
        """After each step; every EMA_EVERY-th counts."""
        if step % EMA_EVERY:
            return
        keep = min(EMA_DECAY, step / (step + 50)) ** EMA_EVERY
        average, now = self.ema.state_dict(), self.model.state_dict()
        floats = [k for k in now if now[k].is_floating_point()]
        torch._foreach_lerp_([average[k] for k in floats], [now[k] for k in floats], 1 - keep)

    def stand(self) -> None:
        """Batch norm stays as it is from now on."""
        for m in norms(self.model):
            m.eval()

    def state(self) -> dict:
        state = {"config": json.dumps(self.config.to_dict()), "model": self.model.state_dict(), "ema": self.ema.state_dict(), "optimizer": self.optimizer.state_dict()}
        return state | ({"distiller": self.extra.state_dict()} if self.extra else {})

    def load(self, state: dict) -> None:
        self.model.load_state_dict(state["model"])
        self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])
        if self.extra:
            self.extra.load_state_dict(state["distiller"])

    def begin_with(self, init: SmrNet, file: Path) -> None:
        """The weights of a file; those of the pose may be missing."""
        missing, unexpected = self.model.load_state_dict(init.state_dict(), strict=False)
        if unexpected or any(not name.startswith("roi_head.pose.") for name in missing):
            raise SystemExit(f"{file}: missing {missing}, unexpected {unexpected}")
        self.ema.load_state_dict(self.model.state_dict())
