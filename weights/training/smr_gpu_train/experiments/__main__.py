"""`python -m smr_gpu_train.experiments`: the paper's experiments from one plan."""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

from ..cli import STOPPED, WHOLE, Parser
from ..errors import Failure, NotInstalled
from .plan import Plan, Run, read

TIMED = 3  # steps


def parser() -> argparse.ArgumentParser:
    top = Parser("smr-gpu-train.experiments", description="The paper's experiments: trains and compares the networks of a plan, on the same pictures.")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in {
        "sets": "simulate the plan's sets of pictures into DATA",
        "run": "train the plan's runs in their order, those that are not complete; Ctrl-C keeps what there is",
        "status": "print which runs are complete, and what is left",
        "evaluate": "find the snaps of the test sets by the complete runs",
        "costs": "time each network through ONNX Runtime on one thread of this CPU",
        "tables": "write OUT/results.json and OUT/tables.md",
        "install": "write OUT/installation.md and its two figures: how often a simulated assembly closes",
        "time": f"time {TIMED} steps of each network",
    }.items():
        command = commands.add_parser(name, help=text)
        command.add_argument("--plan", type=Path, required=True)
        command.add_argument("--only", metavar="ROW", nargs="+", help="these rows alone")
        if name != "status":
            command.add_argument("--data", type=Path, required=True, help="folder of the sets")
        if name != "sets":
            command.add_argument("--out", type=Path, required=True, help="folder of the runs")
        if name == "sets":
            command.add_argument("--smr-gpu", type=Path, required=True, help="the program")
        if name in ("run", "evaluate", "costs"):
            command.add_argument("--yolo", type=Path, help="the `yolo` program of an environment with ultralytics; without it YOLO's runs are left out")
        if name == "install":
            command.add_argument("--detections", type=titled, metavar="NAME=FILE", action="append", default=[], help="what `smr-gpu detect --json` printed of the plan's sets of installation, as a method of this name")
        if name == "tables":
            command.add_argument("--resamples", type=WHOLE, default=1000)
    return top


def titled(text: str) -> tuple[str, Path]:
    name, equals, file = text.partition("=")
    if not (name and equals and file):
        raise argparse.ArgumentTypeError(f"expected NAME=FILE, got {text}")
    return name, Path(file)


def sets(plan: Plan, data: Path, program: Path) -> None:
    for each in plan.sets:
        command = [str(program), "simulate", "--out", str(data / each.name), "--seed", str(each.seed), "--count", str(each.count), *each.options]
        try:
            done = subprocess.run(command, check=False)
        except OSError as error:
            raise Failure(f"--smr-gpu: {program}: {error.strerror}") from None
        if done.returncode:
            raise Failure(f"{' '.join(command)}: exit status {done.returncode}")


def timed(plan: Plan, runs: list[Run], data: Path, out: Path) -> None:
    """Core seconds a step of each network that trains here, and the hours of two cores that its runs would take side by side."""
    import torch

    from .runner import Training, steps

    torch.set_num_threads(plan.threads)
    total = 0.0
    print("| row | widths | core s a step | hours of two cores a run | runs | together |\n|---|---|---|---|---|---|")
    for key in dict.fromkeys((run.row.name, run.network) for run in runs if run.row.model != "yolo"):
        own = [run for run in runs if (run.row.name, run.network) == key]
        training = Training(plan, own[0], data, out)
        training.learner.model.train()
        training.step()
        began = time.process_time()
        for _ in range(TIMED):
            training.step()
        # Steps differ in their number of pixels, by a few per cent: what they cost goes by their number.
        each = (time.process_time() - began) / TIMED
        hours = each * steps(plan) / 3600 / 2
        total += hours * len(own)
        print(f"| {key[0]} | {key[1]} | {each:.2f} | {hours:.2f} | {len(own)} | {hours * len(own):.1f} |", flush=True)
        del training
    print(f"\n{steps(plan)} steps a run; together {total:.1f} h, without YOLO and validation")


def command(argv: list[str] | None) -> int:
    args = parser().parse_args(argv)
    # Threads that wait must sleep, not spin: cores are shared with other work.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", "0")
    plan = read(args.plan)
    if args.only and (strange := [name for name in args.only if name not in plan.rows]):
        raise Failure(f"--only: expected some of {', '.join(plan.rows)}, got {', '.join(strange)}")
    runs = [run for run in plan.runs if not args.only or run.row.name in args.only]
    if args.command == "sets":
        sets(plan, args.data, args.smr_gpu)
        return 0
    from . import runner, tables

    if args.command == "run":
        return 0 if runner.run_all(plan, runs, args.data, args.out, args.yolo) else STOPPED
    if args.command == "status":
        print("\n".join(runner.status(plan, runs, args.out)))
    elif args.command == "time":
        timed(plan, runs, args.data, args.out)
    elif args.command == "evaluate":
        tables.detections(plan, runs, args.data, args.out, args.yolo)
    elif args.command == "costs":
        tables.measure_costs(plan, runs, args.data, args.out, args.yolo)
    elif args.command == "install":
        from . import installation

        installation.write(args, plan)
    else:
        tables.write(args, plan)
    return 0


def main(argv: list[str] | None = None) -> int:
    """The exit status, as that of `smr-gpu-train`."""
    try:
        return command(argv)
    except ModuleNotFoundError as error:
        failure: Failure = NotInstalled(f"{error.name} is not installed: pip install 'weights/training[experiments]'")
    except Failure as error:
        failure = error
    except KeyboardInterrupt:
        print("smr-gpu-train.experiments: stopped", file=sys.stderr)
        return STOPPED
    print(f"smr-gpu-train.experiments: {' '.join(str(failure).split())}", file=sys.stderr)
    return failure.status


if __name__ == "__main__":
    sys.exit(main())
