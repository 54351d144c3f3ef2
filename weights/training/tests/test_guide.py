"""Every block of commands of docs/guide/your-own-snap.md, as it stands, in an empty folder; only how much is simulated and
learnt is less, and what installs the package is left out, since it is installed."""

import os
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
GUIDE = ROOT / "docs/guide/your-own-snap.md"
# Programs that the blocks call, as scripts before all others on the path.
TEACH = """#!/bin/sh
if [ "$1" != teach ]; then exec "{program}" "$@"; fi
# Of two equal options the program takes none: the block's own goes.
for argument in "$@"; do
    shift
    if [ -n "$drop" ]; then drop=; elif [ "$argument" = --steps ]; then drop=1; else set -- "$@" "$argument"; fi
done
exec "{program}" "$@" --pictures 40 --steps 3 --test 4
"""
CARGO = """#!/bin/sh
shift
exec "{cargo}" run --manifest-path "{root}/Cargo.toml" "$@"
"""


def blocks() -> list[str]:
    return re.findall(r"^```sh\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


class Guide(unittest.TestCase):
    def test_blocks_run(self) -> None:
        found = subprocess.run(["which", "cargo"], capture_output=True, text=True, check=True).stdout.strip()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            program = os.environ["SMR_GPU"]
            scripts = {
                "path/smr-gpu": TEACH.format(program=program),
                "path/cargo": CARGO.format(cargo=found, root=ROOT),
                "train/bin/python": f'#!/bin/sh\nexec "{sys.executable}" "$@"\n',
                "train/bin/smr-gpu-train": f'#!/bin/sh\nexec "{sys.executable}" -m smr_gpu_train "$@"\n',
            }
            for script, text in scripts.items():
                file = folder / script
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text)
                file.chmod(0o755)
            # The package of this folder, whatever Python has one installed.
            paths = [str(ROOT / "weights/training"), os.environ.get("PYTHONPATH")]
            environment = os.environ | {"PATH": f"{folder / 'path'}:{os.environ['PATH']}", "PYTHONPATH": ":".join(filter(None, paths))}
            for block in blocks():
                with self.subTest(block):
                    ran = subprocess.run(["sh", "-e", "-c", block], cwd=folder, env=environment, capture_output=True, text=True)
                    self.assertEqual(ran.returncode, 0, ran.stdout + ran.stderr)
            for made in ("parts/clip.stl", "parts.png", "clips.safetensors", "clips.teach/report.md", "mine.safetensors", "both.safetensors", "clips.onnx", "found"):
                self.assertTrue((folder / made).exists(), made)
            self.assertIn("| clip |", (folder / "mine.teach/report.md").read_text())


if __name__ == "__main__":
    unittest.main()
