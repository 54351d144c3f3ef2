"""`SnapNode`: images in; detections, poses, drawn images and diagnostics out."""

import sys
import time
from typing import Any, NamedTuple

import numpy as np
import rclpy
import smr_gpu
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_policy_name_from_kind, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image
from vision_msgs.msg import Detection2DArray

from smr_gpu_ros import messages, parameters, pictures
from smr_gpu_ros.running import until_interrupted
from smr_gpu_ros.status import Status
from smr_gpu_ros.worker import Worker

# Seconds between two lines about images without an answer.
_THROTTLE_S = 5.0


class _Job(NamedTuple):
    message: Image | CompressedImage
    came_s: float


class _NoDetector(Exception):
    """No image can be answered; says why."""


class SnapNode(Node):
    """Looks for snaps in each image that comes.

    The executor takes images and changes parameters; a thread of the node's own looks at the images and publishes.

    Raises:
        rclpy.exceptions.InvalidParameterValueException: a parameter from outside is out of its range.
        rclpy.exceptions.InvalidParameterTypeException: it has another type.
    """

    def __init__(self) -> None:
        super().__init__("smr_gpu_node")
        self._worker: Worker[_Job] | None = None
        parameters.declare(self)
        self._values = parameters.values(self)
        self._detector: smr_gpu.Detector | None = None
        self._candidate: smr_gpu.Detector | None = None
        self._problem = ""
        self._assumption = ""
        self._scale = ""
        self._status = Status()
        try:
            self._use(parameters.detector(self._values))
        except smr_gpu.Error as error:
            self._problem = f"no detector: {error}"
            self.get_logger().error(f"{self._problem}; a change of parameters may bring one")

        self._detections = self._publisher(Detection2DArray, "detections", 10)
        self._poses = self._publisher(PoseWithCovarianceStamped, "poses", 100)
        self._drawn = self._publisher(Image, "drawn", qos_profile_sensor_data)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._worker = Worker(self._look, self._room())
        if self._values["image_transport"] != "compressed":
            self._subscribe(Image, "image")
        if self._values["image_transport"] != "raw":
            self._subscribe(CompressedImage, "image/compressed")
        self.create_timer(1.0, self._report)
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._take_over)

    def destroy_node(self) -> None:
        """Ends the thread, then the node; also one whose parameters were refused."""
        if self._worker is not None:
            self._worker.stop()
        super().destroy_node()

    # Images

    def _look(self, job: _Job) -> None:
        try:
            self._answer(job)
        except (pictures.Unreadable, smr_gpu.Error, _NoDetector) as error:
            self._fail(str(error))
        # Whatever it is, the next image may be better.
        except Exception as error:
            if self.context.ok():
                self._fail(repr(error))

    def _answer(self, job: _Job) -> None:
        detector, header = self._detector, job.message.header
        if detector is None:
            raise _NoDetector(self._problem)
        picture, order = pictures.read(job.message)
        found = detector(picture, order=order)
        self._assumption = found.assumption or ""
        self._scale = f"{found.mm_per_pixel:.6g} ({found.scale_from})"
        self._detections.publish(messages.detections(found, header))
        for pose in messages.poses(found, header.stamp, self._values["gel_frame"]):
            self._poses.publish(pose)
        self._status.answered(time.monotonic() - job.came_s)
        if self._drawn.get_subscription_count():
            drawn = found.plot(pictures.to_rgb(picture, order))
            self._drawn.publish(messages.image(np.asarray(drawn), header))
            self._status.drew()

    def _fail(self, error: str) -> None:
        self._status.failed(error)
        self.get_logger().warning(f"an image has no answer: {error}", throttle_duration_sec=_THROTTLE_S)

    def _room(self) -> int:
        return 1 if self._values["latest_only"] else self._values["queue_size"]

    # Parameters

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        """Builds the detector of the new values, if they need one: that it can be built is what makes them right."""
        if parameters.need_detector({change.name for change in changes}):
            try:
                self._candidate = parameters.detector(self._with(changes))
            except smr_gpu.Error as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_over(self, changes: list[Parameter]) -> None:
        self._values = self._with(changes)
        self._worker.set_room(self._room())
        if self._candidate is not None:
            self._use(self._candidate)
            self._candidate = None

    def _with(self, changes: list[Parameter]) -> dict[str, Any]:
        return self._values | {change.name: change.value for change in changes}

    def _use(self, detector: smr_gpu.Detector) -> None:
        self._detector, self._problem = detector, ""
        for remark in [repr(detector), *detector.remarks]:
            self.get_logger().info(remark)

    # Topics

    def _publisher(self, kind: type, topic: str, qos: QoSProfile | int) -> Publisher:
        events = PublisherEventCallbacks(incompatible_qos=lambda event: self._mismatch(topic, "publisher", event))
        options = QoSOverridingOptions.with_default_policies()
        return self.create_publisher(kind, topic, qos, event_callbacks=events, qos_overriding_options=options)

    def _subscribe(self, kind: type, topic: str) -> None:
        def take(message: Any) -> None:
            self._status.received()
            self._worker.put(_Job(message, time.monotonic()))

        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._mismatch(topic, "subscription", event),
            message_lost=lambda event: self._status.lost(event.total_count_change),
        )
        options = QoSOverridingOptions.with_default_policies()
        self.create_subscription(
            kind, topic, take, qos_profile_sensor_data, event_callbacks=events, qos_overriding_options=options
        )

    def _mismatch(self, topic: str, side: str, event: Any) -> None:
        """Tells that nothing flows between this node and a peer, and what to do about it."""
        topic, policy = self.resolve_topic_name(topic), qos_policy_name_from_kind(event.last_policy_kind)
        fault = f"{topic}: a subscriber asks for more {policy} than this node offers, and gets nothing."
        remedy, other = "Subscribe best effort (qos_profile_sensor_data)", "reliable"
        if side == "subscription":
            fault = f"{topic}: this node asks for more {policy} than a publisher offers, and gets nothing."
            remedy, other = "Publish reliable", "best_effort"
        if policy == "RELIABILITY":
            fault += f" {remedy}, or start this node with -p qos_overrides.{topic}.{side}.reliability:={other}"
        else:
            fault += f" See `ros2 topic info --verbose {topic}`"
        self._status.fault(fault)
        self.get_logger().warning(fault)

    def _report(self) -> None:
        facts = {name: str(self._values[name]) for name in ("weights", "sensor")}
        facts |= {"device": self._detector.adapter if self._detector else "", "mm a pixel": self._scale}
        status = self._status.report(self._worker.dropped, self._problem, self._assumption, facts)
        status.name, status.hardware_id = f"{self.get_fully_qualified_name()[1:]}: snaps", facts["sensor"] or "sensor"
        report = DiagnosticArray(status=[status])
        report.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(report)


def main() -> int:
    """Runs the node until it is interrupted."""
    try:
        with until_interrupted():
            node = SnapNode()
            try:
                rclpy.spin(node)
            finally:
                node.destroy_node()
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        print(f"smr_gpu_node: {error}", file=sys.stderr)
        return 2
    return 0
