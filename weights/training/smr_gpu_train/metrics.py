"""Figures of a detector on a COCO folder."""

import contextlib
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from torchvision.ops import box_iou

from .data import network_input, normalise
from .model import SmrNet
from .pictures import Entry


@torch.no_grad()
def detect_all(model: SmrNet, pictures: Sequence[Entry], device: str = "cpu", scales: int = 3) -> tuple[list, list]:
    """Truth and detections of each picture, in pixels of its gel; detections down to a score of 0.05, from the first `scales`."""
    config = model.config
    truths, detections = [], []
    for entry in pictures:
        pixels, (x, y) = network_input(entry.pixels(), config.pixels_per_mm * entry.mm_per_pixel)
        image = normalise(pixels, config.mean, config.std)[None].to(device, memory_format=torch.channels_last)
        result = {k: v.cpu() for k, v in model.detect(image, scales=scales)[0].items()}
        result["boxes"] = result["boxes"] * torch.tensor([x, y, x, y])
        detections.append(result)
        snaps = {name: torch.from_numpy(getattr(entry.snaps, name)) for name in ("boxes", "labels", "yaw", "whole")}
        truths.append({**snaps, "mm_per_pixel": entry.mm_per_pixel, "conditions": entry.conditions})
    return truths, detections


def right(truth: dict, detection: dict, overlap: float = 0.5) -> torch.Tensor:
    """The truth that each detection [K] finds, -1 for none: right class, IoU of at least `overlap`, the best scores first, each truth once."""
    found = torch.full((len(detection["boxes"]),), -1)
    if not len(truth["boxes"]):
        return found
    iou = box_iou(detection["boxes"], truth["boxes"])
    iou[detection["labels"][:, None] != truth["labels"][None]] = 0
    for i in range(len(found)):  # by descending score
        best, which = iou[i].max(dim=0)
        if best >= overlap:
            found[i] = which
            iou[:, which] = 0
    return found


def calibration_error(scores: np.ndarray, hits: np.ndarray, bins: int = 10) -> float:
    """Expected calibration error: |mean score - share that is right|, averaged over detections in bins of the score."""
    if not len(scores):
        return float("nan")
    which = np.minimum((scores * bins).astype(int), bins - 1)
    parts = [(which == b) for b in range(bins)]
    return float(sum(abs(scores[p].sum() - hits[p].sum()) for p in parts if p.any()) / len(scores))


def _pose(truths: list, detections: list, conf: float) -> dict[str, float]:
    """Of the found whole snaps: yaw's error in degrees, and the share of errors within one stated deviation."""
    yaw: list[float] = []
    within: dict[str, list[bool]] = {"yaw": [], "x": [], "y": []}
    whole: list[bool] = []
    for t, d in zip(truths, detections):
        found = right(t, d)
        for i in torch.where((found >= 0) & (d["scores"] >= conf))[0].tolist():
            j = int(found[i])
            whole.append(bool(d["whole"][i] > 0.5) == bool(t["whole"][j]))
            shift = (d["boxes"][i, :2] + d["boxes"][i, 2:] - t["boxes"][j, :2] - t["boxes"][j, 2:]).abs() / 2 * t["mm_per_pixel"]
            for axis, name in enumerate("xy"):
                within[name].append(bool(shift[axis] <= d["centre_std"][i, axis]))
            if t["whole"][j] and t["yaw"][j].isfinite() and d["yaw"][i].isfinite():
                turn = (float(d["yaw"][i]) - float(t["yaw"][j].rad2deg()) + 180) % 360 - 180
                yaw.append(abs(turn))
                within["yaw"].append(abs(turn) <= float(d["yaw_std"][i]))
    share = {f"within_{k}": float(np.mean(v)) if v else float("nan") for k, v in within.items()}
    middle, high = np.percentile(yaw, [50, 95]) if yaw else (float("nan"), float("nan"))
    return {"yaw_median_deg": float(middle), "yaw_p95_deg": float(high), **share, "whole_right": float(np.mean(whole)) if whole else float("nan")}


def _average_precision(truths: list, detections: list, classes: Sequence[str]) -> COCOeval | None:
    """COCO's own evaluation."""
    coco = COCO()
    results: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for i, (t, d) in enumerate(zip(truths, detections)):
        for box, label in zip(t["boxes"].tolist(), t["labels"].tolist()):
            w, h = box[2] - box[0], box[3] - box[1]
            annotations.append({"id": len(annotations) + 1, "image_id": i, "category_id": label, "bbox": [*box[:2], w, h], "area": w * h, "iscrowd": 0})
        for box, score, label in zip(d["boxes"].tolist(), d["scores"].tolist(), d["labels"].tolist()):
            results.append({"image_id": i, "category_id": label, "bbox": [*box[:2], box[2] - box[0], box[3] - box[1]], "score": score})
    dataset: dict[str, Any] = {
        "images": [{"id": i} for i in range(len(truths))],
        "categories": [{"id": i, "name": c} for i, c in enumerate(classes, start=1)],
        "annotations": annotations,
    }
    coco.dataset = dataset  # type: ignore[assignment]
    with contextlib.redirect_stdout(io.StringIO()):
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(results) if results else COCO(), "bbox")
        if not results:
            return None
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation


def figures(truths: list, detections: list, classes: Sequence[str], conf: float = 0.5) -> dict[str, dict[str, float]]:
    """By class and for all: count, mean best-box IoU (a miss counts 0), AP50, AP50:95, centre error in mm.

    The best box is the one of the truth's class with the highest IoU among those
    with a score of at least `conf`; the centre error is over best boxes with IoU of at least 0.5.
    The row of all has false detections a picture, the calibration error, and the figures of the pose.
    """
    evaluation = _average_precision(truths, detections, classes)
    rows: dict[str, dict[str, float]] = {}
    gathered: dict[int, tuple[list, list]] = {}
    for label in range(1, len(classes) + 1):
        overlaps, errors = [], []
        for t, d in zip(truths, detections):
            wanted = t["boxes"][t["labels"] == label]
            given = d["boxes"][(d["labels"] == label) & (d["scores"] >= conf)]
            if not len(wanted):
                continue
            if not len(given):
                overlaps += [0.0] * len(wanted)
                continue
            best, which = box_iou(wanted, given).max(dim=1)
            overlaps += best.tolist()
            shift = (wanted[:, :2] + wanted[:, 2:] - given[which][:, :2] - given[which][:, 2:]) / 2
            errors += (shift.norm(dim=1) * t["mm_per_pixel"])[best >= 0.5].tolist()
        gathered[label] = overlaps, errors
    false = sum(
        int(((d["scores"] >= conf) & (box_iou(d["boxes"], t["boxes"]).amax(dim=1) < 0.5 if len(t["boxes"]) else d["scores"] >= conf)).sum())
        for t, d in zip(truths, detections)
    )

    def average(values: Any) -> float:
        return float(np.mean(values)) if np.size(values) else float("nan")

    for name, labels in [*((c, [i]) for i, c in enumerate(classes, start=1)), ("all", list(gathered))]:
        overlaps = [v for i in labels for v in gathered[i][0]]
        errors = [v for i in labels for v in gathered[i][1]]
        precision = None
        if evaluation is not None:
            # [IoU threshold, recall, class, area range, most detections]
            precision = evaluation.eval["precision"][:, :, [i - 1 for i in labels if gathered[i][0]], 0, -1]
        rows[name] = {
            "count": len(overlaps),
            "iou": average(overlaps),
            "ap50": average(precision[:1]) if precision is not None else 0.0,
            "ap50_95": average(precision) if precision is not None else 0.0,
            "centre_median_mm": float(np.median(errors)) if errors else float("nan"),
            "centre_p95_mm": float(np.percentile(errors, 95)) if errors else float("nan"),
        }
    rows["all"]["false_per_picture"] = false / max(1, len(truths))
    scores = np.concatenate([d["scores"].numpy() for d in detections])
    hits = np.concatenate([(right(t, d) >= 0).numpy() for t, d in zip(truths, detections)])
    rows["all"]["calibration_error"] = calibration_error(scores, hits)
    if detections and "yaw" in detections[0]:
        rows["all"] |= _pose(truths, detections, conf)
    return rows


def line(rows: dict[str, dict[str, float]]) -> str:
    """`figures` for a log."""
    parts = [
        f"{k}: IoU {100 * r['iou']:.2f} AP50 {100 * r['ap50']:.2f} AP50:95 {100 * r['ap50_95']:.2f} centre {r['centre_median_mm']:.3f} mm"
        for k, r in rows.items()
    ]
    every = rows["all"]
    parts.append(f"false {every['false_per_picture']:.3f} a picture, calibration error {every['calibration_error']:.3f}")
    if "yaw_median_deg" in every:
        within = "/".join(f"{100 * every[f'within_{k}']:.0f}" for k in ("yaw", "x", "y"))
        parts.append(
            f"yaw {every['yaw_median_deg']:.2f} deg, 95th {every['yaw_p95_deg']:.1f}, within one deviation (yaw/x/y) {within} %,"
            f" whole or cut right {100 * every['whole_right']:.1f} %"
        )
    return "; ".join(parts)
