"""The experiments at tiny size. `SMR_GPU=smr-gpu python test_experiments.py`, where smr-gpu is the program"""

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from smr_gpu_train import weightfile
from smr_gpu_train.config import NETWORKS, Config, Variant
from smr_gpu_train.errors import Failure
from smr_gpu_train.experiments import __main__ as command
from smr_gpu_train.experiments import cost, models, plan, runner, score, tables, yolo
from smr_gpu_train.experiments.plan import Row, Run, Set
from smr_gpu_train.experiments.proposals import Views, search, searched
from smr_gpu_train.metrics import figures
from smr_gpu_train.model import Cbam, SmrNet
from smr_gpu_train.truth import Truth

SIDE = 200  # pixels of 0.1 mm: inputs of 160 x 160
ROWS = {
    "full": Row("full", "SMR-Net", "smr"),
    "no-safe": Row("no-safe", "without SAFE-Net", "smr", safe=False),
    "no-msff": Row("no-msff", "without MSFF-Net", "smr", msff=False),
    "no-rw": Row("no-rw", "without RW-Net", "smr", rw=False),
    "no-dilation": Row("no-dilation", "without dilation", "smr", dilation=False),
    "every-block": Row("every-block", "every block", "smr", every_block=True),
    "resnet34": Row("resnet34", "Faster R-CNN, ResNet-34", "faster", backbone="resnet34"),
    "vgg16": Row("vgg16", "Faster R-CNN, VGG-16", "faster"),
    "fast": Row("fast", "Fast R-CNN", "fast", backbone="resnet34"),
    "yolo": Row("yolo", "YOLO", "yolo"),
}


def write(folder: Path, count: int, seed: int, snaps: bool = True) -> None:
    """Grey pictures, each with a bright box of A and one of B."""
    rng = np.random.default_rng(seed)
    images, annotations = [], []
    folder.mkdir(parents=True)
    for i in range(count):
        picture = rng.integers(98, 103, (SIDE, SIDE, 3)).astype(np.uint8)
        for category, (w, h) in enumerate(((60, 30), (40, 40)), start=1):
            x, y = rng.integers(5, 90, 2) + ([0, 0], [0, 0], [20, 20])[category]
            if snaps:
                picture[y : y + h, x : x + w] = 200
                annotations.append({"image_id": i, "category_id": category, "bbox": [int(x), int(y), w, h], "yaw_deg": 0 if category == 1 else None, "whole": True})
        Image.fromarray(picture).save(folder / f"{i}.png")
        images.append({"id": i, "file_name": f"{i}.png", "width": SIDE, "height": SIDE, "mm_per_pixel": 0.1})
    categories = [{"id": 1, "name": "A"}, {"id": 2, "name": "B"}]
    (folder / "annotations.json").write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))


def tiny(root: Path, runs: list[Run]) -> plan.Plan:
    uses = {"train": ("train", 6, True), "val": ("val", 2, True), "one": ("test", 3, True), "two": ("test", 2, True), "bare": ("negative", 4, False)}
    for seed, (name, (_, count, snaps)) in enumerate(uses.items()):
        if not (root / name).exists():
            write(root / name, count, seed, snaps)
    sets = [Set(name, use, count, 0, [], "both" if use == "test" else "") for name, (use, count, _) in uses.items()]
    return plan.Plan(15, sets, ROWS, runs, area=30_000, points=3, search="fast", checkpoint_minutes=0, inputs=[128])


def every_network_learns_and_finds(root: Path) -> None:
    images = torch.randn(2, 3, 96, 96)
    truth = Truth(torch.tensor([[[10.0, 20, 50, 40]], [[0, 0, 0, 0]]]), torch.tensor([[1], [0]]), torch.zeros(2, 1), torch.ones(2, 1), torch.zeros(2, 0, 4))
    regions = torch.tensor([[[8.0, 18, 52, 42], [60, 60, 90, 90]]]).expand(2, -1, -1)
    entry = runner.pictures(tiny(root, []), root, "val")[0]
    for row in ROWS.values():
        if row.model == "yolo":
            continue
        torch.manual_seed(1)
        model = models.maker(row)(models.configuration(row, "small", [0.4] * 3, [0.2] * 3, False)).train()
        found = models.losses(model, images, truth, (regions, torch.ones(2, 2, dtype=torch.bool)))
        assert set(found) == {"class", "roi_box"} | (set() if row.model == "fast" else {"objectness", "rpn_box"}), found
        total = torch.stack([*found.values()]).sum()
        total.backward()
        assert total.isfinite() and all(p.grad is not None and p.grad.isfinite().all() for p in model.parameters()), row.name
        seen = models.find(model.eval(), [models.see(entry)], "cpu", [torch.tensor([[0.1, 0.1, 0.5, 0.5]])])[0]
        assert len(seen["boxes"]) == len(seen["scores"]) == len(seen["labels"]) and (seen["boxes"] <= SIDE).all()
    print("ok every network learns and finds")


def switches_do_what_they_say() -> None:
    config = Config(anchor_sizes=[32.0], **NETWORKS["small"])
    torch.manual_seed(1)
    full, plain, more = SmrNet(config), models.Ablated(config, False, False), models.Ablated(config, True, True)
    plain.load_state_dict(full.state_dict())
    image = torch.randn(1, 3, 64, 64)
    stages: list[dict] = [{}, {}]
    full.eval().features(image, stages[0]), plain.eval().features(image, stages[1])
    assert torch.equal(stages[0]["fusion.branch1"], stages[1]["fusion.branch1"])
    for i in (2, 3):
        assert stages[0][f"fusion.branch{i}"].shape == stages[1][f"fusion.branch{i}"].shape
        assert not torch.equal(stages[0][f"fusion.branch{i}"], stages[1][f"fusion.branch{i}"])
    gates = [sum(isinstance(m, Cbam) for m in net.modules()) for net in (full, more)]
    assert gates[1] - gates[0] == sum(config.blocks) - 4, gates
    assert [name for name, row in ROWS.items() if row.in_a_weight_file] == ["full", "no-safe", "no-msff", "no-rw", "resnet34"]
    # Multiply-adds by hand: of ResNet-34's first layer at 320 x 320, and all of a linear layer.
    net = models.maker(ROWS["resnet34"])(models.configuration(ROWS["resnet34"], "own", [0.4] * 3, [0.2] * 3, False))
    net.features = lambda images, stages: net.backbone.conv1(images)
    net.rpn_heads = lambda fused, stages: None
    net.roi_head.fc6 = net.roi_head.fc7 = net.roi_head.bbox_pred = torch.nn.Identity()
    net.roi_head.cls_score = torch.nn.Linear(256 * 49, 3)
    assert cost.multiply_adds(net) == 160 * 160 * 64 * 3 * 49 + 100 * 256 * 49 * 3
    print("ok the switches do what they say")


def regions_go_with_their_views(root: Path) -> None:
    """With the truth for regions each view's regions are its truth, and others come where a crop leaves less."""
    p = tiny(root, [Run(ROWS["full"], "small", 1)])
    pool = runner.Training(p, p.runs[0], root, root / "views").pool
    assert isinstance(pool, Views) and pool.views(0, 30_000, 1)[2] is None
    pool.regions = pool.snaps[..., :4] / pool.sizes.flip(-1).repeat(1, 2)[:, None]
    seen = 0
    for step in range(8):
        _, truth, regions = pool.views(step, 30_000, 1)
        assert regions is not None
        boxes, there = regions
        kept = truth.labels > 0
        assert there[kept].all() and torch.allclose(boxes[kept], truth.boxes[kept], atol=1e-3)
        seen += int(kept.sum())
    assert seen > 20, seen
    # Selective search finds what is plain to see.
    picture = np.full((100, 120, 3), 90, np.uint8)
    picture[20:60, 30:90] = 200
    assert np.abs(search(picture, "fast") - [30, 20, 90, 60]).sum(axis=1).min() <= 4
    noisy = np.random.default_rng(0).integers(80, 140, (100, 120, 3), dtype=np.uint8)
    assert (search(noisy, "fast") == search(noisy, "fast")).all()
    val = runner.pictures(p, root, "val")
    alone, together = (searched(val, "fast", root / f"searched-{workers}", workers).boxes for workers in (1, 2))
    assert torch.equal(alone, together)
    print("ok regions go with their views")


def runs_go_on_to_the_same_weights(root: Path, names: tuple[str, ...] = ("full", "every-block", "fast")) -> None:
    runs = [Run(ROWS[name], "small", 3) for name in names]
    p = tiny(root, runs)
    for run in runs:
        assert runner.run_all(p, [run], root, root / "whole", None)
        out = root / "broken"
        # A killed run: what came after the last checkpoint is lost.
        training = runner.Training(p, run, root, out)
        training.learner.model.train()
        calls = iter([False, False, True])
        assert not training.train(lambda: next(calls))
        assert training.now.step == 2
        training.step()
        # One that is stopped, and its resumption by a new process's means.
        asked = iter([False] * 3 + [True])
        assert not runner.Training(p, run, root, out).train(lambda: next(asked))
        assert runner.Progress.load(out / run.name).step == 5
        assert runner.run_all(p, [run], root, out, None)
        one, other = (torch.load(each / run.name / "model.pt", weights_only=True) for each in (root / "whole", out))
        assert one["config"] == other["config"]
        for name, tensor in one["state"].items():
            assert torch.equal(tensor, other["state"][name]), f"{run.name}: {name}"
        kept = [runner.Progress.load(each / run.name) for each in (root / "whole", out)]
        assert kept[0].curve == kept[1].curve and kept[0].views == kept[1].views and all(each.complete for each in kept)
        assert len(kept[0].curve or []) == 3
        assert (out / run.name / "weights.safetensors").exists() == run.row.in_a_weight_file
        assert not (out / run.name / "checkpoint.pt").exists()
        assert isinstance(runner.load(run.row, out / run.name), SmrNet)
    # A second runner leaves alone what another has.
    with runner.locked(root / "held" / runs[0].name) as ours:
        assert ours and runner.run_all(p, runs[:1], root, root / "held", None)
        assert not (root / "held" / runs[0].name / "progress.json").exists()
    table = runner.status(p, runs, root / "whole")
    assert sum("| complete" in line for line in table) == len(runs) and table[-1].startswith(f"{len(runs)} of {len(runs)} runs complete"), table
    # All that a complete run is judged by.
    tables.detections(p, runs, root, root / "whole", None)
    tables.measure_costs(p, runs, root, root / "whole", None)
    for run in runs:
        assert len(tables.read_found(root / "whole" / run.name, ["one", "two", "bare"])) == 9
        paid = json.loads((root / "whole" / "costs" / f"{run.row.name}-{run.network}.json").read_text())
        assert min(paid["parameters"], paid["multiply_adds"], paid["ms"]) > 0 and (paid["proposals_ms"] is not None) == (run.row.model == "fast")
    assert len(json.loads((root / "whole" / runs[0].name / "found-one@128.json").read_text())["found"]) == 3
    # Other pictures are not taken for the same.
    begun = runner.Training(p, Run(ROWS["full"], "small", 4), root, root / "broken")
    begun.save()
    moved = root / "moved"
    for each in p.sets:
        shutil.copytree(root / each.name, moved / each.name)
    shutil.copy(moved / "train" / "0.png", moved / "train" / "1.png")
    try:
        runner.Training(p, begun.run, moved, root / "broken")
    except Failure as error:
        assert "expected the pictures and steps that the run began with" in str(error)
    else:
        raise AssertionError("a run went on with other pictures")
    print("ok runs go on to the same weights")


def a_still_rising_run_is_marked() -> None:
    curve = [(i, v) for i, v in enumerate((0, 0.2, 0.4, 0.5, 0.6, 0.70, 0.705, 0.706, 0.709))]
    assert not runner.rising(curve)
    assert runner.rising([*curve[:-1], (8, 0.711)])
    assert runner.rising([(1, 0.1), (2, 0.5), (3, 0.52)]) and not runner.rising([(1, 0.1), (2, 0.5), (3, 0.505)])
    print("ok a run that is still rising is marked")


def drawn(seed: int, count: int) -> tuple[list[dict], list[dict]]:
    """Truth and detections of pictures at random: shifted, missed, of the wrong class, of nothing."""
    rng = np.random.default_rng(seed)
    truths, found = [], []
    for _ in range(count):
        boxes = rng.uniform(0, 100, (rng.integers(0, 4), 2)).repeat(2, axis=1).reshape(-1, 2, 2).transpose(0, 2, 1).reshape(-1, 4) + [0, 0, 30, 20]
        labels = rng.integers(1, 3, len(boxes))
        more = np.concatenate([boxes + rng.normal(0, 2, boxes.shape), boxes[:1] + rng.normal(0, 5, (len(boxes[:1]), 4)), rng.uniform(0, 50, (2, 4)) + [0, 0, 60, 60]])
        given = np.concatenate([np.where(rng.random(len(labels)) < 0.8, labels, 3 - labels), labels[:1], [1, 2]])
        scores = np.sort(rng.uniform(0.05, 1, len(more)))[::-1].copy()
        truths.append({"boxes": torch.tensor(boxes).float().view(-1, 4), "labels": torch.tensor(labels), "mm_per_pixel": 0.04})
        found.append({"boxes": torch.tensor(more).float(), "labels": torch.tensor(given), "scores": torch.tensor(scores)})
    return truths, found


def figures_are_those_of_metrics() -> None:
    for seed in range(3):
        truths, found = drawn(seed, 30)
        ours, theirs = score.Evidence(truths, found, ["A", "B"]).figures(), figures(truths, found, ["A", "B"])
        for name, row in ours.items():
            for mine, other in (("iou", "iou"), ("ap50", "ap50"), ("ap50_95", "ap50_95"), ("centre_mm", "centre_median_mm")):
                assert math.isclose(row[mine], theirs[name][other], abs_tol=1e-6), (seed, name, mine, row[mine], theirs[name][other])
        assert math.isclose(ours["all"]["false_per_100"], 100 * theirs["all"]["false_per_picture"])
        # A weight of n is n times the picture.
        weights = score.draws(30, 1, seed)[0]
        again = [i for i, w in enumerate(weights) for _ in range(w)]
        repeated = score.Evidence([truths[i] for i in again], [found[i] for i in again], ["A", "B"]).figures()
        weighted = score.Evidence(truths, found, ["A", "B"]).figures(weights)
        for name, row in weighted.items():
            for figure, value in row.items():
                assert math.isclose(value, repeated[name][figure], abs_tol=1e-9), (name, figure)
    print("ok figures are those of metrics.py, and a weight of two is the picture twice")


def by_hand() -> tuple[list[dict], list[list]]:
    """Two pictures of 0.1 mm: an A that is found to half (4 px aside along x), a B that is missed; an A that is found exactly, and a false B."""
    truth = [([[0, 0, 12, 10], [50, 50, 60, 60]], [1, 2]), ([[0, 0, 10, 10]], [1])]
    truths = [{"boxes": torch.tensor(boxes).float(), "labels": torch.tensor(labels), "mm_per_pixel": 0.1} for boxes, labels in truth]
    return truths, [[[[4, 0, 16, 10]], [0.9], [1]], [[[0, 0, 10, 10], [70, 70, 80, 80]], [0.8, 0.7], [1, 2]]]


def tables_say_what_is_measured(root: Path) -> None:
    """IoU of A (8/16 + 1)/2 = 75 %, of B 0; centre errors 0.4 and 0 mm; AP50 of A 1, AP75 1/2 of the recall at precision 1/2."""
    truths, found = by_hand()
    exact = [[t["boxes"].tolist(), [1.0] * len(t["labels"]), t["labels"].tolist()] for t in truths]
    data, out = root / "data", root / "out"
    for name, shown in (("one", truths), ("bare", [{"boxes": torch.zeros(0, 4), "labels": torch.zeros(0, dtype=torch.long), "mm_per_pixel": 0.1}] * 2)):
        write(data / name, len(shown), 1, False)
        file = data / name / "annotations.json"
        coco = json.loads(file.read_text())
        coco["annotations"] = [{"image_id": i, "category_id": int(label), "bbox": [a, b, c - a, d - b]} for i, t in enumerate(shown) for (a, b, c, d), label in zip(t["boxes"].tolist(), t["labels"])]
        file.write_text(json.dumps(coco))
    runs = [Run(ROWS["full"], "small", seed) for seed in (1, 2)] + [Run(ROWS["no-rw"], "small", 1), Run(ROWS["full"], "large", 1), Run(ROWS["vgg16"], "own", 1), Run(ROWS["yolo"], "own", 1)]
    p = plan.Plan(10, [Set("one", "test", 2, 0, []), Set("bare", "negative", 2, 0, [])], ROWS, runs)
    alone = [[[[0, 0, 9, 9]], [0.9], [1]], [[], [], []]]
    for run in runs[:-1]:
        where = out / run.name
        rising = run.row.name == "vgg16"
        runner.Progress(9, 9, 7200, 9, [(3, 0.5), (6, 0.5), (9, 0.6 if rising else 0.5)], True).save(where)
        # The second seed and the large one are exact.
        of = exact if run.seed == 2 or run.network == "large" else found
        (where / "found-one.json").write_text(json.dumps({"key": "", "found": of}))
        (where / "found-bare.json").write_text(json.dumps({"key": "", "found": alone}))
    (out / "costs").mkdir()
    (out / "costs" / f"{runs[3].row.name}-{runs[3].network}.json").write_text(json.dumps({"parameters": 21_500_000, "multiply_adds": 8_000_000_000, "ms": 151.0, "proposals_ms": None}))
    tables.write(types.SimpleNamespace(data=data, out=out, resamples=20), p)
    answer = json.loads((out / "results.json").read_text())
    rows = answer["groups"]["one"]
    value = lambda row, name, figure: rows[row]["figures"][name][figure][0]  # noqa: E731
    assert math.isclose(value("no-rw-small", "A", "iou"), 0.75) and value("no-rw-small", "B", "iou") == 0
    assert math.isclose(value("no-rw-small", "all", "iou"), 0.5)
    assert math.isclose(value("no-rw-small", "A", "centre_mm"), 0.2, abs_tol=1e-6)
    assert math.isclose(value("no-rw-small", "A", "ap50"), 1)
    # From 0.55 on one of two is right, and the wrong one comes first: precision 1/2 up to a recall of 1/2, 51 of 101 recalls.
    assert math.isclose(value("no-rw-small", "A", "ap50_95"), (1 + 9 * 51 / 101 / 2) / 10)
    assert value("no-rw-small", "B", "ap50") == 0 and math.isclose(value("no-rw-small", "all", "ap50"), 0.5)
    # Of two seeds the mean; the difference is that of the seed that both have, which is none at all.
    assert math.isclose(value("full-small", "A", "iou"), (0.75 + 1) / 2)
    assert rows["no-rw-small"]["difference"]["A"]["iou"] == [0, 0, 0]
    assert math.isclose(rows["vgg16-own"]["difference"]["A"]["iou"][0], -0.25)
    low, high = rows["full-small"]["figures"]["A"]["iou"][1:]
    assert 0.5 <= low < 0.875 < high <= 1, (low, high)
    assert answer["groups"]["bare"]["vgg16-own"]["figures"]["all"]["false_per_100"][0] == 50
    text = (out / "tables.md").read_text()
    line = lambda table, start: next(each for each in text.split(f"## {table}")[1].split("\n## ")[0].splitlines() if each.startswith(start))  # noqa: E731
    assert line("Table I: baselines, A, one", "| SMR-Net | large | 1 | 100.0 [").endswith("| – | – | 91.78 | 99.3 |")
    assert "| -25.0 [" in line("Table I: baselines, A, one", "| Faster R-CNN, VGG-16 † | own | 1 | 75.0 [")
    assert line("Table II: baselines, B, one", "| SMR-Net | large | 1 | 100.0 [").endswith("| 92.12 | 99.4 |")
    assert line("Table IV: ablations, A, one", "| without RW-Net | small | 1 | 75.0 [").endswith("| +0.0 [+0.0, +0.0] | +0.0 [+0.0, +0.0] | – | – |")
    assert line("Table V: ablations, B, one", "| without RW-Net | small | 1 | 0.0 [")
    assert line("What each costs", "| SMR-Net | large").startswith("| SMR-Net | large | 21.50 | 8.00 | 151 | – | 2.00 | 50.0 [")
    assert "YOLO" not in text
    print("ok the tables say what is measured")


YOLO = """#!{python}
import pathlib, sys
given = dict(each.split("=", 1) for each in sys.argv[2:] if "=" in each)
where = pathlib.Path(given["project"]) / given["name"] if "project" in given else None
if sys.argv[2] == "train":
    (where / "weights").mkdir(parents=True)
    (where / "weights" / "last.pt").write_text("")
    rows = [f"{{i}},0.{{i}}" for i in range(1, int(given["epochs"]) + 1)]
    (where / "results.csv").write_text("\\n".join(["epoch, metrics/mAP50-95(B)", *rows]))
else:
    labels = pathlib.Path(given["source"]).parent / "labels"
    (where / "labels").mkdir(parents=True)
    for file in labels.iterdir():
        lines = file.read_text().splitlines()
        (where / "labels" / file.name).write_text("".join(f"{{line}} 0.{{i + 8}}\\n" for i, line in enumerate(lines)))
"""


def yolo_is_called_as_a_program(root: Path) -> None:
    """One that learns nothing and answers with the labels."""
    program = root / "yolo-program"
    program.write_text(YOLO.format(python=sys.executable))
    program.chmod(0o755)
    run = Run(ROWS["yolo"], "own", 1)
    p = replace(tiny(root, [run]), views=18)  # three epochs
    assert runner.run_all(p, [run], root, root / "out", program)
    now = runner.Progress.load(root / "out" / run.name)
    assert (now.complete, now.step, now.steps, now.views, now.curve) == (True, 3, 3, 18, [[1, 0.1], [2, 0.2], [3, 0.3]]), now
    pictures = tables.of_set(root, "one")
    for entry, found in zip(pictures, yolo.find_all(pictures, run, root / "out", program, "one"), strict=True):
        assert found["labels"].tolist() == [2, 1] and np.allclose(found["scores"], [0.9, 0.8])
        assert np.allclose(found["boxes"].flip(0), entry.snaps.boxes, atol=1e-3)
    program.write_text("#!/bin/sh\nexit 3\n")
    try:
        runner.run_all(p, [Run(ROWS["yolo"], "own", 2)], root, root / "out", program)
    except Failure as error:
        assert "exit status 3" in str(error)
    else:
        raise AssertionError("a program that fails was taken for one that ended")
    print("ok YOLO is called as a program")


def weight_files_find_the_same_in_the_program(root: Path) -> None:
    write(root / "set", 1, 1)
    entry = runner.pictures(tiny(root, []), root, "val")[0]
    for row in (row for row in ROWS.values() if row.in_a_weight_file):
        file = root / f"{row.name}.safetensors"
        torch.manual_seed(3)
        model = models.maker(row)(models.configuration(row, "small", [0.4] * 3, [0.2] * 3, False))
        # Untrained heads are sure of nothing: these find something.
        for layer in (model.rpn.cls, model.rpn.bbox, model.roi_head.cls_score, model.roi_head.bbox_pred):
            torch.nn.init.normal_(layer.weight, std=0.5 / layer.weight[0].numel() ** 0.5)
        weightfile.save(model.eval(), file)
        done = subprocess.run([os.environ["SMR_GPU"], "detect", "--exact", "--weights", file, "--json", "--conf", "0.05", "--device", "cpu", "--mm-per-pixel", "0.1", entry.path], capture_output=True, text=True)
        assert done.returncode == 0, (row.name, done.stderr)
        got = json.loads(done.stdout)["detections"]
        want = models.find(weightfile.load(file), [models.see(entry)], "cpu")[0]
        assert len(want["scores"]) and [each["class_index"] + 1 for each in got] == want["labels"].tolist(), (row.name, len(got), len(want["labels"]))
        assert np.allclose([each["score"] for each in got], want["scores"], atol=1e-4), row.name
        assert np.allclose([each["box"] for each in got], want["boxes"], atol=0.02), row.name
    print("ok weight files of ablations and of Faster R-CNN find the same in the program")


def plans_are_read(root: Path) -> None:
    for file in sorted((Path(__file__).parent.parent / "plans").glob("*.json")):
        kept = plan.read(file)
        assert kept.runs[0].row.name == plan.FULL and len({each.seed for each in kept.sets}) == len(kept.sets), file
        assert {each.use for each in kept.sets} == {*plan.USES}
    good = {"views": 1, "sets": [], "rows": {"full": {"title": "x", "model": "smr"}}, "runs": [["full", "small", 1, 2]]}
    file = root / "plan.json"
    file.write_text(json.dumps(good))
    assert [run.name for run in plan.read(file).runs] == ["full-small-1", "full-small-2"]
    for wrong, said in (
        ({"runs": [["ful", "small", 1]]}, "expected one of full, got ful"),
        ({"runs": [["full", "own", 1]]}, "expected one of large, small, got own"),
        ({"runs": [["full", "small", 1, 1]]}, "each run once"),
        ({"rows": {"full": {"title": "x", "model": "cnn"}}}, "expected one of smr, faster, fast, yolo, got cnn"),
        ({"rows": {"full": {"title": "x", "model": "smr", "safety": True}}}, "rows: full: got an unexpected keyword argument 'safety'"),
        ({"vews": 2}, "unexpected keyword argument 'vews'"),
    ):
        file.write_text(json.dumps({**good, **wrong}))
        try:
            plan.read(file)
        except Failure as error:
            assert said in str(error) and str(file) in str(error), error
        else:
            raise AssertionError(f"{wrong} was taken for a plan")
    assert command.main(["status", "--plan", str(root / "none.json"), "--out", str(root)]) == 2
    print("ok plans are read")


if __name__ == "__main__":
    torch.set_num_threads(1)
    switches_do_what_they_say()
    a_still_rising_run_is_marked()
    figures_are_those_of_metrics()
    tests = (plans_are_read, tables_say_what_is_measured, yolo_is_called_as_a_program, regions_go_with_their_views, every_network_learns_and_finds, runs_go_on_to_the_same_weights, weight_files_find_the_same_in_the_program)
    for test in tests:
        with tempfile.TemporaryDirectory() as kept:
            test(Path(kept))
