"""Images go in by one process, and detections come out in another, as the program and the package find them."""

import array
import io
import math
import subprocess

import numpy as np
from conftest import BIN, PATIENCE_S, SAMPLES, image, rows
from PIL import Image as Pillow
from sensor_msgs.msg import CompressedImage


def expected(found):
    """The rows of a message, computed here from what the package found."""
    for snap in found:
        x1, y1, x2, y2 = snap.box
        yaw = None if snap.yaw_deg is None else math.radians(snap.yaw_deg)
        covariance = [0.0] * 36
        covariance[0], covariance[7] = ((std / 1000) ** 2 for std in snap.center_std_mm)
        covariance[14] = covariance[21] = covariance[28] = 1e6
        covariance[35] = 1e6 if yaw is None else math.radians(snap.yaw_std_deg) ** 2
        yield (
            snap.class_name,
            snap.score,
            ((x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1),
            yaw or 0.0,
            (snap.center_mm[0] / 1000, snap.center_mm[1] / 1000),
            (math.sin((yaw or 0.0) / 2), math.cos((yaw or 0.0) / 2)),
            tuple(covariance),
        )


def test_samples_from_another_process_equal_the_program(start, peer, namespace, program):
    start(latest_only="false")
    command = [BIN / "publish_pictures", *SAMPLES, "--rate", "4", "--frame", "gel_camera"]
    publisher = subprocess.Popen([*command, "--ros-args", "-r", f"__ns:={namespace}"])
    want = {file.name: program(file) for file in SAMPLES}
    try:
        # Each sample has a first box of its own.
        seen = lambda: {rows(each)[0][2] for each in peer.detections}
        peer.until(lambda: len(seen()) == len(SAMPLES), "all samples")
    finally:
        publisher.terminate()
        publisher.wait(PATIENCE_S)
    assert {each.header.frame_id for each in peer.detections} == {"gel_camera"}
    got = {tuple((row[0], row[1], row[2]) for row in rows(each)) for each in peer.detections}
    assert got == {tuple(map(program_row, snaps)) for snaps in want.values()}


def program_row(snap):
    x1, y1, x2, y2 = (float(np.float32(corner)) for corner in snap["box"])
    score = float(np.float32(snap["score"]))
    return snap["class"], score, ((x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1)


def test_header_pose_and_covariance(start, peer, detector, mixed):
    start(gel_frame="finger_gel")
    message = image(mixed, "rgb8")
    message.header.stamp.nanosec = 123_456_789
    answer = peer.answer(message, frame="finger_camera")
    assert answer.header.stamp.nanosec == 123_456_789
    assert answer.header.frame_id == "finger_camera"
    assert all(snap.header == answer.header for snap in answer.detections)
    found = detector(mixed)
    assert sorted(found.names) == ["A", "A", "B"]
    assert rows(answer) == list(expected(found))
    peer.until(lambda: len(peer.poses) >= 3, "poses")
    for pose, snap in zip(peer.poses, answer.detections, strict=False):
        assert (pose.header.stamp, pose.header.frame_id) == (answer.header.stamp, "finger_gel")
        assert pose.pose == snap.results[0].pose


def test_nothing_found_is_an_answer(start, peer):
    start()
    answer = peer.answer(image(np.full((400, 400, 3), 128, np.uint8), "rgb8"))
    assert list(answer.detections) == []
    assert peer.poses == []


def test_compressed_images(start, peer, detector, mixed):
    start()
    for kind in ("png", "jpeg"):
        file = io.BytesIO()
        Pillow.fromarray(mixed).save(file, kind)
        want = detector(np.asarray(Pillow.open(file).convert("RGB")))
        # As image_transport names it.
        message = CompressedImage(format=f"rgb8; {kind} compressed bgr8", data=array.array("B", file.getvalue()))
        peer.detections.clear()
        assert rows(peer.answer(message)) == list(expected(want)), kind


def test_a_drawn_image_only_while_somebody_looks(start, peer, mixed, detector):
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Image

    start()
    message = image(mixed[..., ::-1], "bgr8")
    peer.answer(message)
    assert peer.report()[2]["drawn"] == "0"
    looker = peer.create_subscription(Image, "drawn", peer.drawn.append, qos_profile_sensor_data)
    peer.until(lambda: peer.answer(message) and peer.drawn, "a drawn image")
    drawn = peer.drawn[0]
    assert (drawn.encoding, drawn.width, drawn.height, drawn.step) == ("rgb8", 1000, 1000, 3000)
    assert drawn.header.frame_id == "camera"
    want = np.asarray(detector(mixed).plot(mixed))
    np.testing.assert_array_equal(np.frombuffer(drawn.data, np.uint8).reshape(1000, 1000, 3), want)
    peer.destroy_subscription(looker)
    peer.until(lambda: peer.count_subscribers("drawn") == 0, "the looker's end")
    # Behind this answer nothing is drawn any more that was asked for before.
    peer.detections.clear()
    peer.answer(message)
    before = peer.report()[2]["drawn"]
    peer.detections.clear()
    peer.answer(message)
    assert peer.report()[2]["drawn"] == before
