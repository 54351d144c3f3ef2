"""Runs the backbone in ncnn whenever a line on stdin asks for it, as tools/timed.rs does.

A process of its own: ncnn's Vulkan and another program's share nothing then.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import ncnn
import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with backbone.ncnn.* and x.npy; gets the outputs")
    parser.add_argument("--adapter", help="part of a Vulkan adapter's name; else the CPU")
    parser.add_argument("--threads", type=int, required=True)
    args = parser.parse_args()
    start = time.perf_counter()
    net, name = ncnn.Net(), "CPU"
    net.opt.num_threads = args.threads
    net.opt.use_vulkan_compute = args.adapter is not None
    for option in ("use_fp16_packed", "use_fp16_storage", "use_fp16_arithmetic", "use_bf16_storage"):
        setattr(net.opt, option, False)
    if args.adapter is not None:
        ncnn.create_gpu_instance()
        names = [ncnn.get_gpu_info(i).device_name() for i in range(ncnn.get_gpu_count())]
        found = [i for i, n in enumerate(names) if args.adapter.lower() in n.lower()]
        if not found:
            sys.exit(f"ncnn: no adapter `{args.adapter}` among {names}")
        net.set_vulkan_device(found[0])
        name = names[found[0]]
    for load, file in [(net.load_param, "backbone.ncnn.param"), (net.load_model, "backbone.ncnn.bin")]:
        if load(str(args.folder / file)) != 0:
            sys.exit(f"ncnn: cannot load {file}")
    x = np.ascontiguousarray(np.load(args.folder / "x.npy")[0])

    def run() -> list[np.ndarray]:
        extractor = net.create_extractor()
        extractor.input(net.input_names()[0], ncnn.Mat(x))
        return [np.array(extractor.extract(name)[1]) for name in net.output_names()]

    outputs = run()
    np.savez(args.folder / f"ncnn-{'cpu' if args.adapter is None else 'vulkan'}.npz", *outputs)
    print(json.dumps({"adapter": name, "ready_ms": (time.perf_counter() - start) * 1e3}), flush=True)
    for _ in sys.stdin:
        start = time.perf_counter()
        run()
        print(json.dumps({"ms": (time.perf_counter() - start) * 1e3}), flush=True)


if __name__ == "__main__":
    main()
