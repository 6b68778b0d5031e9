"""How the nodes that make frames send them: at a rate, to somebody, and all of them."""

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.publisher import Publisher

_LOOK_S = 0.05
#: Who wants several topics is not discovered on all at once; that was seen to take up to 2.4 s.
_GRACE_S = 3.0
#: How long the last frames may take to be acknowledged before the node says that some were not.
_ACKNOWLEDGE_S = 10.0
_REMINDER_S = 5.0


class Sending:
    """Sends frames at a rate of the node's clock, from when a subscriber is there.

    With `use_sim_time` it waits for the first word of `/clock`, too. Raises
    ExternalShutdownException, out of spin, once the last frame is acknowledged.

    Args:
        node: who sends.
        frames: the publisher that is waited for.
        infos: one that is waited for a little, None where it does not matter.
        rate_hz: frames per second.
        send: sends the frame of a number from 0 on; returns False where there is none left.
        noun: what the log calls frames.
    """

    def __init__(
        self, node: Node, frames: Publisher, infos: Publisher | None, rate_hz: float,
        send: Callable[[int], bool], noun: str,
    ) -> None:
        self._node, self._frames, self._infos = node, frames, infos
        self._rate_hz, self._send, self._noun = rate_hz, send, noun
        self._n_sent, self._until_s = 0, 0.0
        # Steady, as the ROS time may stand still.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_LOOK_S, self._wait_for_subscriber, clock=self._steady)

    def _wait_for_subscriber(self) -> None:
        if self._frames.get_subscription_count() == 0:
            self._remind(f"waiting for a subscriber to {self._frames.topic_name}")
            return
        now_s = time.monotonic()
        self._until_s = self._until_s or now_s + _GRACE_S
        nobody = self._infos is not None and self._infos.get_subscription_count() == 0
        if nobody and now_s < self._until_s:
            return
        clock = self._node.get_clock()
        if clock.ros_time_is_active and clock.now().nanoseconds == 0:
            self._remind("use_sim_time is true, and /clock has not told the time yet: waiting")
            return
        if nobody:
            self._node.get_logger().info("nobody listens to camera_info, starting all the same")
        self._again_every(1 / self._rate_hz, self._send_next, clock)

    def _remind(self, sentence: str) -> None:
        self._node.get_logger().info(
            sentence, throttle_duration_sec=_REMINDER_S, skip_first=True
        )

    def _again_every(self, period_s: float, callback: Callable[[], None], clock: Clock) -> None:
        self._node.destroy_timer(self._timer)
        self._timer = self._node.create_timer(period_s, callback, clock=clock)

    def _send_next(self) -> None:
        if self._send(self._n_sent):
            self._n_sent += 1
            return
        self._until_s = time.monotonic() + _ACKNOWLEDGE_S
        self._again_every(_LOOK_S, self._wait_for_acknowledgement, self._steady)

    def _wait_for_acknowledgement(self) -> None:
        # A longer wait in one piece would hold up signals: rclpy waits without releasing the GIL.
        acknowledged = self._frames.wait_for_all_acked(Duration(seconds=0.01))
        if not acknowledged and time.monotonic() < self._until_s:
            return
        if not acknowledged:
            self._node.get_logger().error(f"the subscriber did not acknowledge all {self._noun}")
        self._node.get_logger().info(f"{self._n_sent} {self._noun} sent")
        raise ExternalShutdownException
