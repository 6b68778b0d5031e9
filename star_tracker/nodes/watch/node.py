"""The node behind `star_tracker watch`: listens to an identify_node and shows what it hears."""

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from sensor_msgs.msg import Imu, PointCloud2

from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.health import report_from_status
from star_tracker.msg_adapters.imu import orientation_from_imu
from star_tracker.msg_adapters.point_cloud import stars_from_cloud
from star_tracker.msg_adapters.solution import name_from_diagnostics, values_from_diagnostics
from star_tracker.msg_adapters.stamp import nanoseconds_from_header
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.listening import subscribe
from star_tracker.nodes.running import run
from star_tracker.nodes.watch.outputs import Output
from star_tracker.nodes.watch.state import Frame, Report, Watched, attitude_from_orientation

#: As deep as the publishers' queues: frames of a burst are all heard.
_QUEUE_DEPTH = 50
_LOOK_S = 0.2


class WatchNode(Node):
    """Subscribes to what the identify_node of a namespace publishes.

    Ends by ExternalShutdownException out of spin when the output needs no more. Raises
    ParameterError for a namespace that cannot be one.
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
        self._output = output
        self._hear(DiagnosticArray, "solution", self._on_solution)
        self._hear(Imu, "imu", self._on_imu)
        self._hear(PointCloud2, "identified_stars", self._on_stars)
        self._hear(DiagnosticArray, "/diagnostics", self._on_diagnostics)
        self.create_timer(_LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _hear(self, kind: Any, topic: str, read: Callable[[Any], None]) -> None:
        """Subscribe; a message that cannot be read is shown, and the next one is heard."""

        def take(message: Any, _: Mapping[str, Any]) -> None:
            try:
                read(message)
            except (MessageError, ValueError) as error:
                self.watched.trouble = f"{topic}: {error}"

        subscribe(self, kind, topic, _QUEUE_DEPTH, take)

    def _frame(self, message: Any) -> Frame:
        return self.watched.arriving(nanoseconds_from_header(message.header), time.monotonic())

    def _on_solution(self, message: DiagnosticArray) -> None:
        self.watched.name = name_from_diagnostics(message)
        self._frame(message).values = values_from_diagnostics(message)

    def _on_imu(self, message: Imu) -> None:
        self._frame(message).attitude = attitude_from_orientation(*orientation_from_imu(message))

    def _on_stars(self, message: PointCloud2) -> None:
        self._frame(message).stars = stars_from_cloud(message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            report = Report(*report_from_status(status), heard_s=time.monotonic())
            self.watched.on_report(status.name, report)

    def _look(self) -> None:
        now_s = time.monotonic()
        if not self._output(self.watched, self.watched.take(now_s), now_s):
            raise ExternalShutdownException


def watch(output: Output, namespace: str) -> int:
    """Watch until told to stop or the output needs no more; return the exit code."""
    # No arguments: those of the command are not for ROS.
    return run("star_tracker watch", lambda: WatchNode(output, namespace), [])
