"""From what the detector found to messages."""

import array
import math

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion
from numpy.typing import NDArray
from sensor_msgs.msg import Image
from smr_gpu import Detection, Detections
from std_msgs.msg import Header
from vision_msgs.msg import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    Point2D,
    Pose2D,
)

UNKNOWN = 1e6
"""Variance, in m² and rad², of what the detector does not tell."""


def detections(found: Detections, header: Header) -> Detection2DArray:
    """All snaps under the image's header: boxes in pixels, and in each hypothesis the pose on the gel."""
    return Detection2DArray(header=header, detections=[_detection(snap, header) for snap in found])


def poses(found: Detections, stamp: object, frame: str) -> list[PoseWithCovarianceStamped]:
    """The pose of each snap on the gel in metres, in the order of `detections`."""
    header = Header(stamp=stamp, frame_id=frame)
    return [PoseWithCovarianceStamped(header=header, pose=_pose(snap)) for snap in found]


def image(rgb: NDArray[np.uint8], header: Header) -> Image:
    """A picture of height × width × 3 in RGB."""
    height, width, _ = rgb.shape
    # An array is taken as it is; of bytes each would be looked at.
    data = array.array("B", rgb.tobytes())
    return Image(header=header, height=height, width=width, encoding="rgb8", step=3 * width, data=data)


def _detection(snap: Detection, header: Header) -> Detection2D:
    x1, y1, x2, y2 = snap.box
    center = Pose2D(position=Point2D(x=(x1 + x2) / 2, y=(y1 + y2) / 2), theta=_yaw(snap))
    hypothesis = ObjectHypothesis(class_id=snap.class_name, score=snap.score)
    return Detection2D(
        header=header,
        bbox=BoundingBox2D(center=center, size_x=x2 - x1, size_y=y2 - y1),
        results=[ObjectHypothesisWithPose(hypothesis=hypothesis, pose=_pose(snap))],
    )


def _pose(snap: Detection) -> PoseWithCovariance:
    x, y = snap.center_mm
    half = _yaw(snap) / 2
    covariance = np.diag([*_variances(snap)]).ravel()
    pose = Pose(
        position=Point(x=x / 1000, y=y / 1000, z=0.0),
        orientation=Quaternion(z=math.sin(half), w=math.cos(half)),
    )
    return PoseWithCovariance(pose=pose, covariance=covariance)


def _yaw(snap: Detection) -> float:
    """In radians from x towards y; 0 without direction."""
    return 0.0 if snap.yaw_deg is None else math.radians(snap.yaw_deg)


def _variances(snap: Detection) -> list[float]:
    """Of x, y, z and the turns about them: the network tells x, y and the turn about z."""
    x, y = [UNKNOWN] * 2 if snap.center_std_mm is None else [(std / 1000) ** 2 for std in snap.center_std_mm]
    has_yaw = snap.yaw_deg is not None and snap.yaw_std_deg is not None
    yaw = math.radians(snap.yaw_std_deg) ** 2 if has_yaw else UNKNOWN
    return [x, y, UNKNOWN, UNKNOWN, UNKNOWN, yaw]
