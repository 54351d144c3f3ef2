"""Figures of detections, and their intervals by bootstrap over pictures and over seeds.

A resample is a weight for each picture: how often it is drawn. All runs on the same pictures get the same ones, so
differences between runs are paired.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torchvision.ops import box_iou

from ..metrics import right

THRESHOLDS = np.linspace(0.5, 0.95, 10)
RECALLS = np.linspace(0, 1, 101)
CONF = 0.5  # least score of a best box, and of a false one
FIGURES = ("iou", "ap50", "ap50_95", "centre_mm")
Rows = dict[str, dict[str, Any]]


class Evidence:
    """What a run's detections on some pictures are worth, picture by picture, as metrics.figures has it."""

    def __init__(self, truths: list[dict], detections: list[dict], classes: Sequence[str]):
        self.pictures, self.classes = len(truths), [*classes]
        self.false = np.zeros(self.pictures)
        # By class: the picture of each snap and its best overlap; of each found snap and its error in mm; of each detection, best first, and at which thresholds it is right.
        self.overlaps = [(np.zeros(0, int), np.zeros(0)) for _ in classes]
        self.errors = [(np.zeros(0, int), np.zeros(0)) for _ in classes]
        self.found = [(np.zeros(0, int), np.zeros((0, len(THRESHOLDS)), bool)) for _ in classes]
        gathered: list[tuple[list, list, list]] = [([], [], []) for _ in classes]
        for i, (t, d) in enumerate(zip(truths, detections, strict=True)):
            sure = d["scores"] >= CONF
            overlap = box_iou(d["boxes"], t["boxes"])
            self.false[i] = int((sure & (overlap.amax(dim=1) < 0.5 if len(t["boxes"]) else sure)).sum())
            hits = np.stack([(right(t, d, each) >= 0).numpy() for each in THRESHOLDS.tolist()], axis=1)
            for label, (snaps, centres, boxes) in enumerate(gathered, start=1):
                given = sure & (d["labels"] == label)
                for j in torch.where(t["labels"] == label)[0]:
                    best, which = overlap[given, j].max(dim=0) if given.any() else (torch.tensor(0.0), None)
                    snaps.append((i, float(best)))
                    if which is not None and best >= 0.5:
                        a, b = d["boxes"][given][which], t["boxes"][j]
                        centres.append((i, float((a[:2] + a[2:] - b[:2] - b[2:]).norm() / 2 * t["mm_per_pixel"])))
                own = (d["labels"] == label).numpy()
                boxes += zip([i] * int(own.sum()), d["scores"].numpy()[own], hits[own])
        for k, (snaps, centres, boxes) in enumerate(gathered):
            self.overlaps[k] = np.array([i for i, _ in snaps], int), np.array([v for _, v in snaps])
            self.errors[k] = np.array([i for i, _ in centres], int), np.array([v for _, v in centres])
            if boxes:
                order = np.argsort([-score for _, score, _ in boxes], kind="stable")
                self.found[k] = np.array([i for i, _, _ in boxes])[order], np.stack([hit for _, _, hit in boxes])[order]

    def _precision(self, k: int, weights: np.ndarray) -> np.ndarray | None:
        """A class's average precision at each threshold, COCO's way; None where it has no snap."""
        positives = weights[self.overlaps[k][0]].sum()
        if not positives:
            return None
        picture, hit = self.found[k]
        w = weights[picture][:, None]
        hits, all_ = np.cumsum(hit * w, axis=0), np.cumsum(w, axis=0)
        precision = np.maximum.accumulate((hits / np.maximum(all_, 1e-9))[::-1], axis=0)[::-1]
        # Beyond the recall that is reached it is 0.
        precision = np.concatenate([precision, np.zeros((1, len(THRESHOLDS)))])
        return np.array([precision[np.searchsorted(hits[:, t] / positives, RECALLS - 1e-12), t].mean() for t in range(len(THRESHOLDS))])

    def figures(self, weights: np.ndarray | None = None) -> Rows:
        """By class and for `all`: FIGURES; for `all` also false boxes in 100 pictures. Shares are 0 to 1, what there is none of is NaN."""
        w = np.ones(self.pictures, int) if weights is None else weights
        rows: Rows = {}
        precision = [self._precision(k, w) for k in range(len(self.classes))]
        for name, members in [*((name, [k]) for k, name in enumerate(self.classes)), ("all", [*range(len(self.classes))])]:
            overlaps = np.concatenate([np.repeat(self.overlaps[k][1], w[self.overlaps[k][0]]) for k in members])
            errors = np.concatenate([np.repeat(self.errors[k][1], w[self.errors[k][0]]) for k in members])
            known = [each for k in members if (each := precision[k]) is not None]
            rows[name] = {
                "iou": overlaps.mean() if len(overlaps) else np.nan,
                "ap50": np.mean([each[0] for each in known]) if known else np.nan,
                "ap50_95": np.mean(known) if known else np.nan,
                "centre_mm": np.median(errors) if len(errors) else np.nan,
            }
        rows["all"]["false_per_100"] = 100 * (self.false * w).sum() / w.sum()
        return rows


def draws(pictures: int, times: int, seed: int = 1) -> np.ndarray:
    """Weights [times, pictures]; the same for the same number of pictures."""
    rng = np.random.default_rng(seed)
    return np.stack([np.bincount(rng.integers(pictures, size=pictures), minlength=pictures) for _ in range(times)])


class Sampled:
    """Figures of one run: as measured, and of each resample."""

    def __init__(self, evidence: Evidence, weights: np.ndarray):
        self.rows = evidence.figures()
        drawn = [evidence.figures(w) for w in weights]
        self.drawn: Rows = {name: {figure: np.array([each[name][figure] for each in drawn]) for figure in row} for name, row in self.rows.items()}


def interval(values: list[float], drawn: list[np.ndarray]) -> list[float]:
    """Mean over seeds, and the middle 95 % of that of resampled pictures and resampled seeds."""
    table = np.stack(drawn)  # [seeds, times]
    rng = np.random.default_rng(2)
    which = rng.integers(len(table), size=table.shape)
    means = np.take_along_axis(table, which, axis=0).mean(axis=0)
    if np.isnan(means).all():
        return [float(np.mean(values)), float("nan"), float("nan")]
    return [float(np.mean(values)), *map(float, np.nanpercentile(means, [2.5, 97.5]))]


def summary(seeds: list[Sampled]) -> Rows:
    """[value, low, high] of each figure."""
    return {name: {figure: interval([each.rows[name][figure] for each in seeds], [each.drawn[name][figure] for each in seeds]) for figure in row} for name, row in seeds[0].rows.items()}


def difference(ours: dict[int, Sampled], full: dict[int, Sampled]) -> Rows | None:
    """[ours - full, low, high] by the seeds that both have."""
    both = [(ours[seed], full[seed]) for seed in ours if seed in full]
    if not both:
        return None
    return {
        name: {figure: interval([a.rows[name][figure] - b.rows[name][figure] for a, b in both], [a.drawn[name][figure] - b.drawn[name][figure] for a, b in both]) for figure in row}
        for name, row in both[0][0].rows.items()
    }
