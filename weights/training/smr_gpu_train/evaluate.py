"""Prints a weight file's figures on COCO folders."""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from . import weightfile
from .config import Config
from .files import whole
from .history import plain
from .labels import check_labelled, read_folders
from .metrics import detect_all, figures
from .pictures import Entry, entries
from .sensor import Sensor
from .split import held_out


def read(option: str, paths: Sequence[Path], config: Config, args: argparse.Namespace, split: Path | None = None) -> dict[Path, list[Entry]]:
    """Each folder's pictures, or what a split holds out of them, labelled with a network's classes; what is left out or assumed is said."""
    folders = read_folders(option, paths, Sensor.open(args.sensor) if args.sensor else None)
    check_labelled(folders, config.classes)
    for folder in folders:
        for remark in folder.remarks:
            print(f"{folder.path}: {remark}")
    if split is not None:
        folders = held_out(option, split, folders)
    return {folder.path: entries(folder, config.classes, config.directed)[: args.limit] for folder in folders}


def run(args: argparse.Namespace) -> int:
    model = weightfile.load(args.weights)
    folders = read("--data", args.data, model.config, args, args.split)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model.to(device)
    result = {}
    for folder, pictures in folders.items():
        start = time.monotonic()
        rows = result[str(folder)] = figures(*detect_all(model, pictures, device), model.config.classes, args.conf)
        print(f"{folder}: {len(pictures)} pictures in {time.monotonic() - start:.0f} s, conf {args.conf}")
        for name, row in rows.items():
            print(f"{name}: " + ", ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
    if args.json:
        with whole(args.json) as part:
            part.write_text(json.dumps(plain(result), indent=1))
    return 0
