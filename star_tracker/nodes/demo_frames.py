"""What the demo is made of: processes, what comes of a frame, and its row of the table."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from numpy.typing import NDArray
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2

from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters.attitude import array_from_boresight
from star_tracker.msg_adapters.point_cloud import stars_from_cloud
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.msg_adapters.stamp import nanoseconds_from_header

#: Of each wait for a process.
TIMEOUT_S = 60.0
_TERMINATE_S = 10.0


@dataclass(frozen=True)
class Result:
    """What was published for one frame; the boresight (RA, Dec, roll, deg) only if solved."""

    values: dict[str, str]
    stars: NDArray[np.void]
    boresight_deg: Floats | None


@dataclass(frozen=True)
class Row:
    """A frame's graded result. `faults` is empty where all is right."""

    cells: tuple[str, ...]
    n_right: int
    n_identified: int
    n_displaced: int
    faults: tuple[str, ...]


class Collector(Node):
    """Gathers the outputs of identify_node by stamp until `expected` frames are complete."""

    def __init__(self, expected: int) -> None:
        super().__init__("star_tracker_demo")
        self.connected, self.complete = Future(), Future()
        self._expected = expected
        self._values: dict[int, dict[str, str]] = {}
        self._stars: dict[int, NDArray[np.void]] = {}
        self._boresight: dict[int, Floats] = {}
        self._matched: set[str] = set()
        for kind, topic, take in (
            (DiagnosticArray, "solution", self._on_solution),
            (PointCloud2, "identified_stars", self._on_stars),
            (Vector3Stamped, "boresight_deg", self._on_boresight),
        ):
            events = SubscriptionEventCallbacks(
                matched=lambda info, topic=topic: self._on_match(topic, info.current_count)
            )
            self.create_subscription(kind, topic, take, 50, event_callbacks=events)

    @property
    def results(self) -> list[Result]:
        """The complete frames in the order of their stamps."""
        return [
            Result(self._values[stamp], self._stars[stamp], self._boresight.get(stamp))
            for stamp in sorted(self._values) if stamp in self._stars
        ]

    def _on_match(self, topic: str, count: int) -> None:
        if count > 0:
            self._matched.add(topic)
        if len(self._matched) == 3 and not self.connected.done():
            self.connected.set_result(True)

    def _on_solution(self, message: DiagnosticArray) -> None:
        self._values[nanoseconds_from_header(message.header)] = values_from_diagnostics(message)
        self._look()

    def _on_stars(self, message: PointCloud2) -> None:
        self._stars[nanoseconds_from_header(message.header)] = stars_from_cloud(message)
        self._look()

    def _on_boresight(self, message: Vector3Stamped) -> None:
        self._boresight[nanoseconds_from_header(message.header)] = array_from_boresight(message)
        self._look()

    def _look(self) -> None:
        solved = {s for s, values in self._values.items() if values["status"] == "SOLVED"}
        finished = len(self.results) >= self._expected and solved <= set(self._boresight)
        if finished and not self.complete.done():
            self.complete.set_result(True)


@contextmanager
def process(node: str, arguments: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node in a process of its own and end it on leaving."""
    running = subprocess.Popen(
        [sys.executable, "-m", f"star_tracker.nodes.{node}", "--ros-args", *arguments]
    )
    try:
        yield running
    finally:
        running.terminate()
        try:
            running.wait(timeout=_TERMINATE_S)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()
