"""What identify_node keeps of its frames: counts, statistics, and lines for the log."""

import time
from collections import Counter

from rclpy.node import Node

from star_tracker.identification.labels import StarState
from star_tracker.nodes.identify.announcements import (
    Announcements,
    Throttle,
    boresight,
    frame_line,
)
from star_tracker.nodes.identify.frame_solver import Answer
from star_tracker.nodes.identify.health import FrameRecord, Health, input_age_s
from star_tracker.nodes.identify.intake import IncomingFrame
from star_tracker.solution import Status


class Journal:
    """The journal of one node.

    Args:
        node: whose log and clock are used.

    Attributes:
        rejected: frames, and centroids of frames, that could not be used, by reason.
        health: the statistics.
        frame_id: of the last frame, empty before the first.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._announcements, self._throttle = Announcements(), Throttle()
        self.rejected: Counter[str] = Counter()
        self.health = Health(time.monotonic())
        self.frame_id = ""

    def refused(self, kind: str, reason: str) -> None:
        """Count what cannot be used, and say why."""
        self.rejected[kind] += 1
        text = self._throttle.passed(kind, reason, time.monotonic())
        if text:
            self._node.get_logger().error(text)

    def read(self, answer: Answer) -> None:
        """Say what a frame told about the camera; count and say what was wrong with it."""
        solution = answer.solution
        for sentence in answer.news:
            self._node.get_logger().info(sentence)
        if solution.status is Status.BAD_INPUT:
            self.refused("bad_centroids", solution.reason)
            return
        self._left_out("ignored_centroids", solution.n_ignored, (
            "are non-finite or outside of the image and were left out: check the camera's size "
            "and the detector"
        ))
        self._left_out("surplus_centroids", solution.n_surplus, (
            "are more than max_centroids and were left out: raise the detector's threshold"
        ))

    def _left_out(self, kind: str, n: int, why: str) -> None:
        """Count centroids that were not searched, and say why."""
        if n == 0:
            return
        self.rejected[kind] += n
        text = self._throttle.passed(kind, f"{n} centroids {why}", time.monotonic())
        if text:
            self._node.get_logger().warning(text)

    def answered(self, frame: IncomingFrame, answer: Answer, in_log: bool) -> None:
        """Enter a frame that has been answered; each one is a line of the log if it says so."""
        solution, logger, now = answer.solution, self._node.get_logger(), time.monotonic()
        self.frame_id = frame.header.frame_id
        state = solution.identification.state
        self.health.add(FrameRecord(
            solution.attitude is not None, f"{solution.status.value}: {solution.reason}",
            solution.mode, 1e3 * (now - frame.received_s),
            input_age_s(frame.stamp_ns, self._node.get_clock().now().nanoseconds), len(state),
            int((state == StarState.UNIDENTIFIED).sum()), answer.hint,
            boresight(solution) if solution.attitude is not None else "",
        ), now)
        line = self._announcements.on_frame(solution, answer.hint, now)
        if in_log:
            logger.info(frame_line(solution))
        if line is not None and line.warns:
            logger.warning(line.text)
        elif line is not None and not in_log:
            logger.info(line.text)
