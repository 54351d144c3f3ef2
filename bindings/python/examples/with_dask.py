"""Finds the snaps in a folder's pictures on a local Dask cluster: pip install distributed==2026.8.0

python with_dask.py pictures > found.jsonl                 # two workers, each with a detector
python with_dask.py pictures --workers 4 --device auto
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

from distributed import Client, LocalCluster, Worker, WorkerPlugin, get_worker

import smr_gpu


class DetectorPlugin(WorkerPlugin):
    """Gives each worker a detector of its own, also one that takes a dead one's place."""

    name = "detector"

    def __init__(self, **options: object) -> None:
        self.options = options

    def setup(self, worker: Worker) -> None:
        self.detector = smr_gpu.Detector(**self.options)


def look(file: str) -> smr_gpu.Detections | smr_gpu.Error:
    """What a worker finds in a picture; an error is the picture's alone, so it does not end the others."""
    try:
        return get_worker().plugins[DetectorPlugin.name].detector(file)
    except smr_gpu.Error as error:
        return error


def find(client: Client, files: list[Path], **options: object) -> Iterator[smr_gpu.Detections | smr_gpu.Error]:
    """One result for each file, in their order. What a worker had when it died, others do again.

    `options` are those of `smr_gpu.Detector`.
    """
    client.register_plugin(DetectorPlugin(**options))
    # Each file is a task of its own, also where one is named twice.
    tasks = client.map(look, [str(file) for file in files], pure=False)[::-1]
    while tasks:
        # What was given out is forgotten by the workers, and not done again if one dies.
        yield tasks.pop().result()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()
    files = sorted(file for file in args.folder.iterdir() if file.suffix.lower() in (".png", ".jpg", ".jpeg"))
    with LocalCluster(n_workers=args.workers, threads_per_worker=1) as cluster, Client(cluster) as client:
        for file, found in zip(files, find(client, files, device=args.device)):
            if isinstance(found, smr_gpu.Error):
                print(found, file=sys.stderr)
            else:
                print(json.dumps({"file": str(file), **found.to_dict()}))


if __name__ == "__main__":
    main()
