"""Measures the node: images and answers a second, what gets lost, latency, and its memory.

A process publishes a picture at a rate, the node answers in another, and this one reads its diagnostics. For memory,
let it run longer: `--seconds 600`.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
# Before ROS reads them.
os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(HERE / "config/fastdds.xml")
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

# Before this the node is still warming up.
SETTLED_S = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="PNG or JPEG, such as samples/mixed.png")
    parser.add_argument("--rate", type=float, default=30.0, help="images a second")
    parser.add_argument("--seconds", type=float, default=30.0, help="how long")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--all", action="store_true", help="let ten images wait, instead of looking at the latest")
    arguments = parser.parse_args()

    bin = Path(sys.executable).parent
    options = [f"device:={arguments.device}", "mm_per_pixel:=0.04", f"latest_only:={str(not arguments.all).lower()}"]
    node = subprocess.Popen([bin / "smr_gpu_node", "--ros-args", *(text for each in options for text in ("-p", each))])
    camera = subprocess.Popen([bin / "publish_pictures", arguments.picture, "--rate", str(arguments.rate)])
    try:
        reports, memory_mib = watch(node.pid, SETTLED_S + arguments.seconds)
    finally:
        camera.terminate()
        camera.wait()
        node.terminate()
        node.wait()
    show(reports, memory_mib)


def watch(pid: int, seconds: float) -> tuple[list[tuple[float, dict[str, str]]], list[float]]:
    """The node's diagnostics with when they came, and its memory beside each."""
    reports, memory_mib = [], []
    began = time.monotonic()

    def take(message: DiagnosticArray) -> None:
        if time.monotonic() - began > SETTLED_S:
            reports.append((time.monotonic(), {pair.key: pair.value for pair in message.status[0].values}))
            status = Path(f"/proc/{pid}/status").read_text()
            memory_mib.append(int(status.split("VmRSS:")[1].split()[0]) / 1024)

    with rclpy.init():
        watcher = Node("watcher")
        watcher.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
        while time.monotonic() < began + seconds:
            rclpy.spin_once(watcher, timeout_sec=0.5)
    return reports, memory_mib


def show(reports: list[tuple[float, dict[str, str]]], memory_mib: list[float]) -> None:
    (start, first), (end, last) = reports[0], reports[-1]
    count = {name: int(last[name]) - int(first[name]) for name in ("received", "answered", "dropped", "lost on the way")}
    mean = statistics.mean(float(values["latency, mean, ms"] or 0) for _, values in reports)
    longest = max(float(values["latency, longest, ms"] or 0) for _, values in reports)
    tenth = max(len(memory_mib) // 10, 1)
    memory = [statistics.median(part) for part in (memory_mib[:tenth], memory_mib[-tenth:])]
    print(f"{end - start:.0f} s on {last['device']}: {count['answered'] / (end - start):.1f} answers a second, {count}")
    print(f"latency {mean:.0f} ms in the mean, {longest:.0f} ms at most")
    print(f"memory {memory[0]:.1f} MiB in the first tenth, {memory[1]:.1f} MiB in the last")


if __name__ == "__main__":
    main()
