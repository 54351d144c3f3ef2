"""A network that learns: its running average, its optimiser, its rate, its batch norm, its checkpoint."""

import json
import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from .config import Config
from .data import normalise
from .errors import Failure
from .model import SmrNet
from .pool import Pool

WARMUP = 200  # steps, at most
EMA_EVERY, EMA_DECAY = 4, 0.998
STATISTICS_BATCHES = 100  # at most: a run of fewer steps has as many as steps


def rate(highest: float, step: int, steps: int) -> float:
    """Warms up, for at most a fifth of the run, then falls to zero along a half cosine."""
    return highest * min(1.0, (step + 1) / max(1, min(WARMUP, steps // 5))) * 0.5 * (1 + math.cos(math.pi * min(1.0, step / steps)))


def norms(model: nn.Module) -> list[nn.BatchNorm2d]:
    return [m for m in model.modules() if isinstance(m, nn.BatchNorm2d)]


def network_views(pixels: Tensor, config: Config, device: str) -> Tensor:
    """A batch of a pool as the network reads it."""
    return normalise(pixels, config.mean, config.std).to(device, memory_format=torch.channels_last)


@torch.no_grad()
def measure_statistics(model: SmrNet, pool: Pool, area: int, seed: int, steps: int = STATISTICS_BATCHES) -> None:
    """Batch norm statistics from batches such as training has, none of which a run sees; the network is left in training mode.

    Pictures one by one would leave out how they differ from each other, and give each layer an input
    that the layers before had normalised by that picture alone."""
    for m in norms(model):
        m.reset_running_stats()
        m.momentum = None  # a plain average
    model.train()
    device = str(next(model.parameters()).device)
    for i in range(max(1, min(STATISTICS_BATCHES, steps))):
        pixels, _ = pool.batch(10**6 + i, area, seed)
        model.features(network_views(pixels, model.config, device), {})


class Learner:
    """A network, its running average and its optimiser."""

    def __init__(self, config: Config, device: str, weight_decay: float, make: Callable[[Config], SmrNet] = SmrNet):
        self.config = config
        self.model = make(config).to(device).to(memory_format=torch.channels_last)
        self.ema = make(config).to(device).to(memory_format=torch.channels_last).eval()
        self.ema.load_state_dict(self.model.state_dict())
        parameters = [*self.model.parameters()]
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
        setattr(self.optimizer, "found_inf", (~torch.isfinite(norm)).float())
        setattr(self.optimizer, "grad_scale", None)
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

    def state(self) -> dict[str, Any]:
        return {"config": json.dumps(self.config.to_dict()), "model": self.model.state_dict(), "ema": self.ema.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        self.model.load_state_dict(state["model"])
        self.ema.load_state_dict(state["ema"])
        self.optimizer.load_state_dict(state["optimizer"])

    @torch.no_grad()
    def begin_with(self, init: SmrNet) -> list[str]:
        """The weights of another network of this shape; of the heads those of the classes that both have, and of pose if it has it.

        Returns the classes that begin anew.
        """
        state, given = self.model.state_dict(), init.state_dict()
        had = {name.lower(): i for i, name in enumerate(init.config.classes, start=1)}
        # Of each row of ours the other's, the background first; -1 begins anew.
        source = [0, *(had.get(name.lower(), -1) for name in self.config.classes)]
        for name, tensor in given.items():
            rows = {"roi_head.cls_score": 1, "roi_head.bbox_pred": 4}.get(name.rpartition(".")[0])
            if rows is None:
                if name not in state or state[name].shape != tensor.shape:
                    raise Failure(f"--init: {name}: expected {[*state[name].shape] if name in state else 'no such tensor'}, got {[*tensor.shape]}")
                state[name] = tensor
                continue
            for i, j in enumerate(source):
                if j >= 0:
                    state[name][rows * i : rows * (i + 1)] = tensor[rows * j : rows * (j + 1)]
        self.model.load_state_dict(state)
        self.ema.load_state_dict(self.model.state_dict())
        return [name for name in self.config.classes if name.lower() not in had]
