"""The node's parameters: their defaults, ranges, descriptions, and what they say to the detector."""

from typing import Any

import smr_gpu
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node

_NEW_DETECTOR = "May change at any time: a new detector is built, or the value is refused."
_DETECTOR = {
    "weights": ("small", "`small`, `large`, another name that `smr-gpu weights` lists, or a file."),
    "device": ("auto", "`auto`, `gpu`, `cpu`, an adapter's index, or part of its name."),
    "sensor": ("", "`paper`, `gelsight-mini`, `digit`, `plain`, or a sensor file; empty where none is known."),
    "mm_per_pixel": (0.0, "Millimetres of gel for a pixel of the images, 0.0005 to 1; 0 for the sensor's.", 0.0, 1.0),
    "strict_scale": (False, "Refuse images whose scale nobody states."),
    "score": (0.5, "Detections have a score above this.", 0.0, 1.0),
    "classes": ([""], "The wanted classes; an empty name stands for none, and without any name all are wanted."),
}
_NODE = {
    "gel_frame": ("gel", "Frame of the poses: origin in the gel's middle, x right and y down in the picture."),
    "latest_only": (True, "Of the images that wait, look at the latest; the others are dropped and counted."),
    "queue_size": (10, "Images that may wait where latest_only is false; then the oldest is dropped.", 1, 1000),
}
_AT_START = {
    "image_transport": ("both", "`raw`, `compressed` or `both`: the topics to subscribe. Cannot change."),
}

DEFAULTS = {name: default for group in (_DETECTOR, _NODE, _AT_START) for name, (default, *_) in group.items()}


def declare(node: Node) -> None:
    """Declares all parameters.

    Raises:
        rclpy.exceptions.InvalidParameterValueException: a value from outside is out of its range.
        rclpy.exceptions.InvalidParameterTypeException: it has another type.
    """
    for name, said in _DETECTOR.items():
        _declare(node, name, *said, more=_NEW_DETECTOR)
    for name, said in _NODE.items():
        _declare(node, name, *said, more="May change at any time.")
    for name, said in _AT_START.items():
        _declare(node, name, *said, read_only=True)
    transport = node.get_parameter("image_transport").value
    if transport not in ("raw", "compressed", "both"):
        raise InvalidParameterValueException("image_transport", transport, "expected `raw`, `compressed` or `both`")


def _declare(node: Node, name: str, default: Any, text: str, *bounds: float, more: str = "", **said: Any) -> None:
    ranges = {}
    if bounds:
        kind, field = (IntegerRange, "integer") if isinstance(default, int) else (FloatingPointRange, "floating_point")
        ranges[f"{field}_range"] = [kind(from_value=bounds[0], to_value=bounds[1])]
    node.declare_parameter(name, default, ParameterDescriptor(description=f"{text} {more}".strip(), **ranges, **said))


def values(node: Node) -> dict[str, Any]:
    """All parameters as they stand."""
    return {name: node.get_parameter(name).value for name in DEFAULTS}


def need_detector(names: set[str]) -> bool:
    """Whether a change of these asks for a new detector."""
    return not names.isdisjoint(_DETECTOR)


def detector(said: dict[str, Any]) -> smr_gpu.Detector:
    """The detector of these values; those of other parameters are ignored.

    Raises:
        smr_gpu.Error: a value that the detector refuses, missing weights, no such device.
    """
    return smr_gpu.Detector(
        weights=said["weights"],
        device=said["device"],
        sensor=said["sensor"] or None,
        mm_per_pixel=said["mm_per_pixel"] or None,
        strict_scale=said["strict_scale"],
        score=said["score"],
        classes=[name for name in said["classes"] if name],
    )
