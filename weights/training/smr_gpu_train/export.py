"""Writes the weight file from a training checkpoint (its averaged weights)."""

import argparse
import hashlib
import json

import torch

from . import weightfile
from .config import Config
from .errors import Failure
from .fit import parts_of, read_checkpoint
from .learner import measure_statistics
from .model import SmrNet
from .pool import Pool
from .request import Request


def run(args: argparse.Namespace) -> int:
    file = args.run / "checkpoint.pt"
    if not file.is_file():
        raise Failure(f"{args.run}: expected a run with checkpoint.pt, got none")
    state = read_checkpoint(file)
    model = SmrNet(Config.from_dict(json.loads(state["config"]))).to(memory_format=torch.channels_last)
    model.load_state_dict(state["ema"])
    if not state["measured"]:
        # A run that was stopped: its batch norm statistics are those of single steps.
        asked = Request.load(args.run)
        data, _ = asked.pictures()
        parts, keys = parts_of(data, model.config.pixels_per_mm, args.run)
        if keys != state["keys"]:
            raise Failure(f"{args.run}: expected the pictures and labels that the run began with, got others")
        measure_statistics(model, Pool.of(parts, model.config, "cpu"), asked.area, asked.seed, state["step"])
    weightfile.save(model.eval(), args.out)
    digest = hashlib.sha256(args.out.read_bytes()).hexdigest()
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB, sha256 {digest}; step {state['step']}, {state['seen']} views, {state['seconds'] / 60:.1f} min")
    return 0
