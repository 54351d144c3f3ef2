"""`smr-gpu-train`: its arguments, and how it ends. What needs no torch is done before that is loaded."""

import argparse
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from . import __version__
from .config import NETWORKS
from .errors import Failure, NotInstalled
from .request import FILE, Request

STOPPED = 130


class Parser(argparse.ArgumentParser):
    """One whose errors are a line."""

    def error(self, message: str) -> NoReturn:
        command = self.prog.partition(" ")[2]
        raise Failure(f"{command}: {message}" if command else f"{message} (--help shows them)")


def _at_least(least: float, kind: Callable[[str], float]) -> Callable[[str], float]:
    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not least <= value < float("inf"):
            raise argparse.ArgumentTypeError(f"expected a {'whole ' if kind is int else ''}number from {least} on, got {text}")
        return value

    return read


def _share(text: str) -> float:
    value = _at_least(0, float)(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"expected a share between 0 and 1, got {text}")
    return value


WHOLE, SOME = _at_least(1, int), _at_least(0, float)


def parser() -> argparse.ArgumentParser:
    top = Parser("smr-gpu-train", description=__doc__.split(":")[0].strip("`") + ": trains the network of smr-gpu on your own pictures.")
    top.add_argument("--version", action="version", version=__version__)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    fit = commands.add_parser("fit", help="train on labelled pictures; ends with OUT/weights.safetensors")
    fit.add_argument("--out", type=Path, required=True, help="folder of the run")
    fit.add_argument("--resume", action="store_true", help="go on with the run in OUT, as it was begun")
    fit.add_argument("--estimate", action="store_true", help="check everything and time a few steps, and train nothing; the last line says it as JSON")
    fit.add_argument("--data", type=str, nargs="+", metavar="DIR", help="COCO folders: annotations.json and pictures")
    fit.add_argument("--mix", type=str, nargs="+", metavar="DIR", default=[], help="further ones, simulated ones, say, whose views are --mix-share of all, however many pictures there are")
    fit.add_argument("--mix-share", type=_share, default=0.5)
    fit.add_argument("--split", type=_share, metavar="SHARE", help="hold out this share of the pictures of --data and evaluate them as --val; OUT/split.json lists them")
    fit.add_argument("--val", type=str, nargs="+", metavar="DIR", default=[], help="COCO folders that are evaluated now and then, and in the end")
    fit.add_argument("--steps", type=WHOLE, help="of the whole run")
    fit.add_argument("--classes", nargs="+", metavar="NAME", help="in this order; by default the labels' categories")
    fit.add_argument("--directed", nargs="*", metavar="NAME", help="classes with a direction; by default those with a yaw_deg in some label")
    fit.add_argument("--sensor", metavar="NAME|FILE", help="which took the pictures whose labels state no scale, as smr-gpu's --sensor")
    fit.add_argument("--init", type=str, metavar="FILE", help="weight file to start from, with its scale, anchors, mean and deviation; classes that it lacks begin anew; by default from scratch")
    scratch = fit.add_argument_group("a run from scratch")
    scratch.add_argument("--network", choices=NETWORKS, default="large")
    scratch.add_argument("--pixels-per-mm", type=_at_least(0.001, float), help="of the network's input (8)")
    scratch.add_argument("--mean", type=SOME, nargs=3, help="of the channels, 0 to 1; by default the pictures'")
    scratch.add_argument("--std", type=_at_least(0.001, float), nargs=3, help="likewise")
    scratch.add_argument("--anchor-sizes", type=_at_least(1, float), nargs="+", help="in input pixels")
    scratch.add_argument("--anchor-ratios", type=_at_least(0.01, float), nargs="+", help="height over width")
    scratch.add_argument("--no-safe", action="store_true", help="ablation: no attention in the backbone")
    scratch.add_argument("--no-msff", action="store_true", help="ablation: conv4_x alone")
    scratch.add_argument("--no-rw", action="store_true", help="ablation: concatenation in place of the weights")
    how = fit.add_argument_group("how it learns")
    how.add_argument("--seed", type=int, default=1)
    how.add_argument("--area", type=WHOLE, default=12 * 192 * 192, help="pixels of a batch")
    how.add_argument("--lr", type=SOME, default=4e-4, help="highest rate")
    how.add_argument("--weight-decay", type=SOME, default=0.02)
    how.add_argument("--threads", type=WHOLE, default=_cores(), help="the bits of the weights depend on it")
    how.add_argument("--keep-statistics", action="store_true", help="batch norm as the --init file has it: a view is then seen as in use, whatever its batch")
    how.add_argument("--checkpoint-minutes", type=SOME, default=4)
    how.add_argument("--val-minutes", type=SOME, default=20)
    how.add_argument("--val-pictures", type=WHOLE, default=60, help="the first of each folder; in the end all")

    evaluate = commands.add_parser("evaluate", help="print a weight file's figures on labelled pictures")
    calibrate = commands.add_parser("calibrate", help="fit scores and stated deviations to labelled pictures that were not trained on")
    for command in (evaluate, calibrate):
        command.add_argument("--weights", type=Path, required=True)
        command.add_argument("--data", type=Path, nargs="+", required=True, metavar="DIR", help="COCO folders")
        command.add_argument("--sensor", metavar="NAME|FILE", help="which took the pictures whose labels state no scale")
        command.add_argument("--split", type=Path, metavar="RUN/split.json", help="only those pictures of --data that this run of fit has held out")
        command.add_argument("--limit", type=WHOLE, help="the first pictures of each folder only")
    evaluate.add_argument("--conf", type=SOME, default=0.5, help="least score of a best box")
    evaluate.add_argument("--json", type=Path, help="write the figures here too")
    calibrate.add_argument("--deviations", type=Path, nargs="+", default=[], metavar="DIR", help="further ones, for the deviations alone")
    calibrate.add_argument("--keep-scores", action="store_true", help="fit the deviations alone")
    calibrate.add_argument("--out", type=Path, required=True, help="weight file to write")

    export = commands.add_parser("export", help="write the weight file of a run as far as it has come")
    export.add_argument("--run", type=Path, required=True, help="folder of a run of fit")
    export.add_argument("--out", type=Path, required=True, help="weight file to write")

    onnx = commands.add_parser("onnx", help="write a weight file's network as ONNX, from pixels to detections")
    onnx.add_argument("--weights", type=Path, required=True)
    onnx.add_argument("--out", type=Path, required=True, help="file to write, NAME.onnx")
    return top


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def request(args: argparse.Namespace, fit: argparse.ArgumentParser) -> Request:
    """What `fit` is asked for: anew, or what the run in --out was begun with."""
    given = {name: value for name, value in vars(args).items() if name not in ("command", "out", "resume", "estimate")}
    if args.resume:
        if args.estimate:
            raise Failure("--estimate is for a new run: leave out --resume")
        more = [f"--{name.replace('_', '-')}" for name, value in given.items() if value != fit.get_default(name)]
        if more:
            raise Failure(f"--resume goes on as the run was begun: leave out {', '.join(more)}")
        return Request.load(args.out)
    if not args.data or not args.steps:
        raise Failure("fit: expected --data and --steps, or --resume")
    if (args.out / FILE).exists():
        raise Failure(f"{args.out} holds a run: give --resume to go on with it")
    if args.mix_share != fit.get_default("mix_share") and not args.mix:
        raise Failure("--mix-share: give --mix, whose share it is")
    brought = ("network", "pixels_per_mm", "mean", "std", "anchor_sizes", "anchor_ratios", "no_safe", "no_msff", "no_rw")
    clash = [f"--{name.replace('_', '-')}" for name in brought if given[name] != fit.get_default(name)]
    if args.init and clash:
        raise Failure(f"--init brings its own configuration: leave out {', '.join(clash)}")
    if args.init and not Path(args.init).is_file():
        raise Failure(f"--init: expected a weight file, got {args.init}, which is not there")
    if args.keep_statistics and not args.init:
        raise Failure("--keep-statistics: give the --init file whose statistics they are")
    return Request(**given)


def command(argv: list[str] | None) -> int:
    top = parser()
    args = top.parse_args(argv)
    # Threads that wait must sleep, not spin: cores are shared with other work.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", "0")
    try:
        if args.command == "fit":
            choices = next(action.choices for action in top._actions if isinstance(action, argparse._SubParsersAction))
            asked = request(args, choices["fit"])
            pictures, val = asked.pictures()
            for line in pictures.summary():
                print(line, flush=True)
            from . import fit

            return (fit.estimate if args.estimate else fit.run)(asked, pictures, val, args.out)
        if args.command == "evaluate":
            from . import evaluate as chosen
        elif args.command == "calibrate":
            from . import calibrate as chosen  # type: ignore[no-redef]
        elif args.command == "onnx":
            from . import onnx as chosen  # type: ignore[no-redef]
        else:
            from . import export as chosen  # type: ignore[no-redef]
        return chosen.run(args)
    except ModuleNotFoundError as error:
        extra = "'weights/training[onnx]'" if error.name == "onnx" else "weights/training"
        raise NotInstalled(f"{error.name} is not installed: pip install {extra} (README.md there says how to get a CPU build of torch)") from None


def main(argv: list[str] | None = None) -> int:
    """The exit status: 0, 1 where something is not installed, 2 for usage and data, 6 for what cannot be written, 130 if stopped."""
    try:
        return command(argv)
    except Failure as failure:
        print(f"smr-gpu-train: {' '.join(str(failure).split())}", file=sys.stderr)
        return failure.status
    except KeyboardInterrupt:
        print("smr-gpu-train: stopped", file=sys.stderr)
        return STOPPED
    except BrokenPipeError:
        # The reader of stdout went away.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
