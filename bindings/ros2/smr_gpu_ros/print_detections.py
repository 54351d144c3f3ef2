"""`print_detections`: what the node found, a line a snap."""

import math

import rclpy
from rclpy.node import Node
from vision_msgs.msg import Detection2DArray

from smr_gpu_ros.messages import UNKNOWN
from smr_gpu_ros.running import until_interrupted


def main() -> int:
    """Prints detections until interrupted."""
    with until_interrupted():
        node = Node("print_detections")
        node.create_subscription(Detection2DArray, "detections", _print, 10)
        # Wakes the executor, which may sleep through an interrupt that comes between two waits.
        node.create_timer(1.0, lambda: None)
        rclpy.spin(node)
    return 0


def _print(message: Detection2DArray) -> None:
    stamp = message.header.stamp
    print(f"{stamp.sec}.{stamp.nanosec:09} {message.header.frame_id}: {len(message.detections)} snaps", flush=True)
    for detection in message.detections:
        (result,) = detection.results
        position, covariance = result.pose.pose.position, result.pose.covariance
        x, y = 1e3 * position.x, 1e3 * position.y
        yaw = "-" if covariance[35] == UNKNOWN else f"{math.degrees(detection.bbox.center.theta):.1f}°"
        print(f"  {result.hypothesis.class_id} {result.hypothesis.score:.3f} at {x:.2f}, {y:.2f} mm, yaw {yaw}", flush=True)
