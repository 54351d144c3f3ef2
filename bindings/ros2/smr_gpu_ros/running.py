"""`until_interrupted`: how each program of this package begins and ends."""

from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation


@contextmanager
def until_interrupted() -> Iterator[None]:
    """ROS is there within; an interrupt ends it, and is no error."""
    try:
        with rclpy.init():
            yield
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except rclpy_implementation.RCLError:
        # What was under way, such as publishing, finds that ROS is gone.
        if rclpy.ok():
            raise
