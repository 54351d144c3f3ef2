"""Parameters: described, changed while it runs, refused with the old detector going on."""

import re
import subprocess

import pytest
import yaml
from conftest import BIN, ROOT, image, rows
from rcl_interfaces.srv import DescribeParameters

from smr_gpu_ros import parameters


def test_descriptions_and_ranges(start, peer, namespace):
    start()
    names = list(parameters.DEFAULTS)
    client = peer.create_client(DescribeParameters, f"{namespace}/smr_gpu_node/describe_parameters")
    peer.until(client.service_is_ready, "the node")
    future = client.call_async(DescribeParameters.Request(names=names))
    peer.until(future.done, "descriptions")
    said = dict(zip(names, future.result().descriptors, strict=True))
    assert all(each.description.endswith(".") for each in said.values())
    (scores,), (waiting,) = said["score"].floating_point_range, said["queue_size"].integer_range
    assert (scores.from_value, scores.to_value) == (0.0, 1.0)
    assert (waiting.from_value, waiting.to_value) == (1, 1000)
    assert [name for name in names if said[name].read_only] == ["image_transport"]


def test_changes_take_effect(start, peer, mixed):
    start()
    message = image(mixed, "rgb8")
    names, scores = zip(*(row[:2] for row in rows(peer.answer(message))), strict=True)
    assert sorted(names) == ["A", "A", "B"]
    best, second = scores[:2]

    def answer_after(**values):
        assert peer.set(**values) == (True, "")
        peer.detections.clear()
        return peer.answer(message)

    assert [row[0] for row in rows(answer_after(classes=["B"]))] == ["B"]
    assert [row[0] for row in rows(answer_after(classes=[""]))] == list(names)
    assert [row[1] for row in rows(answer_after(score=(best + second) / 2))] == [best]
    answer_after(mm_per_pixel=0.05, gel_frame="other")
    assert peer.report()[2]["mm a pixel"] == "0.05 (stated)"
    assert peer.set(mm_per_pixel=0.04, score=0.5) == (True, "")
    peer.poses.clear()
    assert len(peer.answer(message).detections) == 3
    peer.until(lambda: peer.poses and peer.poses[-1].header.frame_id == "other", "poses in the other frame")


@pytest.mark.parametrize("values, reason", [
    ({"score": 1.5}, "score"),
    ({"score": "high"}, "type"),
    ({"classes": ["Z"]}, "expected A, B, got `Z`"),
    ({"weights": "nowhere.safetensors"}, "nowhere.safetensors"),
    ({"sensor": "/nowhere.json"}, "/nowhere.json"),
    ({"mm_per_pixel": 1e-4}, "0.0005 to 1"),
    ({"device": "no such adapter"}, "no such adapter"),
    ({"queue_size": 0}, "queue_size"),
    ({"image_transport": "raw"}, "read-only"),
    # One bad value refuses the others with it.
    ({"classes": ["B"], "score": -1.0}, "score"),
])  # fmt: skip
def test_a_wrong_value_is_refused_and_the_old_detector_goes_on(running, values, reason):
    peer, message, want = running
    taken, said = peer.set(**values)
    assert not taken
    assert reason in said, said
    peer.detections.clear()
    assert rows(peer.answer(message)) == want


@pytest.fixture
def running(start, peer, mixed):
    start()
    message = image(mixed, "rgb8")
    return peer, message, rows(peer.answer(message))


def test_a_wrong_value_at_the_start_ends_the_node_by_name(start):
    for name, value in {"score": 2.0, "queue_size": "many", "image_transport": "carrier_pigeon"}.items():
        node = start(**{name: value})
        assert node.process.wait(30) == 2
        assert name in node.log()
        assert "Traceback" not in node.log()


def test_without_weights_it_waits_for_them(start, peer, mixed):
    node = start(weights="nowhere.safetensors")
    level, message, _ = peer.report(lambda level, message, values: values["failed"] != "0", sending=image(mixed, "rgb8"))
    assert level == b"\x02"
    assert message.startswith("no detector: ") and "nowhere.safetensors" in message
    assert "no detector: " in node.log()
    assert peer.set(weights="small") == (True, "")
    assert len(peer.answer(image(mixed, "rgb8")).detections) == 3


def test_a_scale_that_nobody_states_is_told_or_refused(start, peer, mixed):
    start(mm_per_pixel=0.0)
    message = image(mixed, "rgb8")
    level, said, values = peer.report(lambda level, message, values: "assumed" in message, sending=message)
    assert (level, said) == (b"\x01", "1000 × 1000: assumed 0.0400 mm a pixel")
    assert values["mm a pixel"] == "0.04 (assumed)"
    assert peer.set(strict_scale=True) == (True, "")
    level, said, _ = peer.report(lambda level, *_: level == b"\x02", sending=message)
    assert "scale" in said
    assert peer.set(mm_per_pixel=0.04) == (True, "")
    peer.detections.clear()
    assert len(peer.answer(message).detections) == 3


def test_the_file_of_parameters_has_the_defaults(namespace, tmp_path):
    file = ROOT / "bindings/ros2/config/smr_gpu.yaml"
    (said,) = yaml.safe_load(file.read_text()).values()
    assert said["ros__parameters"] == parameters.DEFAULTS
    # It is for the node in any namespace: a wrong value in it is seen.
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(file.read_text().replace("score: 0.5", "score: 7.5"))
    for at in ("/", namespace, f"{namespace}/deeper"):
        command = [BIN / "smr_gpu_node", "--ros-args", "-r", f"__ns:={at}", "--params-file", wrong]
        run = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert (run.returncode, "score out of range" in run.stderr) == (2, True)


def test_the_readme_has_all_parameters():
    readme = (ROOT / "bindings/ros2/README.md").read_text()
    table = readme.split("## Parameters")[1].split("## What goes wrong")[0]
    assert re.findall(r"^\| `(\w+)`", table, re.MULTILINE) == list(parameters.DEFAULTS)
