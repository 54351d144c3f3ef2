"""What the tests share: the node in a process of its own, and a peer in the tests' process that talks to it."""

import array
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

# Of the whole session, before ROS reads them: a domain of its own on this machine alone, and room for large images.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(Path(__file__).parents[1] / "config/fastdds.xml")

import numpy as np
import pytest
import rclpy
import smr_gpu
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from PIL import Image as Pillow
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image
from vision_msgs.msg import Detection2DArray

ROOT = Path(__file__).parents[3]
SAMPLES = sorted((ROOT / "samples").glob("*.png"))
DEVICE = os.environ.get("SMR_GPU_TEST_DEVICE", "cpu")
BIN = Path(sys.executable).parent
# When a test gives up.
PATIENCE_S = 60.0


class Peer(Node):
    """Publishes images to a node under test and keeps what comes back."""

    def __init__(self, namespace, qos=qos_profile_sensor_data):
        super().__init__("peer", namespace=namespace)
        self.detections, self.poses, self.drawn, self.reports = [], [], [], []
        self.images = self.create_publisher(Image, "image", qos)
        self.files = self.create_publisher(CompressedImage, "image/compressed", qos)
        self.create_subscription(Detection2DArray, "detections", self.detections.append, 100)
        self.create_subscription(PoseWithCovarianceStamped, "poses", self.poses.append, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._report, 10)
        self._name = f"{namespace[1:]}/smr_gpu_node: snaps"
        self._parameters = AsyncParameterClient(self, f"{namespace}/smr_gpu_node")
        self._stamp = itertools.count(1)

    def _report(self, message):
        (status,) = message.status
        if status.name == self._name:
            self.reports.append((status.level, status.message, {pair.key: pair.value for pair in status.values}))

    def until(self, happens, what):
        """Lets messages come until it happens, and gives what it gave."""
        end = time.monotonic() + PATIENCE_S
        while not (value := happens()):
            assert time.monotonic() < end, f"waited in vain for {what}"
            rclpy.spin_once(self, timeout_sec=0.05)
        return value

    def send(self, message, frame="camera"):
        """Publishes a message under a stamp of its own, and gives the stamp."""
        self.until(lambda: self.count_subscribers("image") or self.count_subscribers("image/compressed"), "the node")
        message.header.stamp.sec, message.header.frame_id = next(self._stamp), frame
        (self.images if isinstance(message, Image) else self.files).publish(message)
        return message.header.stamp.sec

    def answer(self, message, frame="camera"):
        """What the node says of an image; sends it again where it got lost."""
        sent = []

        def answered():
            if not sent or time.monotonic() > sent[-1][1] + 3:
                sent.append((self.send(message, frame), time.monotonic()))
            stamps = {stamp for stamp, _ in sent}
            return next((found for found in self.detections if found.header.stamp.sec in stamps), None)

        return self.until(answered, "detections")

    def set(self, **values):
        """Sets parameters of the node together, and gives whether it took them, and its reason."""
        self.until(self._parameters.services_are_ready, "the node's parameters")
        wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        future = self._parameters.set_parameters_atomically(wanted)
        self.until(future.done, "an answer about parameters")
        return future.result().result.successful, future.result().result.reason

    def report(self, matches=lambda level, message, values: True, sending=None):
        """The next diagnostic that matches; meanwhile an image is sent again and again, if there is one."""
        self.reports.clear()

        def matching():
            if sending is not None:
                self.send(sending)
            return next((each for each in self.reports if matches(*each)), None)

        return self.until(matching, "a diagnostic")


class Running:
    """A node's process and what it logs."""

    def __init__(self, namespace, log, parameters):
        options = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
        command = [BIN / "smr_gpu_node", "--ros-args", "-r", f"__ns:={namespace}", *options]
        self.log_file = log
        with log.open("w") as file:
            self.process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)

    def log(self):
        return self.log_file.read_text()

    def memory_kib(self):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0])

    def end(self, how=signal.SIGINT):
        """Ends it, and gives its exit code."""
        self.process.send_signal(how)
        return self.process.wait(PATIENCE_S)


@pytest.fixture(scope="session", autouse=True)
def ros():
    with rclpy.init():
        yield


@pytest.fixture
def namespace():
    return f"/test_{next(_COUNT)}"


_COUNT = itertools.count()


@pytest.fixture
def start(namespace, tmp_path):
    """Starts a node in the test's namespace; parameters go beside the tests' device and scale."""
    started = []

    def start(**parameters):
        log = tmp_path / f"{len(started)}.log"
        started.append(Running(namespace, log, {"device": DEVICE, "mm_per_pixel": 0.04} | parameters))
        return started[-1]

    yield start
    for node in started:
        if node.process.poll() is None:
            node.end(signal.SIGKILL)


@pytest.fixture
def peer(namespace):
    peer = Peer(namespace)
    yield peer
    peer.destroy_node()


@pytest.fixture(scope="session")
def mixed():
    """samples/mixed.png in RGB, 1000 × 1000 × 3: two hooks and a stud."""
    return np.array(Pillow.open(ROOT / "samples/mixed.png").convert("RGB"))


@pytest.fixture(scope="session")
def detector():
    return smr_gpu.Detector(device=DEVICE, mm_per_pixel=0.04)


@pytest.fixture(scope="session")
def program():
    """The program's `detect --json` of a picture."""
    path = Path(os.environ.get("SMR_GPU_PROGRAM", ROOT / "target/release/smr-gpu"))

    def detect(file):
        scale = ["--mm-per-pixel", "0.04"]
        command = [path, "detect", "--json", "--weights", "small", "--device", DEVICE, *scale, file]
        run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
        return json.loads(run.stdout)["detections"]

    return detect


def image(pixels, encoding, step=None, is_bigendian=0):
    """A message of an array; `step` bytes lie between rows."""
    height, width = pixels.shape[:2]
    row = pixels.nbytes // height
    rows = np.full((height, step or row), 0xA5, np.uint8)
    rows[:, :row] = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, row)
    data = array.array("B", rows.tobytes())
    return Image(
        height=height, width=width, encoding=encoding, step=rows.shape[1], is_bigendian=is_bigendian, data=data
    )


def rows(message):
    """What a message says of snaps, to the bit: class, score, box, pose and covariance."""
    return [
        (
            snap.results[0].hypothesis.class_id,
            snap.results[0].hypothesis.score,
            (snap.bbox.center.position.x, snap.bbox.center.position.y, snap.bbox.size_x, snap.bbox.size_y),
            snap.bbox.center.theta,
            (snap.results[0].pose.pose.position.x, snap.results[0].pose.pose.position.y),
            (snap.results[0].pose.pose.orientation.z, snap.results[0].pose.pose.orientation.w),
            tuple(snap.results[0].pose.covariance),
        )
        for snap in message.detections
    ]
