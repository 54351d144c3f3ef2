"""Messages of snaps whose numbers are easily followed by hand."""

import math

from builtin_interfaces.msg import Time
from smr_gpu import Detection
from std_msgs.msg import Header

from smr_gpu_ros import messages

HOOK = Detection("A", 0, 0.75, (100.0, 200.0, 140.0, 300.5), (-2.0, 8.5), (3.0, 0.5), 90.0, 180.0, 1.0)
STUD = Detection("B", 1, 0.5, (0.0, 0.0, 2.0, 4.0), (1.0, 0.0), None, None, None, None)
HEADER = Header(stamp=Time(sec=7, nanosec=8), frame_id="camera")


def test_a_hook():
    (snap,) = messages.detections([HOOK], HEADER).detections
    assert snap.header == HEADER
    center = snap.bbox.center
    assert (center.position.x, center.position.y, center.theta) == (120.0, 250.25, math.pi / 2)
    assert (snap.bbox.size_x, snap.bbox.size_y) == (40.0, 100.5)
    (result,) = snap.results
    assert (result.hypothesis.class_id, result.hypothesis.score) == ("A", 0.75)
    pose = result.pose.pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (-0.002, 0.0085, 0.0)
    turn = pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
    # Millimetres and degrees became metres and radians; off the diagonal there is nothing.
    diagonal = [0.003**2, 0.0005**2, 1e6, 1e6, 1e6, math.pi**2]
    assert [list(result.pose.covariance[row * 6 : row * 6 + 6]) for row in range(6)] == [
        [diagonal[row] if row == column else 0.0 for column in range(6)] for row in range(6)
    ]


def test_what_is_not_told_has_a_large_variance():
    (pose,) = messages.poses([STUD], HEADER.stamp, "gel")
    assert (pose.header.stamp, pose.header.frame_id) == (HEADER.stamp, "gel")
    assert (pose.pose.pose.orientation.z, pose.pose.pose.orientation.w) == (0.0, 1.0)
    assert list(pose.pose.covariance[::7]) == [1e6] * 6
    assert messages.detections([STUD], HEADER).detections[0].bbox.center.theta == 0.0


def test_poses_keep_the_order():
    assert [pose.pose.pose.position.x for pose in messages.poses([HOOK, STUD], HEADER.stamp, "gel")] == [-0.002, 0.001]
