"""YOLOv8 through the `yolo` program of the ultralytics package, which lies in an environment of its own.

Its licence is the AGPL: none of its code is here. What passes between the two are a command line, pictures, and text:
labels and data.yaml in its format go in; results.csv, predictions in the same format and an ONNX file come out.
"""

import csv
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ..data import network_input
from ..errors import Failure
from ..files import whole
from ..fit import log
from ..parts import content_key
from ..pictures import Entry
from .models import SCALE_PER_MM
from .plan import Plan, Run
from .runner import CLASSES, Progress, pictures

DEVICE = f"device={'0' if torch.cuda.is_available() else 'cpu'}"
SIDE = 320  # a picture of the paper's sensor; smaller ones are padded to it, larger ones the program shrinks


def put(entries: list[Entry], cache: Path) -> tuple[Path, list[tuple[tuple[int, int], tuple[float, float]]]]:
    """Pictures at the network's scale with their labels in a folder of their content; each one's width and height, and gel pixels a pixel along x and y."""
    folder = cache.absolute() / f"yolo-{content_key(entries, SCALE_PER_MM, CLASSES)}"
    (folder / "images").mkdir(parents=True, exist_ok=True)
    (folder / "labels").mkdir(exist_ok=True)

    def one(i: int, entry: Entry) -> tuple[tuple[int, int], tuple[float, float]]:
        pixels, (x, y) = network_input(entry.pixels(), SCALE_PER_MM * entry.mm_per_pixel)
        picture = pixels.round().byte().permute(1, 2, 0).numpy()
        height, width = (max(SIDE, side) for side in picture.shape[:2])
        picture = np.pad(picture, ((0, height - picture.shape[0]), (0, width - picture.shape[1]), (0, 0)), "edge")
        file = folder / "images" / f"{i:06}.png"
        if not file.exists():
            with whole(file) as part:
                Image.fromarray(picture).save(part, "PNG")
        boxes = entry.snaps.boxes / [x, y, x, y]
        lines = [f"{label - 1} {(a + c) / 2 / width:.6f} {(b + d) / 2 / height:.6f} {(c - a) / width:.6f} {(d - b) / height:.6f}" for label, (a, b, c, d) in zip(entry.snaps.labels, boxes)]
        with whole(folder / "labels" / f"{i:06}.txt") as part:
            part.write_text("".join(f"{line}\n" for line in lines))
        return (width, height), (x, y)

    with ThreadPoolExecutor() as pool:
        said = [*pool.map(one, range(len(entries)), entries)]
    return folder, said


def call(program: Path, where: Path, *arguments: str, stopped: Callable[[], bool] = lambda: False) -> bool:
    """Runs the program with its own settings under `where`; False if it was stopped."""
    where.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "YOLO_CONFIG_DIR": str(where), "YOLO_OFFLINE": "true"}
    with open(where / "log.txt", "a") as said, subprocess.Popen([program.absolute(), *arguments], stdout=said, stderr=said, cwd=where, env=environment, start_new_session=True) as process:
        try:
            while process.poll() is None:
                time.sleep(0.2)
                if stopped():
                    return False
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)  # its checkpoint is of the last whole epoch
    if process.returncode:
        raise Failure(f"{program} {arguments[1]}: exit status {process.returncode}: {where / 'log.txt'} says why")
    return True


def train(plan: Plan, run: Run, data: Path, out: Path, program: Path, stopped: Callable[[], bool]) -> bool:
    """From random weights, with the program's own augmentation and optimiser; a run that was stopped goes on with its last whole epoch. Whether it came to the end."""
    where, train_set = (out / run.name).absolute(), pictures(plan, data, "train")
    folder, _ = put(train_set, out / "cache")
    val, _ = put(pictures(plan, data, "val", plan.val_pictures), out / "cache")
    names = "".join(f"  {i}: {name}\n" for i, name in enumerate(CLASSES))
    (where / "data.yaml").write_text(f"train: {folder / 'images'}\nval: {val / 'images'}\nnames:\n{names}")
    epochs = max(1, round(plan.views / len(train_set)))
    now, began = Progress.load(where), time.monotonic()
    now.steps, spent = epochs, now.seconds
    last = where / "train" / "weights" / "last.pt"
    fresh = [f"model=yolov8{run.row.size}.yaml", f"data={where / 'data.yaml'}", f"epochs={epochs}", f"imgsz={SIDE}", f"batch={plan.yolo_batch}", f"seed={run.seed}"]
    fresh += ["pretrained=False", "workers=0", DEVICE, f"project={where}", "name=train", "exist_ok=True", "plots=False", "amp=False", "flipud=0.5"]

    def look() -> None:
        results = where / "train" / "results.csv"
        if results.is_file():
            rows = [{k.strip(): v for k, v in row.items()} for row in csv.DictReader(results.read_text().splitlines())]
            now.curve = [(int(row["epoch"]), float(row["metrics/mAP50-95(B)"])) for row in rows]
            now.step, now.views = len(rows), len(rows) * len(train_set)
        now.seconds = spent + time.monotonic() - began
        now.save(where)

    def halt() -> bool:
        look()
        return stopped()

    log(f"{run.name}: {epochs} epochs of {len(train_set)} pictures by {program}, {where / 'log.txt'} says more")
    look()
    if now.step < epochs and not call(program, where, "detect", "train", *(["resume", f"model={last}"] if last.exists() else fresh), stopped=halt):
        return False
    now.complete = True
    look()
    return True


def find_all(entries: list[Entry], run: Run, out: Path, program: Path, name: str) -> list[dict[str, Tensor]]:
    """Detections of a set's pictures, as models.find gives them."""
    where = (out / run.name).absolute()
    folder, said = put(entries, out / "cache")
    shutil.rmtree(where / f"found-{name}", ignore_errors=True)  # the program adds to what is there
    call(program, where, "detect", "predict", f"model={where / 'train/weights/last.pt'}", f"source={folder / 'images'}", f"imgsz={SIDE}", "conf=0.05", "iou=0.5", "max_det=100", "save=False", "save_txt=True", "save_conf=True", f"project={where}", f"name=found-{name}", "exist_ok=True", DEVICE)
    found = []
    for i, (entry, ((width, height), (x, y))) in enumerate(zip(entries, said)):
        file = where / f"found-{name}" / "labels" / f"{i:06}.txt"
        text = file.read_text() if file.is_file() else ""
        rows = np.array([line.split() for line in text.splitlines()], np.float64).reshape(-1, 6)
        rows = rows[np.argsort(-rows[:, 5], kind="stable")]
        middle, half = rows[:, 1:3], rows[:, 3:5] / 2
        boxes = np.concatenate([middle - half, middle + half], axis=1) * [width * x, height * y, width * x, height * y]
        boxes = boxes.clip(0, [entry.size[1], entry.size[0]] * 2)
        found.append({"boxes": torch.from_numpy(boxes).float(), "scores": torch.from_numpy(rows[:, 5]).float(), "labels": torch.from_numpy(rows[:, 0]).long() + 1})
    return found


def export(run: Run, out: Path, program: Path) -> Path:
    """The ONNX file, with non-maximum suppression left to its user."""
    where = (out / run.name).absolute()
    call(program, where, "export", f"model={where / 'train/weights/last.pt'}", "format=onnx", f"imgsz={SIDE}", "simplify=False")
    return where / "train" / "weights" / "last.onnx"
