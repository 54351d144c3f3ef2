"""Time of a call beside the library's own: medians of 100 calls, in milliseconds.

python bindings/python/overhead.py samples/mixed.png cpu
"""

import statistics
import sys
import time

import numpy as np
from PIL import Image

import smr_gpu

file, device = sys.argv[1:]
rgb = np.array(Image.open(file).convert("RGB"))
detector = smr_gpu.Detector(device=device)
print(f"{rgb.shape[1]} × {rgb.shape[0]}, {detector.adapter}: the call, the library, the difference")
for name, picture, order in [
    ("RGB", rgb, "RGB"),
    ("BGR", rgb[:, :, ::-1].copy(), "BGR"),
    ("a part of a wider array", np.pad(rgb, ((0, 0), (0, 8), (0, 0)))[:, :-8], "RGB"),
    ("BGR by negative strides", rgb[:, :, ::-1], "RGB"),
    ("16 bits", rgb.astype(np.uint16) * 257, "RGB"),
]:
    rows = []
    for _ in range(100):
        start = time.perf_counter()
        found = detector(picture, order=order)
        ms = 1e3 * (time.perf_counter() - start)
        rows.append((ms, found.total_ms, ms - found.total_ms))
    medians = [statistics.median(column) for column in zip(*rows[5:])]
    print(f"{name:24}", *(f"{value:8.3f}" for value in medians))
