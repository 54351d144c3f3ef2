"""Measures what the tables of the documents show, on this machine, and writes them.

    cargo build --release --bins --examples
    weights/held-out.sh out/held-out && weights/presses.sh out/presses
    python weights/training/other_renderers.py --out out/other --count 100 --seed 2
    python tools/report.py

A table stands between `<!-- report: NAME -->` and `<!-- end -->`; its last line says what it was measured with. What was
measured stays in out/report, by the digests of weights and labels, so that a run that was stopped goes on; `--again`
measures anew. `--only NAME ...` writes these tables alone, `--limit N` looks at the first N pictures of each set,
`--check` writes nothing and fails where a table is another than what would be written.
"""

import argparse
import hashlib
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NETWORKS = {"large": "smrnet.safetensors", "small": "smrnet-s.safetensors"}
LOOKS = {
    "lamps": "three coloured lamps with highlights",
    "lamps-near": "the same on a field of 20 × 15 mm",
    "soft": "the same, soft gel",
    "white": "one white lamp",
    "normals": "a map of the normals",
    "depth": "darker where it is deep and steep",
    "coat": "darker where it is deep",
}
SCENES = {
    "snaps": "snaps and other things",
    "markers": "on printed dots",
    "wall": "hooks from a wall",
    "pairs": "two snaps 0.3 to 1.2 mm apart",
    "small": "snaps of 3.5 to 5 mm",
    "barbs": "hooks with other barbs",
}
# Title, class, set.
HELD_OUT = [
    ("plain", "AB", "plain-{}"),
    ("wide", "AB", "wide-{}"),
    ("markers of 2 mm", "AB", "markers-{}"),
    ("mottle of 5 %", "AB", "mottle-{}"),
    ("shading × 4 with shadows", "AB", "shading-{}"),
    ("exposure × 2.2", "AB", "exposure-{}"),
    ("wall", "A", "wall"),
    ("two slots", "B", "slots"),
    ("hole under 2.5 mm", "B", "hole"),
    ("× 0.75, unstated", "AB", "smaller-{}"),
    ("× 1.25, unstated", "AB", "larger-{}"),
    ("mild", "AB", "mild-{}"),
    ("GelSight Mini", "AB", "mini-{}"),
    ("0.3 to 1.2 mm apart", "AB", "pairs-{}"),
    ("hook beside stud", "AB", "pairs"),
    ("3.5 to 5 mm", "AB", "small-{}"),
    ("other barbs", "A", "barbs"),
    ("darkness is depth", "AB", "dark-{}"),
    ("grey", "A", "grey-a"),
]
LOOK_ALIKES = "block tab ring nut ball screw letters clutter arm prism bracket rib edge pin bare rim-ball rim-dome rim-button rim-rivet rim-torus clip fir-tree company".split()
SIDES = ("right", "below", "left", "above")


def row(cells: Iterable[object]) -> str:
    return "| " + " | ".join(map(str, cells)) + " |"


def table(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    return "\n".join([row(head), "|---|" + "--:|" * (len(head) - 1), *map(row, rows)])


def shown(value: float | None, digits: int, factor: float = 1) -> str:
    return "" if value is None else f"{factor * value:.{digits}f}"


def digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def output(*command: str | Path) -> str:
    ran = subprocess.run(list(map(str, command)), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if ran.returncode:
        sys.exit(f"{' '.join(map(str, command))}: status {ran.returncode}\n{ran.stderr}")
    return ran.stdout


class Laboratory:
    """Runs commands, and keeps what they printed."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.kept: Path = options.keep
        self.kept.mkdir(parents=True, exist_ok=True)
        # Asked once: what is written here makes the tree dirty.
        self.commit = output("git", "describe", "--always", "--dirty", "--abbrev=12").strip()
        # How many pictures of each set the table at work has seen.
        self.seen: set[int] = set()
        # Pictures beside the tables, by their paths.
        self.pictures: dict[str, bytes] = {}

    def weights(self, network: str) -> Path:
        return ROOT / "weights" / NETWORKS[network]

    def run(self, key: Sequence[str], command: Sequence[str | Path]) -> str:
        key = [*key, digest(Path(command[0]))]
        file = self.kept / f"{hashlib.sha256('|'.join(key).encode()).hexdigest()[:24]}.txt"
        if not file.exists() or (self.options.again and file.stat().st_mtime < START):
            print("$", *command, file=sys.stderr)
            text = output(*command)
            part = file.with_suffix(".part")
            part.write_text(text, encoding="utf-8")
            part.replace(file)
        return file.read_text(encoding="utf-8")

    def eval(self, network: str, data: Sequence[Path], *more: str) -> dict:
        """What `eval --json` says of folders, of all together where there are several."""
        limit = ["--limit", str(self.options.limit)] if self.options.limit else []
        key = ["eval", digest(self.weights(network)), *more, *limit, *(digest(folder / "annotations.json") for folder in data)]
        text = self.run(key, [self.options.smr_gpu, "eval", "--json", "--exact", "--device", "cpu", "--weights", self.weights(network), *more, *limit, "--data", *data])
        figures = json.loads(text.splitlines()[-1])
        self.seen.add(figures["pictures"] // len(data))
        return figures

    def held_out(self, network: str, name: str, *more: str) -> dict:
        return self.eval(network, [self.options.held_out / name], *more)

    def provenance(self, name: str) -> str:
        weights = ", ".join(f"{network} `{digest(self.weights(network))[:12]}`" for network in NETWORKS)
        seen = " to ".join(map(str, sorted({min(self.seen), max(self.seen)}))) if self.seen else ""
        some = f"; {seen} pictures a set" if seen else ""
        return f"Weights: {weights}. Commit {self.commit}, {date.today()}, {processor()}{some}: `python tools/report.py --only {name}`"


def processor() -> str:
    """The processor with its cores."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE) if info.exists() else []
    return f"{os.cpu_count()} cores of {names[0] if names else platform.processor()}"


def within(thirds: Sequence[dict]) -> float | None:
    """The share of errors within their stated deviations, of thirds."""
    boxes = sum(third["boxes"] for third in thirds)
    return sum(third["within"] * third["boxes"] for third in thirds) / boxes if boxes else None


def of_class(figures: dict, name: str) -> dict:
    return next(entry for entry in figures["classes"] if entry["class"] == name)


def quality(entry: dict, directed: bool) -> list[str]:
    yaw = shown(entry["yaw_error_deg"]["median"], 1) if directed else ""
    return [shown(entry["mean_best_iou"], 2, 100), shown(entry["ap50"], 2, 100), shown(entry["center_error_mm"]["median"], 3), yaw]


def both(head: Sequence[str]) -> list[str]:
    """A column of each network; the first names it."""
    return [f"{network}: {title}" if at == 0 else title for network in NETWORKS for at, title in enumerate(head)]


def held_out(lab: Laboratory) -> str:
    rows = []
    for title, classes, sets in HELD_OUT:
        more = ["--unstated"] if "unstated" in title else []
        for name in classes:
            entries = [of_class(lab.held_out(network, sets.format(name.lower()), *more), name) for network in NETWORKS]
            rows.append([f"{title}, {name}", *(cell for entry in entries for cell in quality(entry, name == "A"))])
    return table(["", *both(["IoU, %", "AP50, %", "centre, mm", "yaw, °"])], rows)


def look_alikes(lab: Laboratory) -> str:
    rows = []
    for name in LOOK_ALIKES:
        cells = []
        for network in NETWORKS:
            empty = lab.held_out(network, name)["all"]["without_snap"]
            cells.append(shown(empty["false_alarms"] / empty["pictures"], 1, 100))
        rows.append([name, *cells])
    return table(["", *NETWORKS], rows)


def other_renderers(lab: Laboratory) -> str:
    other = lab.options.other
    rows = []
    for scene, title in SCENES.items():
        sets = [other / f"{look}-{scene}" for look in LOOKS]
        figures = [lab.eval(network, sets) for network in NETWORKS]
        for name in "A" if scene in ("wall", "barbs") else "AB":
            entries = [of_class(each, name) for each in figures]
            rows.append([f"{title}, {name}", *(cell for entry in entries for cell in quality(entry, name == "A"))])
    first = table(["", *both(["IoU, %", "AP50, %", "centre, mm", "yaw, °"])], rows)
    rows = []
    for look, title in LOOKS.items():
        cells = []
        for network in NETWORKS:
            found = lab.eval(network, [other / f"{look}-snaps"])["all"]
            empty = lab.eval(network, [other / f"{look}-{scene}" for scene in ("snaps", "none", "round")])["all"]["without_snap"]
            cells += [shown(found["mean_best_iou"], 2, 100), shown(found["ap50"], 2, 100), f"{empty['false_alarms']} in {empty['pictures']}"]
        rows.append([title, *cells])
    return first + "\n\n" + table(["", *both(["IoU, %", "AP50, %", "false boxes in pictures without a snap"])], rows)


def calibration(lab: Laboratory) -> str:
    sets = [lab.options.held_out / f"{kind}-{name}" for kind in ("plain", "wide") for name in "ab"]
    rows = []
    for network in NETWORKS:
        figures = lab.eval(network, sets)
        cells = [shown(within(figures["deviations"][axis]), 0, 100) for axis in ("x_mm", "y_mm", "yaw_deg")]
        rows.append([network, shown(figures["reliability"]["expected_error"], 3), *cells])
    return table(["", "calibration error of scores", "within one deviation: x, %", "y, %", "yaw, %"], rows)


def conditions(lab: Laboratory) -> str:
    """Of hooks and studs, plain and wide together, by what their labels say."""
    sets = [lab.options.held_out / f"{kind}-{name}" for kind in ("plain", "wide") for name in "ab"]
    large, small = (lab.eval(network, sets)["conditions"] for network in NETWORKS)
    rows = []
    for one, other in zip(large, small):
        figures = [each["figures"] for each in (one, other)]
        if figures[0]["snaps"]:
            rows.append([f"{one['condition']}: {one['value']}", figures[0]["snaps"], *(shown(each["mean_best_iou"], 1, 100) for each in figures)])
    return table(["", "snaps", "large: IoU, %", "small"], rows)


def light(lab: Laboratory) -> str:
    rows = []
    for side in SIDES:
        cells = []
        for network in NETWORKS:
            figures = lab.held_out(network, f"light-{side}")
            thirds = figures["deviations"]["x_mm"] + figures["deviations"]["y_mm"]
            cells += [shown(figures["all"]["bias_to_light_mm"], 3), shown(within(thirds), 0, 100)]
        rows.append([side, *cells])
    return table(["light from", *both(["bias towards it, mm", "within one deviation, %"])], rows)


def presses(lab: Laboratory) -> str:
    parts = []
    for network in NETWORKS:
        folders = sorted(lab.options.presses.iterdir())
        key = ["presses", digest(lab.weights(network)), *(digest(folder / "1.50/annotations.json") for folder in folders)]
        text = lab.run(key, [lab.options.smr_gpu.parent / "examples/presses", "--device", "cpu", "--weights", lab.weights(network), *folders])
        parts.append(f"{network}:\n\n" + text.replace(f"{lab.options.presses}/", "").strip())
    return "\n\n".join(parts)


def accuracy(lab: Laboratory) -> str:
    rows = []
    for title, kind in (("the paper's sensor", "plain"), ("any sensor", "wide")):
        for name in "AB":
            for network in NETWORKS:
                entry = of_class(lab.held_out(network, f"{kind}-{name.lower()}"), name)
                low, high = entry["interval_95"]["mean_best_iou"]
                cells = quality(entry, name == "A")
                cells[0] += f" ({100 * low:.1f} to {100 * high:.1f})"
                cells.insert(3, shown(entry["center_error_mm"]["percentile_95"], 3))
                rows.append([f"{name}, {title}, {network}", entry["snaps"], *cells])
    rows += [["A, the paper, on its own pictures", "", "91.78", "99.3", "", "", ""], ["B, the paper, on its own pictures", "", "92.12", "99.4", "", "", ""]]
    return table(["", "snaps", "mean IoU, % (95 %)", "AP50, %", "centre error, median, mm", "95th percentile, mm", "yaw error, median, °"], rows)


def times(lab: Laboratory) -> dict[str, float]:
    """Median milliseconds of a picture on the CPU, networks and ways in turn."""
    samples = sorted((ROOT / "samples").glob("*.png"))
    ways = {f"{network} {way}".strip(): ["--weights", lab.weights(network), *option] for network in NETWORKS for way, option in (("", ["--exact"]), ("default", []))}
    took: dict[str, list[float]] = {way: [] for way in ways}
    key = ["times", *(digest(lab.weights(network)) for network in NETWORKS), processor()]
    for turn in range(5):
        for way, arguments in ways.items():
            text = lab.run([*key, way, str(turn)], [lab.options.smr_gpu, "detect", "--json", "--device", "cpu", "--mm-per-pixel", "0.04", *arguments, *samples, *samples, *samples])
            took[way] += [json.loads(line)["timings_ms"]["total"] for line in text.splitlines()[len(samples):]]
    return {way: statistics.median(each) for way, each in took.items()}


# Stages in their order, by what they are called in the tables.
STAGES = {
    "input": "crop and resize",
    "backbone.conv1": "conv1 with its attention, and pooling",
    "backbone.layer1": "conv2_x",
    "backbone.layer2": "conv3_x",
    "backbone.layer3": "conv4_x",
    "backbone.layer4": "conv5_x",
    "fusion": "fusion of the scales",
    "reweight": "re-weighting of the scales",
    "rpn": "RPN heads",
    "proposals": "proposals: top-k, decoding, NMS",
    "roi_head": "RoI head",
    "detections": "detections: decoding, NMS",
    "check": "looking for values that are not finite",
}
SIZES = (224, 256, 288, 320, 352, 384)


def stages(lab: Laboratory) -> str:
    """The large network on the software GPU: the best time of each stage of nine, and its rounding."""
    picture = ROOT / "samples/mixed.png"
    common = ["--device", "gpu", "--json", "--mm-per-pixel", "0.04", "--weights", lab.weights("large"), picture]
    key = ["stages", digest(lab.weights("large")), processor()]
    best: dict[str, float] = {}
    for turn in range(3):
        for line in lab.run([*key, str(turn)], [lab.options.smr_gpu, "detect", "--exact", *common, picture, picture]).splitlines():
            for stage in json.loads(line)["timings_ms"]["stages"]:
                best[stage["stage"]] = min(best.get(stage["stage"], float("inf")), stage["ms"])
    compared = json.loads(lab.run([*key, "compare"], [lab.options.smr_gpu, "compare", *common]))["stages"]
    drift = {stage["stage"]: stage["drift"] for stage in compared}
    rows = [[title, shown(best[stage], 1), f"{drift[stage]:.1e}" if drift.get(stage) else ""] for stage, title in STAGES.items() if stage in best]
    return table(["stage", "ms", "error"], [*rows, ["all", shown(sum(best[stage] for stage in STAGES if stage in best), 1), ""]])


def sizes(lab: Laboratory) -> str:
    """Input sizes on the CPU, in turn."""
    data = [lab.options.held_out / "plain-a", lab.options.held_out / "plain-b"]
    samples = sorted((ROOT / "samples").glob("*.png"))
    took: dict[tuple[str, int], list[float]] = {(network, size): [] for size in SIZES for network in NETWORKS}
    for turn in range(3):
        for (network, size), each in took.items():
            key = ["size", digest(lab.weights(network)), processor(), str(size), str(turn)]
            text = lab.run(key, [lab.options.smr_gpu, "detect", "--exact", "--json", "--device", "cpu", "--mm-per-pixel", "0.04", "--size", str(size), "--weights", lab.weights(network), *samples, *samples])
            each += [json.loads(line)["timings_ms"]["total"] for line in text.splitlines()[len(samples):]]
    rows = []
    for size in SIZES:
        cells = []
        for network in NETWORKS:
            found = lab.eval(network, data, "--size", str(size))["all"]
            cells += [shown(statistics.median(took[network, size]), 1), shown(found["mean_best_iou"], 1, 100), shown(found["ap50"], 1, 100), shown(found["center_error_mm"]["median"], 3)]
        rows.append([f"{size}, the default" if size == 320 else size, *cells])
    return table(["input, pixels", *both(["ms", "IoU, %", "AP50, %", "centre, mm"])], rows)


def tradeoff(lab: Laboratory) -> str:
    """The plot, and what it recommends."""
    out = lab.kept / "tradeoff"
    limit = str(min(lab.options.limit or 40, 40))
    lab.seen.add(int(limit))
    key = ["tradeoff", *(digest(lab.weights(network)) for network in NETWORKS), processor(), limit]
    text = lab.run(key, [lab.options.smr_gpu, "tradeoff", "--data", lab.options.held_out / "wide-mixed", "--out", out, "--limit", limit])
    lab.pictures["docs/images/tradeoff.png"] = (out / "tradeoff.png").read_bytes()
    return f"![Error against run time: overlap, centres, rounding](../images/tradeoff.png)\n\n{text.strip().splitlines()[-1]}"


def savings(lab: Laboratory) -> str:
    """What each saving costs and gains on the CPU."""
    sets = [lab.options.held_out / name for name in "plain-a plain-b wide-a wide-b wide-mixed bare screw clutter".split()]
    limit = str(min(lab.options.limit or 50, 50))
    lab.seen.add(int(limit))
    ways = [argument for way in ("contact", "proposals", "scales", "default", "all") for argument in ("--way", way)]
    parts = []
    for network in NETWORKS:
        key = ["savings", digest(lab.weights(network)), processor(), limit, *(digest(folder / "annotations.json") for folder in sets)]
        text = lab.run(key, [lab.options.smr_gpu.parent / "examples/savings", "--device", "cpu", "--weights", lab.weights(network), "--limit", limit, *ways, *sets])
        parts.append(f"{network}:\n\n" + "\n\n".join(text.strip().split("\n\n")[:4]).replace(f"{lab.options.held_out}/", ""))
    return "\n\n".join(parts)


def stream(lab: Laboratory) -> str:
    """The frames of one simulated press."""
    out = lab.kept / "press"
    lab.run(["press"], [lab.options.smr_gpu, "simulate", "--out", out, "--count", "500", "--seed", "2006", "--kind", "a", "--press"])
    parts = []
    for network in NETWORKS:
        text = lab.run(["stream", digest(lab.weights(network)), processor()], [lab.options.smr_gpu.parent / "examples/stream", "cpu", lab.weights(network), out])
        parts.append(f"{network}:\n\n{text.strip()}")
    return "\n\n".join(parts)


def real_presses(lab: Laboratory) -> str:
    """The share of the gel that is looked at on real presses, without a frame without contact and with one."""
    folder = ROOT / "tests/data/gelsight_ball_presses"
    sensor = lab.kept / "sensor.json"
    sensor.write_text(json.dumps({"name": "ball presses", "frame": [640, 480], "mm_per_pixel": 0.0295, "reference": str(folder / "background.png")}))
    pictures = sorted(folder.glob("press_*.png"))
    shares = []
    for way, option in (("without", ["--mm-per-pixel", "0.0295"]), ("with", ["--sensor", sensor])):
        key = ["presses of a ball", digest(lab.weights("large")), digest(lab.options.smr_gpu), way]
        text = lab.run(key, [lab.options.smr_gpu, "detect", "--json", "--device", "cpu", "--weights", lab.weights("large"), *option, *pictures])
        found = [json.loads(line) for line in text.splitlines()]
        of = [1.0 if each["regions"] is None else sum(part["width"] * part["height"] for part in each["regions"]) / (640 * 480) for each in found]
        shares.append((of, sum(len(each["detections"]) for each in found)))
    rows = []
    for title, first in (("even, which set the limits", 0), ("odd, which judge", 1)):
        cells = []
        for of, _ in shares:
            mine = of[first::2]
            cells += [sum(share < 1 for share in mine), shown(statistics.median(mine), 2)]
        rows.append([title, *cells])
    first_table = table(["of 24", "without a reference: in parts", "median", "with: in parts", "median"], rows)
    without, with_one = shares[0][0], shares[1][0]
    rows = [[cell for at in range(row, 48, 12) for cell in (f"{at:02}", shown(without[at], 2), shown(with_one[at], 2))] for row in range(12)]
    return f"{first_table}\n\n{table(['press', 'without', 'with'] * 4, rows)}\n\nSnaps found, without and with: {shares[0][1]} and {shares[1][1]}."


def samples(lab: Laboratory) -> str:
    """What the README's first command prints, and the pictures that it shows."""
    command = ["detect", "samples/*.png", "--mm-per-pixel", "0.04"]
    files = [path.relative_to(ROOT) for path in sorted((ROOT / "samples").glob("*.png"))]
    drawn = lab.kept / "drawn"
    program = [lab.options.smr_gpu, "detect", "--device", "cpu", "--weights", lab.weights("large"), "--mm-per-pixel", "0.04"]
    text = output(*program, *files)
    for sample, name, option in (("mixed", "detection", ["--exact"]), ("hooks", "left-out", [])):
        output(*program, f"samples/{sample}.png", *option, "--save", drawn)
        lab.pictures[f"docs/images/{name}.png"] = (drawn / f"{sample}.png").read_bytes()
    return f"```text\n$ smr-gpu {' '.join(command)}\n{text.rstrip()}\n```"


def summary(lab: Laboratory) -> str:
    took, rows = times(lab), []
    for network in NETWORKS:
        a, b = (of_class(lab.held_out(network, f"plain-{name.lower()}"), name) for name in "AB")
        pair = [f"{shown(a[key], 1, 100)} / {shown(b[key], 1, 100)}" for key in ("mean_best_iou", "ap50")]
        centre = " / ".join(shown(each["center_error_mm"]["median"], 3) for each in (a, b))
        rows.append([f"`{network}`: A / B", *pair, centre, shown(a["yaw_error_deg"]["median"], 1), shown(took[network], 0), shown(took[f"{network} default"], 0)])
    rows.append(["the paper, on its own pictures: A / B", "91.8 / 92.1", "99.3 / 99.4", "", "", "", ""])
    return table(["", "mean IoU, %", "AP50, %", "centre, mm", "yaw, °", "whole picture, ms", "where something touches, ms"], rows)


# What writes a table, and the file that it stands in.
TABLES = {
    "samples": (samples, "README.md"),
    "summary": (summary, "README.md"),
    "accuracy": (accuracy, "docs/results/accuracy.md"),
    "held-out": (held_out, "weights/README.md"),
    "look-alikes": (look_alikes, "weights/README.md"),
    "other-renderers": (other_renderers, "weights/README.md"),
    "calibration": (calibration, "weights/README.md"),
    "conditions": (conditions, "weights/README.md"),
    "light": (light, "weights/README.md"),
    "presses": (presses, "weights/README.md"),
    "stages": (stages, "docs/results/run-time.md"),
    "sizes": (sizes, "docs/results/run-time.md"),
    "tradeoff": (tradeoff, "docs/results/run-time.md"),
    "savings": (savings, "docs/results/leaving-out.md"),
    "stream": (stream, "docs/results/leaving-out.md"),
    "real-presses": (real_presses, "docs/results/real-presses.md"),
}
START = time.time()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=[*TABLES])
    parser.add_argument("--smr-gpu", type=Path, default=ROOT / "target/release/smr-gpu")
    for name in ("held-out", "other", "presses"):
        parser.add_argument(f"--{name}", type=Path, default=ROOT / "out" / name)
    parser.add_argument("--keep", type=Path, default=ROOT / "out/report")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    # Commands run in the repository's root.
    for name in ("smr_gpu", "held_out", "other", "presses", "keep"):
        setattr(options, name, getattr(options, name).resolve())
    lab, stale = Laboratory(options), []
    for at, name in enumerate(options.only):
        make, path = TABLES[name]
        file = ROOT / path
        text = file.read_text(encoding="utf-8")
        between = re.compile(rf"(<!-- report: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        there = between.search(text)
        if not there:
            sys.exit(f"{path}: expected <!-- report: {name} --> and <!-- end -->")
        lab.seen.clear()
        body = f"\n{make(lab)}\n\n"
        said = "" if name == "samples" else f"{lab.provenance(name)}\n"
        if not options.check:
            file.write_text(between.sub(lambda found: f"{found[1]}{body}{said}{found[2]}", text), encoding="utf-8")
            for picture, drawn in lab.pictures.items():
                (ROOT / picture).write_bytes(drawn)
        elif body.strip() not in there[0]:
            stale.append(name)
        share = (at + 1) / len(options.only)
        print(f"{name}: done, about {(time.time() - START) * (1 - share) / share / 60:.0f} min left", file=sys.stderr)
    if stale:
        sys.exit(f"other figures than measured: {', '.join(stale)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
