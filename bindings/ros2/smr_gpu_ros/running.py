"""`until_interrupted`: how each program of this package begins and ends."""

from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.executors import ExternalShutdownException


@contextmanager
def until_interrupted() -> Iterator[None]:
    """ROS is there within; an interrupt ends it, and is no error."""
    try:
        with rclpy.init():
            try:
                yield
            except RuntimeError:
                # What was under way, such as taking an image or publishing, found that ROS is gone.
                if rclpy.ok():
                    raise
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
