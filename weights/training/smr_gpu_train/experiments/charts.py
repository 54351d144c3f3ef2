"""The figures of the experiments."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from ..files import whole
from . import installation as model

matplotlib.use("agg")
from matplotlib import pyplot  # noqa: E402

Refused = Mapping[str, tuple[np.ndarray, np.ndarray]]


def _saved(figure: Any, file: Path) -> None:
    with whole(file) as part:
        figure.savefig(part, dpi=110, format="png", metadata={"Software": None})
    pyplot.close(figure)


def clearance(methods: Mapping[str, tuple[np.ndarray, np.ndarray]], file: Path) -> None:
    """Success against clearance, of the trials' kinds and their least plays in mm."""
    at = np.linspace(0, 0.6, 121)
    figure, axes = pyplot.subplots(1, 2, figsize=(11, 4.6), sharey=True, layout="constrained")
    _, low, high = model.exact(*model.PAPER)
    for label, (kind, axis) in enumerate(zip(model.CLASSES, axes), start=1):
        axis.axhspan(100 * low, 100 * high, color="0.9", label="the paper's {} of {}, real: 95 % interval".format(*model.PAPER))
        for i, (name, (kinds, plays)) in enumerate(methods.items()):
            play = plays[kinds == label]
            for taken_up, style in ((model.TAKEN_UP_MM, "-"), (0.0, "--")):
                closed = [100 * np.mean(play <= each + taken_up) if len(play) else np.nan for each in at]
                axis.plot(at, closed, style, color=f"C{i}", label=name if taken_up else None)
        axis.axvline(model.CLEARANCE_MM, color="0.6", linewidth=0.8)
        axis.set(title=f"snap {kind}", xlabel="clearance on each side, mm", ylim=(0, 101), xlim=(0, at[-1]))
    axes[0].set_ylabel("closed, %   (solid: with a lead-in, dashed: without)")
    axes[-1].legend(loc="lower right", fontsize=8)
    _saved(figure, file)


def refusals(methods: Mapping[str, Refused], file: Path) -> None:
    """Success against the share that is refused, by what it is refused."""
    figure, axis = pyplot.subplots(figsize=(6.4, 4.6), layout="constrained")
    for i, (name, orders) in enumerate(methods.items()):
        for by, (share, closed) in orders.items():
            axis.plot(100 * share, 100 * closed, "--" if by == "score" else "-", color=f"C{i}", label=f"{name}, by {by}")
    axis.set(xlabel="refused, %", ylabel=f"closed of the others, %   ({model.CLEARANCE_MM} mm clearance, no lead-in)", xlim=(0, 60), ylim=(0, 101))
    axis.legend(fontsize=8)
    _saved(figure, file)


def error_against_time(rows: Mapping[str, tuple[float, list[float], list[float]]], file: Path) -> None:
    """Of each network its milliseconds a picture, and mean IoU (0 to 1) and median centre error (mm) as [value, low, high]."""
    figure, axes = pyplot.subplots(1, 2, figsize=(13, 4.6), layout="constrained")
    for i, (name, (ms, iou, error)) in enumerate(rows.items()):
        for axis, (value, low, high), factor in ((axes[0], iou, 100), (axes[1], error, 1)):
            span = [[factor * max(0, value - low)], [factor * max(0, high - value)]]
            axis.errorbar(ms, factor * value, yerr=span, fmt="o" if i < 10 else "s", color=f"C{i % 10}", label=name, capsize=2)
    for axis, title in zip(axes, ("mean IoU, %", "median error of the centre, mm")):
        axis.set(xscale="log", xlabel="ms a picture: ONNX Runtime, one thread", ylabel=title)
        axis.grid(color="0.9")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    _saved(figure, file)
