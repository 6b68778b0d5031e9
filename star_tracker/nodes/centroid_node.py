"""centroid_node: images in, centroids of their stars out."""

import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from star_tracker.commands.compile import exercise_detector
from star_tracker.msg_adapters.detected_stars import cloud_from_detected
from star_tracker.msg_adapters.health import status_from_health
from star_tracker.nodes.centroid.detector import Detection, Detector, IncomingImage
from star_tracker.nodes.centroid.health import ImageHealth
from star_tracker.nodes.centroid.parameters import (
    CENTROID_PARAMETERS,
    TOPICS,
    CentroidParameters,
)
from star_tracker.nodes.centroid.worker import Worker
from star_tracker.nodes.declaring import (
    DeclaringNode,
    Parameter,
    ParameterError,
    declare,
    unknown_parameters,
)
from star_tracker.nodes.identify.announcements import Throttle
from star_tracker.nodes.identify.health import DiagnosticsPublisher
from star_tracker.nodes.listening import (
    PUBLISHED,
    DropCounter,
    overrides_checked,
    received_s,
    subscribe,
)
from star_tracker.nodes.running import run
from star_tracker.resources import package_version

_TABLE = {parameter.name: parameter for parameter in CENTROID_PARAMETERS}
_KINDS = {"raw": Image, "compressed": CompressedImage}
_QUEUE_DEPTH = 10


class CentroidNode(DeclaringNode):
    """Publishes the stars of each image of `image` as `centroids`, under the image's own header.

    Images are looked at in a thread. One that comes meanwhile waits, and is dropped for a newer
    one. What cannot be read is counted and said in the log; what can be read and shows nothing is
    answered by no centroids. Raises ParameterError for a configuration that cannot be used.

    Args:
        hand_over: called with each message of `centroids`, in the node's executor, besides
            publishing it: for who works in the same process.
        neighbours: parameters of that one.
    """

    _worker: Worker | None = None

    def __init__(
        self, *, hand_over: Callable[[PointCloud2], None] | None = None,
        neighbours: Sequence[Parameter] = (), **node_options: Any,
    ) -> None:
        super().__init__(
            "centroid_node", automatically_declare_parameters_from_overrides=True, **node_options
        )
        self._hand_over = hand_over
        try:
            self._told, given = declare(self, CentroidParameters)
            self._detector = Detector(self._told.settings, self._told.companions())
            self._health, self._throttle = ImageHealth(time.monotonic()), Throttle()
            self._drops, self._frame_id = DropCounter(), ""
            self._detected: deque[Detection] = deque()
            self._wake = self.create_guard_condition(self._on_detected)
            self._make_topics()
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        for sentence in unknown_parameters(self, given, neighbours):
            self.get_logger().warning(sentence)
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._take_over)
        self._worker = Worker(exercise_detector, self._detect, self._pass_on)
        self.get_logger().info(
            f"stars of {self.resolve_topic_name(self._topic)} become centroids on "
            f"{self._centroids.topic_name}, counted from the first pixel's "
            f"{self._told.pixel_origin}"
        )

    def _make_topics(self) -> None:
        """Make all that stands in the graph. Raises ParameterError."""
        self._topic = TOPICS[self._told.image_transport]
        with overrides_checked():
            self._centroids = self.create_publisher(
                PointCloud2, "centroids", _QUEUE_DEPTH, qos_overriding_options=PUBLISHED
            )
            subscribe(
                self, _KINDS[self._told.image_transport], self._topic, 1, self._on_image,
                on_publishers=self._drops.on_publishers,
            )
        DiagnosticsPublisher(self, self._statuses)

    @property
    def health(self) -> ImageHealth:
        """Counts and statistics of the images."""
        self._health.n_dropped = self._drops.n_dropped + (
            self._worker.n_overtaken if self._worker else 0
        )
        return self._health

    @property
    def ready(self) -> bool:
        """Whether images are looked at: the detector has been compiled or loaded."""
        return self._worker is not None and self._worker.ready

    def destroy_node(self) -> None:
        """End the thread, then the node."""
        if self._worker is not None:
            self._worker.finish()
        super().destroy_node()

    def _on_image(self, message: Image | CompressedImage, info: Mapping[str, Any]) -> None:
        self._drops.on_message(info.get("publication_sequence_number"))
        if self._worker is not None:
            self._worker.put(IncomingImage(message, received_s(info)))

    def _detect(self, image: IncomingImage) -> Detection:
        """Detect, in the thread, as the parameters are by then."""
        return self._detector.detect(image)

    def _pass_on(self, detection: Detection) -> None:
        """Hand what the thread has found to the executor."""
        self._detected.append(detection)
        self._wake.trigger()

    def _on_detected(self) -> None:
        while self._detected:
            detection = self._detected.popleft()
            if detection.stars is not None:
                cloud = cloud_from_detected(
                    detection.stars, detection.image.header, pixel_origin=self._told.pixel_origin
                )
                self._centroids.publish(cloud)
                if self._hand_over is not None:
                    self._hand_over(cloud)
            self._frame_id = detection.image.header.frame_id
            self._health.add(detection, time.monotonic())
            if detection.kind:
                text = self._throttle.passed(detection.kind, detection.trouble, time.monotonic())
                if text:
                    self.get_logger().error(text)

    def _with(self, parameters: Sequence[RosParameter]) -> CentroidParameters:
        """Return what the node is told with changes. Raises ParameterError."""
        return replace(self._told, **{
            p.name: _TABLE[p.name].checked(p.value) for p in parameters if p.name in _TABLE
        })

    def _check(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            self._with(parameters)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: Sequence[RosParameter]) -> None:
        self._told = self._with(parameters)
        self._detector = replace(self._detector, settings=self._told.settings)

    def _statuses(self) -> Iterator[DiagnosticStatus]:
        """Yield what /diagnostics carries."""
        level, message, values = self.health.report(time.monotonic())
        if not self.ready:
            level, message = "warn", "starting: loading or compiling the detector"
        # Without the first slash, of which the diagnostics' aggregator would make a blank.
        name = self.get_fully_qualified_name().lstrip("/")
        status = status_from_health(
            f"{name}: images", level, message, {**values, "version": package_version()}
        )
        status.hardware_id = self._frame_id or name
        yield status


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("centroid_node", CentroidNode, args)


if __name__ == "__main__":
    sys.exit(main())
