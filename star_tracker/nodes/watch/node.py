"""The node behind `star_tracker watch`: listens to an identify_node and hands on what it hears."""

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from sensor_msgs.msg import Imu, PointCloud2

from msg_adapters import MessageError
from msg_adapters.attitude import array_from_boresight
from msg_adapters.health import report_from_status
from msg_adapters.imu import orientation_from_imu
from msg_adapters.point_cloud import stars_from_cloud
from msg_adapters.solution import name_from_diagnostics, values_from_diagnostics
from msg_adapters.stamp import nanoseconds_from_header
from star_tracker.nodes.listening import subscribe
from star_tracker.nodes.parameters import ParameterError
from star_tracker.nodes.running import run
from star_tracker.nodes.watch.model import Report, Watched
from star_tracker.nodes.watch.outputs import Output

#: As deep as the publishers' queues: frames of a burst are all heard.
_QUEUE_DEPTH = 50
_LOOK_S = 0.2
_SOLUTION_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


class WatchNode(Node):
    """Subscribes to what the identify_node of a namespace publishes.

    Ends itself, by ExternalShutdownException out of spin, when the output has had enough. Raises
    ParameterError for a namespace that cannot be one.

    Args:
        output: what is told of it.
        namespace: that of the node that is watched.
    """

    def __init__(self, output: Output, namespace: str = "/", **node_options: Any) -> None:
        # Several can watch at once: each has a name of its own.
        name = f"star_tracker_watch_{os.getpid()}"
        try:
            super().__init__(
                name, namespace=namespace, enable_rosout=False, start_parameter_services=False,
                **node_options,
            )
        except InvalidNamespaceException as error:
            raise ParameterError(f"--namespace {namespace} is not one of ROS: {error}") from error
        # Lines of the log would tear the screen.
        self.get_logger().set_level(LoggingSeverity.WARN)
        self.watched = Watched(self.get_namespace())
        #: Namespaces in which something publishes `solution`, looked for at the end.
        self.elsewhere: list[str] = []
        self._output = output
        for kind, topic, read in (
            (DiagnosticArray, "solution", self._on_solution),
            (Imu, "imu", self._on_imu),
            (Vector3Stamped, "boresight_deg", self._on_boresight),
            (PointCloud2, "identified_stars", self._on_stars),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics),
        ):
            subscribe(self, kind, topic, _QUEUE_DEPTH, self._hearing(topic, read))
        self.create_timer(_LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _hearing(
        self, topic: str, read: Callable[[Any, float], None]
    ) -> Callable[[Any, Mapping[str, Any]], None]:
        """Return a callback that tells of a message that cannot be read, and hears on."""

        def hear(message: Any, _: Mapping[str, Any]) -> None:
            now_s = time.monotonic()
            try:
                read(message, now_s)
            except MessageError as error:
                self.watched.trouble = f"{topic}: {error}"
            self._hand_on(now_s)

        return hear

    def _on_solution(self, message: DiagnosticArray, now_s: float) -> None:
        self.watched.on_solution(
            nanoseconds_from_header(message.header), name_from_diagnostics(message),
            values_from_diagnostics(message), now_s,
        )

    def _on_imu(self, message: Imu, now_s: float) -> None:
        quaternion, covariance = orientation_from_imu(message)
        if not np.any(quaternion):
            raise MessageError("the orientation is no rotation")
        stamp_ns = nanoseconds_from_header(message.header)
        self.watched.on_orientation(stamp_ns, (quaternion, covariance), now_s)

    def _on_boresight(self, message: Vector3Stamped, now_s: float) -> None:
        stamp_ns = nanoseconds_from_header(message.header)
        self.watched.on_boresight(stamp_ns, array_from_boresight(message), now_s)

    def _on_stars(self, message: PointCloud2, now_s: float) -> None:
        stamp_ns = nanoseconds_from_header(message.header)
        self.watched.on_stars(stamp_ns, stars_from_cloud(message), now_s)

    def _on_diagnostics(self, message: DiagnosticArray, now_s: float) -> None:
        for status in message.status:
            self.watched.on_report(status.name, Report(*report_from_status(status)), now_s)

    def _hand_on(self, now_s: float) -> None:
        for frame in self.watched.take(now_s):
            self._output.frame(self.watched, frame)

    def _look(self) -> None:
        now_s = time.monotonic()
        self._hand_on(now_s)
        if not self._output.look(self.watched, now_s):
            self.elsewhere = self._look_around()
            raise ExternalShutdownException

    def _look_around(self) -> list[str]:
        return sorted(
            topic.removesuffix("/solution") or "/"
            for topic, kinds in self.get_topic_names_and_types()
            if topic.endswith("/solution") and _SOLUTION_TYPE in kinds
            and self.count_publishers(topic)
        )


def watch(output: Output, namespace: str) -> tuple[int, list[str]]:
    """Watch until told to stop or the output has had enough.

    Returns the exit code and, in the second case, the namespaces that have a node to watch.
    """
    made: list[WatchNode] = []

    def make() -> WatchNode:
        made.append(WatchNode(output, namespace))
        return made[0]

    # No arguments: those of the command are not for ROS.
    code = run("star_tracker watch", make, [])
    return code, made[0].elsewhere if made else []
