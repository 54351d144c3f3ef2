"""Renders sets of a recipe without end, packed as parts, beside trainings that take them up.

Part k of a seed is always the same: 60 pictures of seed SEED + k under the options of some line of the recipe, whose
lines come as often as their first number says. A third number multiplies the scale that the labels state: nothing at a
wrong scale is a snap. `render.py --recipe recipe.json --simulator smr-gpu --out DIR`
"""

import argparse
import json
import os
import random
import shlex
import subprocess
import tempfile
from multiprocessing import Pool as Processes
from pathlib import Path

import parts

PICTURES = 60


def line_of(recipe: list, seed: int, k: int) -> tuple[str, float]:
    """The options of a part, and by how much its stated scale is wrong."""
    lines = [(options, *times, 1.0)[:2] for _, options, *times in recipe]
    return random.Random(seed + k).choices(lines, [share for share, *_ in recipe])[0]


def misstate(folder: Path, times: float) -> None:
    file = folder / "annotations.json"
    coco = json.loads(file.read_text())
    for image in coco["images"]:
        image["mm_per_pixel"] *= times
    file.write_text(json.dumps(coco))


def render(job: tuple) -> str:
    simulator, out, pixels_per_mm, seed, (options, times) = job
    if (out / f"{seed}.npz").exists():
        return f"{seed} is there"
    with tempfile.TemporaryDirectory(dir=out) as folder:
        command = [simulator, "simulate", "--out", f"{folder}/set", "--seed", str(seed), "--count", str(PICTURES), *shlex.split(options)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "RAYON_NUM_THREADS": "1"})
        if times != 1:
            misstate(Path(folder) / "set", times)
        parts.pack(Path(folder) / "set", pixels_per_mm, seed).save(out / f"{seed}.npz")
    return f"{seed} {options}" + (f", scale times {times}" if times != 1 else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", type=Path, required=True, help="JSON: [[share, options of `smr-gpu simulate`, times], ...], times may be left out")
    parser.add_argument("--simulator", default="smr-gpu")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=100_000)
    parser.add_argument("--parts", type=int, default=100_000)
    parser.add_argument("--pixels-per-mm", type=float, default=8.0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    recipe = json.loads(args.recipe.read_text())
    jobs = ((args.simulator, args.out, args.pixels_per_mm, args.seed + k, line_of(recipe, args.seed, k)) for k in range(args.parts))
    with Processes(args.workers) as processes:
        for text in processes.imap(render, jobs):
            print(text, flush=True)


if __name__ == "__main__":
    main()
