"""Subscriptions that hear publishers of either reliability, and count what they miss."""

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy


class DropCounter:
    """Counts messages that were published but never taken, by the publisher's sequence numbers.

    A queue that is full loses its oldest message, whatever the middleware: no event tells of it.
    Numbers of several publishers cannot be told apart, so that with more than one nothing counts.
    """

    def __init__(self) -> None:
        self.n_dropped = 0
        self._n_publishers = 0
        self._last: int | None = None

    def on_publishers(self, n_publishers: int) -> None:
        """Start anew with other publishers."""
        if n_publishers != self._n_publishers:
            self._n_publishers, self._last = n_publishers, None

    def on_message(self, sequence: int | None) -> None:
        """Take in the sequence number of a message; None where the middleware gives none."""
        if sequence is None:
            return
        if self._last is not None and self._n_publishers == 1:
            self.n_dropped += max(0, sequence - self._last - 1)
        self._last = sequence


def subscribe(
    node: Node, kind: Any, topic: str, depth: int,
    callback: Callable[[Any, Mapping[str, Any]], None], *,
    on_publishers: Callable[[int], None] | None = None,
) -> None:
    """Subscribe so that reliable and best-effort publishers both connect.

    BEST_AVAILABLE is settled when the subscription is made, as RELIABLE where no publisher is
    known yet. A best-effort publisher that appears later does not match then, but announces
    itself as incompatible; subscribing again settles it anew, with that publisher known.

    Args:
        node: who listens.
        kind: type of the messages.
        topic: relative name.
        depth: how many messages wait at most; the newest ones stay.
        callback: called with a message and what the middleware knows of it.
        on_publishers: called with the number of publishers when it has changed.
    """

    def subscribe_again(_: Any) -> None:
        node.get_logger().info(f"{topic}: subscribing again for a best-effort publisher")
        node.destroy_subscription(subscription)
        subscribe(node, kind, topic, depth, callback, on_publishers=on_publishers)

    def matched(info: Any) -> None:
        if on_publishers is not None:
            on_publishers(int(info.current_count))

    qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_AVAILABLE)
    events = SubscriptionEventCallbacks(incompatible_qos=subscribe_again, matched=matched)
    subscription = node.create_subscription(kind, topic, callback, qos, event_callbacks=events)
