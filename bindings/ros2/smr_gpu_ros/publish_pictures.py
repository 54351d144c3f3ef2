"""`publish_pictures`: picture files as a camera's images."""

import argparse
import array
from pathlib import Path

import numpy as np
import rclpy
from PIL import Image as Pillow
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from smr_gpu_ros import messages
from smr_gpu_ros.running import until_interrupted


def main() -> int:
    """Publishes files in turn, until interrupted or as often as asked."""
    parser = argparse.ArgumentParser(description="Publishes picture files as images, best effort.")
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="PNG or JPEG")
    parser.add_argument("--rate", type=float, default=5.0, help="images a second")
    parser.add_argument("--count", type=int, default=0, help="how many; 0 for no end")
    parser.add_argument("--frame", default="camera", help="frame_id of the images")
    parser.add_argument("--compressed", action="store_true", help="the files as they are, on image/compressed")
    arguments = parser.parse_args(remove_ros_args()[1:])
    read = _compressed if arguments.compressed else _raw
    images = [read(file) for file in arguments.files]
    with until_interrupted():
        _publish(images, arguments)
    return 0


def _publish(images: list[Image] | list[CompressedImage], arguments: argparse.Namespace) -> None:
    node = Node("publish_pictures")
    topic = "image/compressed" if arguments.compressed else "image"
    publisher = node.create_publisher(type(images[0]), topic, qos_profile_sensor_data)
    while publisher.get_subscription_count() == 0:
        node.get_logger().info(f"waits for a subscriber of {publisher.topic_name}", once=True)
        rclpy.spin_once(node, timeout_sec=0.1)
    rate = node.create_timer(1 / arguments.rate, lambda: send())
    sent = 0

    def send() -> None:
        nonlocal sent
        image = images[sent % len(images)]
        image.header.stamp, image.header.frame_id = node.get_clock().now().to_msg(), arguments.frame
        publisher.publish(image)
        sent += 1

    while arguments.count == 0 or sent < arguments.count:
        rclpy.spin_once(node)
    rate.cancel()
    node.get_logger().info(f"published {sent} images")
    node.destroy_node()


def _raw(file: Path) -> Image:
    return messages.image(np.asarray(Pillow.open(file).convert("RGB")), Header())


def _compressed(file: Path) -> CompressedImage:
    kind = "png" if file.suffix.lower() == ".png" else "jpeg"
    return CompressedImage(format=kind, data=array.array("B", file.read_bytes()))
