"""Times smr-gpu and other programs that run the same network, in turn, on one picture.

Prints a Markdown table: minimum, median and maximum of the rounds in milliseconds, the ratio of the
medians to the first row of the same part, and the error, the relative L2 distance of the part's maps
from PyTorch's in float64.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from safetensors.numpy import load_file

import networks
from networks import BACKBONE, FEATURES, ROOT

PARTS = {
    "detection": "picture to detections",
    "features": "input to fused map and RPN heads",
    "roi head": "100 pooled regions to scores and boxes",
    "backbone": "input to the maps at strides 8, 16, 32",
}
# Stages of smr-gpu behind the features.
BEHIND = ("proposals", "roi_head", "detections")
REGIONS = 100


@dataclass
class Row:
    part: str
    name: str
    error: float | None = None
    times: list[float] = field(default_factory=list)


class Served:
    """A program that runs once for each line that it reads."""

    def __init__(self, command: list[str | Path]):
        self.process = subprocess.Popen(list(map(str, command)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        try:
            self.ready = json.loads(self.process.stdout.readline())
        except json.JSONDecodeError:
            raise SystemExit(f"{command[0]} ended with {self.process.wait()}")

    def run(self) -> dict:
        print("run", file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline())


def error(got: list[np.ndarray], want: list[np.ndarray]) -> float:
    """Of all maps together."""
    got, want = ([np.asarray(m, np.float64).ravel() for m in maps] for maps in (got, want))
    difference, size = np.concatenate(got) - np.concatenate(want), np.concatenate(want)
    return float(np.linalg.norm(difference) / np.linalg.norm(size))


def timed(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return (time.perf_counter() - start) * 1e3


class Measurement:
    def __init__(self, args: argparse.Namespace):
        self.args = args
        self.rows: list[Row] = []
        # Each runs once and adds a time to its rows.
        self.peers: list[Callable[[], None]] = []
        program = ROOT / "target/release/examples/timed"
        self.timed = lambda device, tensors: Served([program, device, args.weights, args.picture, tensors])
        reference = args.work / "reference.safetensors"
        self.timed("reference", reference).process.kill()
        # All take the same input: the picture, cropped and resized.
        self.x = torch.from_numpy(load_file(reference)["input"])[None].contiguous()
        np.save(args.work / "x.npy", self.x.numpy())
        with torch.no_grad():
            net, stages = networks.load(args.weights, torch.float64), {}
            net.features(self.x.double(), stages)
            stages["rpn.cls"] = net.rpn.cls(stages["fusion.fused"])
            stages["rpn.bbox"] = net.rpn.bbox(stages["fusion.fused"])
        self.want = {n: stages[n][0].numpy() for n in BACKBONE + FEATURES}

    def row(self, part: str, name: str, maps: list | None = None) -> Row:
        names = BACKBONE if part == "backbone" else FEATURES
        off = None if maps is None else error(maps, [self.want[n] for n in names])
        self.rows.append(Row(part, name, off))
        return self.rows[-1]

    def smr_gpu(self, device: str) -> str:
        """Adds a device; returns the adapter's name."""
        file = self.args.work / "tensors.safetensors"
        served = self.timed(device, file)
        maps = load_file(file)
        name = served.ready["adapter"]
        rows = {
            "detection": self.row("detection", f"smr-gpu, {name}"),
            "features": self.row("features", f"smr-gpu, {name}", [maps[n] for n in FEATURES]),
            "roi head": self.row("roi head", f"smr-gpu, {name}"),
            "backbone": self.row("backbone", f"smr-gpu, {name}", [maps[n] for n in BACKBONE]),
        }

        def run() -> None:
            line = served.run()
            rows["detection"].times.append(line["ms"])
            stages = {s["stage"]: s["ms"] for s in line["stages"]}
            for part, belongs in [
                ("features", lambda s: s != "input" and not s.startswith(BEHIND)),
                ("roi head", lambda s: s == "roi_head"),
                ("backbone", lambda s: s.startswith("backbone")),
            ]:
                if stages:
                    rows[part].times.append(sum(ms for s, ms in stages.items() if belongs(s)))

        self.peers.append(run)
        return name

    def pytorch(self, device: str, dtype: torch.dtype) -> None:
        weights, kind = self.args.weights, str(dtype).removeprefix("torch.")
        net = networks.load(weights).to(device, dtype)
        x = self.x.to(device, dtype).to(memory_format=torch.channels_last)
        features, backbone = networks.Features(net), networks.Backbone(net)
        name = f"PyTorch {torch.__version__}, {device}, {kind}"
        name += f", cuDNN {torch.backends.cudnn.version()}" if device == "cuda" else ""
        finish = torch.cuda.synchronize if device == "cuda" else lambda: None
        maps = lambda module: [m[0].float().cpu().numpy() for m in module(x)]  # noqa: E731
        with torch.no_grad():
            rows = [
                (self.row("detection", name), lambda: net.detect(x)),
                (self.row("features", name, maps(features)), lambda: features(x)),
                (self.row("backbone", name, maps(backbone)), lambda: backbone(x)),
            ]

        def run() -> None:
            with torch.no_grad():
                for row, work in rows:
                    row.times.append(timed(lambda: (work(), finish())))

        self.peers.append(run)

    def onnx_runtime(self) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = self.args.threads
        open_ = lambda n: onnxruntime.InferenceSession(self.args.work / f"{n}.onnx", options, providers=["CPUExecutionProvider"])  # noqa: E731
        features, head = open_("features"), open_("roi_head")
        x, name = {"x": self.x.numpy()}, f"ONNX Runtime {onnxruntime.__version__}, CPU"
        rng = np.random.default_rng(1)
        pooled = {"x": rng.standard_normal(head.get_inputs()[0].shape, np.float32)}
        rows = [
            (self.row("features", name, [m[0] for m in features.run(None, x)]), lambda: features.run(None, x)),
            (self.row("roi head", name), lambda: head.run(None, pooled)),
        ]
        self.peers.append(lambda: [row.times.append(timed(work)) for row, work in rows])

    def ncnn(self, adapter: str | None) -> None:
        command = [sys.executable, Path(__file__).with_name("serve_ncnn.py"), self.args.work]
        command += ["--threads", str(self.args.threads)]
        command += [] if adapter is None else ["--adapter", adapter]
        served = Served(command)
        outputs = np.load(self.args.work / f"ncnn-{'cpu' if adapter is None else 'vulkan'}.npz")
        row = self.row("backbone", f"ncnn, {served.ready['adapter']}", list(outputs.values()))
        self.peers.append(lambda: row.times.append(served.run()["ms"]))

    def table(self) -> str:
        lines = ["| part | what runs it | min | median | max | ratio | error |", "|---|---|---|---|---|---|---|"]
        for part, meaning in PARTS.items():
            rows = [row for row in self.rows if row.part == part and row.times]
            for i, row in enumerate(rows):
                low, middle, high = min(row.times), statistics.median(row.times), max(row.times)
                ratio = middle / statistics.median(rows[0].times)
                off = "" if row.error is None else f"{row.error:.1e}"
                label = f"{part}: {meaning}" if i == 0 else ""
                lines.append(f"| {label} | {row.name} | {low:.1f} | {middle:.1f} | {high:.1f} | {ratio:.2f} | {off} |")
        return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="folder for the exported networks")
    parser.add_argument("--weights", type=Path, default=ROOT / "weights/smrnet.safetensors")
    parser.add_argument("--picture", type=Path, default=ROOT / "samples/mixed.png")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="of the programs that run on the CPU")
    parser.add_argument("--device", action="append", help="of smr-gpu; may be repeated [auto and cpu]")
    parser.add_argument("--no-ncnn-vulkan", action="store_true", help="its first run takes a minute on a software adapter")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = False

    measurement = Measurement(args)
    networks.export(args.weights, measurement.x, REGIONS, args.work)
    adapters = [measurement.smr_gpu(device) for device in args.device or ["auto", "cpu"]]
    measurement.pytorch("cpu", torch.float32)
    if torch.cuda.is_available():
        measurement.pytorch("cuda", torch.float32)
        measurement.pytorch("cuda", torch.float16)
    measurement.onnx_runtime()
    measurement.ncnn(None)
    vulkan = next((a.removesuffix(" (vulkan)") for a in adapters if a.endswith(" (vulkan)")), None)
    if vulkan is not None and not args.no_ncnn_vulkan:
        measurement.ncnn(vulkan)

    for done in range(args.rounds + 1):
        for peer in measurement.peers:
            peer()
            # Threads of one program that still wait for work are in the next one's way.
            time.sleep(0.02)
        if done == 0:
            # The first round warms up.
            for row in measurement.rows:
                row.times.clear()
        print(f"\rround {done} of {args.rounds}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(measurement.table())


if __name__ == "__main__":
    main()
