"""The one publisher of identify_node on /diagnostics."""

from collections.abc import Callable, Iterable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

_PERIOD_S = 1.0


class HealthReport:
    """Publishes a node's statuses once a second, whatever the ROS time does.

    Args:
        node: what publishes.
        statuses: called for what there is to say now.
    """

    def __init__(self, node: Node, statuses: Callable[[], Iterable[DiagnosticStatus]]) -> None:
        self._node, self._statuses = node, statuses
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(_PERIOD_S, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _report(self) -> None:
        header = Header(stamp=self._node.get_clock().now().to_msg())
        self._publisher.publish(DiagnosticArray(header=header, status=list(self._statuses())))
