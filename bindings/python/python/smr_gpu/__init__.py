"""Finds snap joints in pictures of a GelSight-like tactile sensor, on any GPU or on the CPU.

>>> import smr_gpu
>>> detector = smr_gpu.Detector(sensor="gelsight-mini")
>>> found = detector("picture.png")
>>> found.boxes, found.scores, found.center_mm
"""

from smr_gpu import errors
from smr_gpu.detections import Detection, Detections
from smr_gpu.detector import Detector, Picture, Savings
from smr_gpu.errors import Error

__all__ = ["Detection", "Detections", "Detector", "Error", "Picture", "Savings", "errors"]
