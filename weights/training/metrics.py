"""Figures of a detector on a COCO folder."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import torch
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from torchvision.ops import box_iou

from data import CLASSES, load_picture, normalise, picture_path, read_coco
from model import SmrNet


@torch.no_grad()
def detect_folder(model: SmrNet, folder: Path, limit: int | None = None, device: str = "cpu") -> tuple[list, list]:
    """Truth and detections of each picture, in picture pixels; detections down to a score of 0.05."""
    config = model.config
    truths, detections = [], []
    for name, found in read_coco(folder)[:limit]:
        pixels, scale, (left, top) = load_picture(picture_path(folder, name), config.input_size)
        image = normalise(pixels, config.mean, config.std)[None].to(device, memory_format=torch.channels_last)
        result = {k: v.cpu() for k, v in model.detect(image)[0].items()}
        result["boxes"] = result["boxes"] * scale + torch.tensor([left, top, left, top])
        detections.append(result)
        boxes = torch.tensor([b for _, b in found], dtype=torch.float32).view(-1, 4)
        boxes[:, 2:] += boxes[:, :2]
        truths.append({"boxes": boxes, "labels": torch.tensor([label for label, _ in found], dtype=torch.long)})
    return truths, detections


def _average_precision(truths: list, detections: list) -> COCOeval:
    """COCO's own evaluation."""
    coco, results = COCO(), []
    annotations = []
    for i, (t, d) in enumerate(zip(truths, detections)):
        for box, label in zip(t["boxes"].tolist(), t["labels"].tolist()):
            w, h = box[2] - box[0], box[3] - box[1]
            annotations.append({"id": len(annotations) + 1, "image_id": i, "category_id": label, "bbox": [*box[:2], w, h], "area": w * h, "iscrowd": 0})
        for box, score, label in zip(d["boxes"].tolist(), d["scores"].tolist(), d["labels"].tolist()):
            results.append({"image_id": i, "category_id": label, "bbox": [*box[:2], box[2] - box[0], box[3] - box[1]], "score": score})
    coco.dataset = {
        "images": [{"id": i} for i in range(len(truths))],
        "categories": [{"id": i, "name": c} for i, c in enumerate(CLASSES, start=1)],
        "annotations": annotations,
    }
    with contextlib.redirect_stdout(io.StringIO()):
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(results) if results else COCO(), "bbox")
        if not results:
            return None
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation


def figures(truths: list, detections: list, mm_per_pixel: float, conf: float) -> dict[str, dict[str, float]]:
    """By class and for both: count, mean best-box IoU (a miss counts 0), AP50, AP50:95, centre error in mm.

    The best box is the one of the truth's class with the highest IoU among those
    with a score of at least `conf`; the centre error is over best boxes with IoU of at least 0.5.
    """
    evaluation = _average_precision(truths, detections)
    rows: dict[str, dict[str, float]] = {}
    gathered: dict[int, tuple[list, list]] = {}
    for label in range(1, len(CLASSES) + 1):
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
            errors += (shift.norm(dim=1) * mm_per_pixel)[best >= 0.5].tolist()
        gathered[label] = overlaps, errors
    false = sum(
        int(((d["scores"] >= conf) & (box_iou(d["boxes"], t["boxes"]).amax(dim=1) < 0.5 if len(t["boxes"]) else d["scores"] >= conf)).sum())
        for t, d in zip(truths, detections)
    )

    def average(values) -> float:
        return float(np.mean(values)) if np.size(values) else float("nan")

    for name, labels in [*((c, [i]) for i, c in enumerate(CLASSES, start=1)), ("all", list(gathered))]:
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
    return rows
