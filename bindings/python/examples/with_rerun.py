"""Logs pictures, boxes and arrows to Rerun: pip install rerun-sdk==0.41.0

python with_rerun.py picture.png …               # opens the viewer
python with_rerun.py --save found.rrd picture.png …
"""

import argparse
from pathlib import Path

import numpy as np
import rerun as rr
from PIL import Image

import smr_gpu
from smr_gpu.drawing import COLOURS


def log(picture: np.ndarray, found: smr_gpu.Detections) -> None:
    """A frame's picture, with a box a snap and an arrow in the direction of each barb."""
    colours = [COLOURS[label % len(COLOURS)] for label in found.labels]
    names = [f"{snap.class_name} {snap.score:.2f}" for snap in found]
    rr.log("gel", rr.Image(picture))
    rr.log("gel/snaps", rr.Boxes2D(array=found.boxes, array_format=rr.Box2DFormat.XYXY, labels=names, colors=colours))
    points = found[~np.isnan(found.yaw_deg)]
    yaw = np.radians(points.yaw_deg)
    sides = points.boxes[:, 2:] - points.boxes[:, :2]
    half = np.linalg.norm(sides, axis=1, keepdims=True) / 4
    along = half * np.stack([np.cos(yaw), np.sin(yaw)], 1)
    middles = (points.boxes[:, :2] + points.boxes[:, 2:]) / 2
    rr.log("gel/barbs", rr.Arrows2D(origins=middles - along, vectors=2 * along))
    rr.log("time_ms", rr.Scalars(found.total_ms))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="+", type=Path)
    parser.add_argument("--save", type=Path, help="write a file instead of opening the viewer")
    args = parser.parse_args()
    rr.init("smr-gpu", spawn=args.save is None)
    if args.save:
        rr.save(args.save)
    frames = [np.array(Image.open(path).convert("RGB")) for path in args.pictures]
    detector = smr_gpu.Detector()
    for at, (picture, found) in enumerate(zip(frames, detector.stream(frames))):
        rr.set_time("frame", sequence=at)
        log(picture, found)


if __name__ == "__main__":
    main()
