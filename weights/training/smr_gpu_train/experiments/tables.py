"""Detections of complete runs on the test sets, and the tables that they make beside the paper's."""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..data import network_input
from ..files import whole
from ..fit import log
from ..labels import check_labelled, read_folders
from ..parts import content_key
from ..pictures import Entry, entries
from . import cost, score
from .models import SCALE_PER_MM, Fast, Seen, configuration, find, maker, see, truth_of
from .plan import FULL, Plan, Row, Run
from .proposals import searched
from .runner import CLASSES, DIRECTED, Progress, load, rising

SEARCHED = 40  # pictures that selective search is timed on
SIDE = 320  # pixels of the paper's sensor at the scale that the networks learn
# Mean IoU and mAP in percent, where this project knows them; of all other rows it does not have the paper's figures.
PAPER = {(FULL, "A"): (91.78, 99.3), (FULL, "B"): (92.12, 99.4)}
NUMBERS = {("baselines", "A"): "I", ("baselines", "B"): "II", ("ablations", "A"): "IV", ("ablations", "B"): "V"}


def of_set(data: Path, name: str) -> list[Entry]:
    [folder] = read_folders("--data", [data / name], None)
    check_labelled([folder], CLASSES)
    return entries(folder, CLASSES, DIRECTED)


def _numbers(found: dict[str, torch.Tensor]) -> list:
    return [[[round(v, 3) for v in box] for box in found["boxes"].tolist()], [round(v, 6) for v in found["scores"].tolist()], found["labels"].tolist()]


def read_found(where: Path, names: list[str], at: str = "") -> list | None:
    """Boxes, scores and labels of each picture of these sets; None where a run has not looked at all of them."""
    files = [where / f"found-{name}{at}.json" for name in names]
    if not all(file.exists() for file in files):
        return None
    return [one for file in files for one in json.loads(file.read_text(encoding="utf-8"))["found"]]


def _tensors(kept: list) -> dict[str, torch.Tensor]:
    boxes, scores, labels = kept
    return {"boxes": torch.tensor(boxes, dtype=torch.float32).view(-1, 4), "scores": torch.tensor(scores), "labels": torch.tensor(labels, dtype=torch.long)}


def _write(file: Path, content: Any) -> None:
    with whole(file) as part:
        part.write_text(json.dumps(content), encoding="utf-8")


def detections(plan: Plan, runs: list[Run], data: Path, out: Path, program: Path | None) -> None:
    """OUT/RUN/found-SET.json of each complete run and set; what is there of the same pictures stays."""
    runs = [run for run in runs if Progress.load(out / run.name).complete]
    if program is None and (left := [run.name for run in runs if run.row.model == "yolo"]):
        log(f"{', '.join(left)}: left out: --yolo names no program")
        runs = [run for run in runs if run.row.model != "yolo"]
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.backends.cudnn.allow_tf32 = False
    for each in plan.of_use("test", "negative", "installation"):
        pictures = of_set(data, each.name)
        key = content_key(pictures, SCALE_PER_MM, [plan.search])
        regions: list[Tensor] = []  # of the set's pictures, for those that look at some
        for side in [SIDE, *(plan.inputs if each.use == "test" else ())]:
            seen: list[Seen] = []  # one look at the pictures for all runs
            for run in runs:
                file = out / run.name / (f"found-{each.name}.json" if side == SIDE else f"found-{each.name}@{side}.json")
                if side != SIDE and run.row.name != FULL or file.exists() and json.loads(file.read_text())["key"] == key:
                    continue
                if run.row.model == "yolo":
                    from . import yolo

                    assert program is not None
                    found = yolo.find_all(pictures, run, out, program, each.name)
                else:
                    seen = seen or [see(entry, side / SIDE) for entry in pictures]
                    if run.row.model == "fast":
                        regions = regions or searched(pictures, plan.search, out / "cache", plan.searchers).each()
                    found = find(load(run.row, out / run.name, device), seen, device, regions if run.row.model == "fast" else None)
                _write(file, {"key": key, "found": [_numbers(one) for one in found]})
                log(f"{run.name}: {len(pictures)} pictures of {each.name} at {side}")


def measure_costs(plan: Plan, runs: list[Run], data: Path, out: Path, program: Path | None) -> None:
    """OUT/costs/ROW-WIDTHS.json of each network that these runs train; of YOLO's only the trained ones have a file to time."""
    first = of_set(data, plan.of_use("test")[0].name)
    runs = [run for run in runs if run.row.model != "yolo" or Progress.load(out / run.name).complete]
    of_network: dict[str, Run] = {}
    for run in runs:
        of_network.setdefault(f"{run.row.name}-{run.network}", run)
    for key, run in of_network.items():
        file = out / "costs" / f"{key}.json"
        if file.exists():
            continue
        if run.row.model == "yolo" and program is None:
            log(f"{key}: left out: --yolo names no program")
            continue
        file.parent.mkdir(parents=True, exist_ok=True)
        _write(file, costs(plan, run, first, out, program))
        log(f"{key}: {file}")


def costs(plan: Plan, run: Run, pictures: list[Entry], out: Path, program: Path | None) -> dict[str, float | None]:
    """On the first of these pictures, whatever the network has learnt: only non-maximum suppression takes longer where there is more to suppress."""
    first = pictures[0]
    if run.row.model == "yolo":
        from . import yolo

        assert program is not None
        file = yolo.export(run, out, program)
        parameters, adds = cost.of_onnx(file)
        ms = cost.milliseconds(file, lambda session: {session.get_inputs()[0].name: torch.rand(1, 3, SIDE, SIDE).numpy()})
        return {"parameters": parameters, "multiply_adds": adds, "ms": ms, "proposals_ms": None}
    model, regions, taken = maker(run.row)(configuration(run.row, run.network, [0.5] * 3, [0.2] * 3, plan.pose)).eval(), None, None
    parameters = sum(p.numel() for p in model.parameters())
    pixels, (x, y) = network_input(first.pixels(), SCALE_PER_MM * first.mm_per_pixel)
    if isinstance(model, Fast):
        all_ = searched(pictures[:SEARCHED], plan.search, out / "cache", plan.searchers)
        regions, taken = all_.each()[0] * torch.tensor([first.size[1] / x, first.size[0] / y] * 2), 1000 * all_.seconds
    adds = cost.multiply_adds(model, SIDE, SIDE, cost.ROIS if regions is None else len(regions))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "network.onnx"
        inputs = cost.export(model, file, pixels, regions)
        ms = cost.milliseconds(file, lambda session: inputs)
    return {"parameters": parameters, "multiply_adds": adds, "ms": ms, "proposals_ms": taken}


def results(plan: Plan, data: Path, out: Path, times: int) -> dict[str, Any]:
    """All figures with their intervals, as JSON has them."""
    groups: dict[str, list[str]] = {}
    for each in plan.of_use("test", "negative"):
        groups.setdefault(each.group, []).append(each.name)
    members: dict[tuple[str, str], list[Run]] = {}
    for run in plan.runs:
        if Progress.load(out / run.name).complete:
            members.setdefault((run.row.name, run.network), []).append(run)
    answer: dict[str, Any] = {"groups": {}, "costs": {}, "runs": {}}
    for runs in members.values():
        for run in runs:
            now = Progress.load(out / run.name)
            answer["runs"][run.name] = {"hours": now.seconds / 3600, "views": now.views, "rising": rising(now.curve or []), "curve": now.curve}
            file = out / "costs" / f"{run.row.name}-{run.network}.json"
            if file.exists():
                answer["costs"][file.stem] = json.loads(file.read_text())
    for group, names in groups.items():
        truths = [truth_of(entry) for name in names for entry in of_set(data, name)]
        weights = score.draws(len(truths), times)
        for side in [SIDE, *plan.inputs]:
            at = "" if side == SIDE else f"@{side}"
            sampled: dict[tuple[str, str], dict[int, score.Sampled]] = {}
            for key, runs in members.items():
                for run in runs:
                    kept = read_found(out / run.name, names, at)
                    if kept is not None:
                        found = [_tensors(one) for one in kept]
                        sampled.setdefault(key, {})[run.seed] = score.Sampled(score.Evidence(truths, found, CLASSES), weights)
            rows = answer["groups"].setdefault(group + at, {})
            for (row, network), seeds in sampled.items():
                full = sampled.get((FULL, network if plan.rows[row].model == "smr" else "large"))
                beside = None if row == FULL or full is None else score.difference(seeds, full)
                rows[f"{row}-{network}"] = {"row": row, "network": network, "seeds": [*seeds], "figures": score.summary([*seeds.values()]), "difference": beside}
    return answer


def shown(estimate: list[float] | None, factor: float = 100, digits: int = 1, signed: bool = False) -> str:
    """`91.2 [90.1, 92.0]`; a dash for what there is none of."""
    if estimate is None or estimate[0] != estimate[0]:
        return "–"
    sign = "+" if signed else ""
    value, low, high = (f"{v * factor:{sign}.{digits}f}" for v in estimate)
    return f"{value} [{low}, {high}]"


def markdown(plan: Plan, answer: dict[str, Any]) -> str:
    """Tables I, II, IV and V for each group of test sets, what each network costs, and the inputs of other sizes."""
    lines: list[str] = []

    def title(row: Row, entry: dict[str, Any]) -> str:
        mark = any(answer["runs"][f"{row.name}-{entry['network']}-{seed}"]["rising"] for seed in entry["seeds"])
        return row.title + (" †" if mark else "")

    def of_row(rows: dict[str, Any], keep: Any) -> list[tuple[Row, dict[str, Any]]]:
        return [(row, entry) for row in plan.rows.values() if keep(row) for entry in rows.values() if entry["row"] == row.name]

    kinds = {"baselines": lambda row: row.model != "smr" or row.name == FULL, "ablations": lambda row: row.model == "smr"}
    plain = {group: rows for group, rows in answer["groups"].items() if "@" not in group}
    negative = {each.group for each in plan.of_use("negative")}
    for group, rows in plain.items():
        if group in negative:
            continue
        for kind, keep in kinds.items():
            for name in CLASSES:
                lines += [f"## Table {NUMBERS[kind, name]}: {kind}, {name}, {group}", ""]
                lines += ["| | widths | seeds | IoU, % | AP50, % | AP50:95, % | centre, mm | IoU beside the full network, points | AP50:95 beside it | the paper's IoU | its mAP |", "|---|---|---|---|---|---|---|---|---|---|---|"]
                for row, entry in of_row(rows, keep):
                    if kind == "baselines" and row.model == "smr" and entry["network"] != "large":
                        continue
                    own, beside = entry["figures"][name], (entry["difference"] or {}).get(name, {})
                    paper = [f"{v:g}" for v in PAPER.get((row.name, name), ()) if entry["network"] != "small"] or ["–", "–"]
                    cells = [title(row, entry), entry["network"], str(len(entry["seeds"])), *(shown(own[f]) for f in ("iou", "ap50", "ap50_95")), shown(own["centre_mm"], 1, 3)]
                    cells += [shown(beside.get("iou"), signed=True), shown(beside.get("ap50_95"), signed=True), *paper]
                    lines.append(f"| {' | '.join(cells)} |")
                lines.append("")
    lines += ["## What each costs", "", "| | widths | parameters, M | multiply-adds, G | ONNX Runtime, ms | proposals, ms | training, h a run | false boxes in 100 look-alikes |", "|---|---|---|---|---|---|---|---|"]
    bare = [rows for group, rows in plain.items() if group in negative]
    first: dict[str, Any] = next((rows for group, rows in plain.items() if group not in negative), {})
    for row, entry in of_row(first, lambda row: True):
        key = f"{row.name}-{entry['network']}"
        paid = answer["costs"].get(key, {})
        hours = [answer["runs"][f"{key}-{seed}"]["hours"] for seed in entry["seeds"]]
        numbers = [f"{paid[name] / unit:.{digits}f}" if paid.get(name) is not None else "–" for name, unit, digits in (("parameters", 1e6, 2), ("multiply_adds", 1e9, 2), ("ms", 1, 0), ("proposals_ms", 1, 0))]
        false = [shown(rows[key]["figures"]["all"]["false_per_100"], 1) for rows in bare if key in rows] or ["–"]
        lines.append(f"| {title(row, entry)} | {entry['network']} | {' | '.join(numbers)} | {sum(hours) / len(hours):.2f} | {', '.join(false)} |")
    sizes = {group: rows for group, rows in answer["groups"].items() if "@" in group and rows}
    if sizes:
        lines += ["", "## Other sizes of input, not trained for", "", "| pictures | widths | IoU, % | AP50, % | AP50:95, % | centre, mm |", "|---|---|---|---|---|---|"]
        for group, rows in sizes.items():
            for entry in rows.values():
                own = entry["figures"]["all"]
                lines.append(f"| {group.replace('@', ' at ')} | {entry['network']} | {' | '.join(shown(own[f]) for f in ('iou', 'ap50', 'ap50_95'))} | {shown(own['centre_mm'], 1, 3)} |")
    lines += ["", "In brackets the interval in which 95 % of the figures fall when pictures and seeds are drawn anew; of a single seed it knows of the pictures alone. A difference is on the same pictures and seeds. † still rising: one of its runs at least gained more than a point of AP50:95 in its last third, so the figures say nothing of a longer one. –: not measured, or a figure of the paper's that this project does not have.", ""]
    return "\n".join(lines)


def timed(plan: Plan, answer: dict[str, Any]) -> dict[str, tuple[float, list[float], list[float]]]:
    """Each network's milliseconds, those of its proposals included, with its mean IoU and centre error on the first group of test sets."""
    first = plan.of_use("test")[0].group
    rows = {}
    for key, entry in answer["groups"][first].items():
        paid = answer["costs"].get(key)
        if paid and paid.get("ms") is not None:
            figures = entry["figures"]["all"]
            rows[plan.rows[entry["row"]].titled(entry["network"])] = (paid["ms"] + (paid.get("proposals_ms") or 0), figures["iou"], figures["centre_mm"])
    return rows


def write(args: argparse.Namespace, plan: Plan) -> None:
    from . import charts

    answer = results(plan, args.data, args.out, args.resamples)
    _write(args.out / "results.json", answer)
    charts.error_against_time(timed(plan, answer), args.out / "error-against-time.png")
    with whole(args.out / "tables.md") as part:
        part.write_text(markdown(plan, answer), encoding="utf-8")
    print(f"{args.out / 'results.json'}, tables.md, error-against-time.png: {len(answer['runs'])} of {len(plan.runs)} runs")
