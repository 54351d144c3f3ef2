"""What goes wrong in a graph of ROS: QoS that does not match, bursts, peers and nodes that die, hours of running."""

import signal
import statistics
import subprocess
import time

import numpy as np
from conftest import BIN, image
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Image

RELIABLE = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)


def test_a_reliable_subscriber_of_a_best_effort_topic_is_told(start, peer, namespace):
    node = start()
    peer.create_subscription(Image, "drawn", peer.drawn.append, RELIABLE)
    remedy = f"-p qos_overrides.{namespace}/drawn.publisher.reliability:=reliable"
    peer.until(lambda: remedy in node.log(), "the remedy")
    assert f"{namespace}/drawn: a subscriber asks for more RELIABILITY than this node offers" in node.log()
    assert remedy in peer.report(lambda level, message, values: values["last error"])[2]["last error"]


def test_the_remedies_work(start, peer, namespace, mixed):
    # The other way round: a reliable subscription, and a camera that is best effort.
    node = start(**{f"qos_overrides.{namespace}/image.subscription.reliability": "reliable"})
    remedy = f"-p qos_overrides.{namespace}/image.subscription.reliability:=best_effort"
    peer.until(lambda: remedy in node.log(), "the remedy")
    assert node.end() == 0
    # Both remedies at once.
    parameters = {
        f"qos_overrides.{namespace}/image.subscription.reliability": "best_effort",
        f"qos_overrides.{namespace}/drawn.publisher.reliability": "reliable",
    }
    node = start(**parameters)
    peer.create_subscription(Image, "drawn", peer.drawn.append, RELIABLE)
    peer.until(lambda: peer.answer(image(mixed, "rgb8")) and peer.drawn, "a drawn image")
    assert "RELIABILITY" not in node.log()


def test_a_burst_is_answered_by_its_last_image(start, peer, mixed):
    start(latest_only="true")
    peer.answer(image(mixed, "rgb8"))
    peer.detections.clear()
    burst = [image(np.roll(mixed, 10 * shift, axis=1), "rgb8") for shift in range(12)]
    stamps = [peer.send(message) for message in burst]
    peer.until(lambda: any(each.header.stamp.sec == stamps[-1] for each in peer.detections), "the last image's answer")
    level, _, values = peer.report(lambda level, message, values: values["images a second"] == "0.0")
    counts = {name: int(values[name]) for name in ("received", "answered", "dropped", "failed")}
    assert counts["failed"] == 0
    assert counts["dropped"] > 0
    assert counts["received"] == counts["answered"] + counts["dropped"]
    answered = [each.header.stamp.sec for each in peer.detections]
    assert answered == sorted(answered)
    assert len(answered) < len(burst)


def test_images_may_wait_in_a_queue(start, peer, mixed):
    start(latest_only="false", queue_size=100)
    peer.answer(image(mixed, "rgb8"))
    peer.detections.clear()
    small = image(mixed[:600, :600], "rgb8")
    stamps = []
    for _ in range(12):
        stamps.append(peer.send(small))
        # The node's history has room for 5 that its executor has not taken.
        time.sleep(0.02)
    peer.until(lambda: [each.header.stamp.sec for each in peer.detections][-1:] == stamps[-1:], "the last answer")
    values = peer.report(lambda level, message, values: values["images a second"] == "0.0")[2]
    assert (values["dropped"], values["failed"]) == ("0", "0")
    assert values["received"] == values["answered"]


def test_a_subscriber_that_dies_leaves_the_others_their_answers(start, peer, namespace, mixed, tmp_path):
    node = start()
    command = [BIN / "print_detections", "--ros-args", "-r", f"__ns:={namespace}"]
    message = image(mixed, "rgb8")
    log = tmp_path / "other.log"
    with log.open("w") as file, subprocess.Popen(command, stdout=file) as other:
        peer.until(lambda: peer.answer(message) and "3 snaps" in log.read_text(), "the other subscriber's detections")
        other.kill()
    for _ in range(10):
        peer.detections.clear()
        assert len(peer.answer(message).detections) == 3
    assert node.end() == 0


def test_a_killed_node_starts_again_for_the_same_peers(start, peer, mixed):
    node = start()
    message = image(mixed, "rgb8")
    peer.answer(message)
    assert node.end(signal.SIGKILL) == -signal.SIGKILL
    peer.detections.clear()
    node = start()
    assert len(peer.answer(message).detections) == 3
    assert node.end(signal.SIGTERM) == 0


def test_an_interrupt_under_load_ends_it_at_once(start, peer, mixed):
    node = start(latest_only="false")
    message = image(mixed, "rgb8")
    peer.answer(message)
    for _ in range(10):
        peer.send(message)
    assert node.end(signal.SIGINT) == 0
    assert "Traceback" not in node.log()


def test_memory_stays(start, peer, mixed):
    """Half a minute of images, good and bad, drawn and compressed; `measure.py` goes on for as long as you let it."""
    node = start(latest_only="false")
    good, bad = image(mixed, "rgb8"), image(np.zeros((500, 500), np.float32), "32FC1")
    peer.create_subscription(Image, "drawn", peer.drawn.append, qos_profile_sensor_data)
    memory, end = [], time.monotonic() + 30
    while time.monotonic() < end:
        peer.send(bad)
        peer.answer(good)
        peer.detections.clear(), peer.poses.clear(), peer.drawn.clear(), peer.reports.clear()
        memory.append(node.memory_kib())
    third = len(memory) // 3
    assert third >= 5
    assert statistics.median(memory[-third:]) < statistics.median(memory[third : 2 * third]) + 8 * 1024
