"""Topics of the nodes: subscriptions that hear every publisher, and QoS that a user may set."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from star_tracker.nodes.declaring import ParameterError

#: What may be overridden: `qos_overrides./TOPIC.publisher.reliability` and so on. The depth of a
#: subscription is a parameter of the node's own, where that makes sense.
PUBLISHED = QoSOverridingOptions(
    (QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.RELIABILITY)
)
#: Longer in the queue than that, and the wall clock has jumped or the middleware gives no time.
_LONGEST_QUEUED_S = 60.0
_BEST = DurabilityPolicy.BEST_AVAILABLE
_SUBSCRIBED = (QoSPolicyKind.DURABILITY, QoSPolicyKind.RELIABILITY)


@contextmanager
def overrides_checked() -> Iterator[None]:
    """Raise ParameterError where topics are made with a QoS that is overridden by what is none."""
    try:
        yield
    except (InvalidQosOverridesError, ParameterException) as error:
        raise ParameterError(str(error)) from error
    except RuntimeError as error:  # what rclpy raises for the name of a policy
        if "QoS override" not in str(error):
            raise
        raise ParameterError(str(error)) from error


def received_s(info: Mapping[str, Any]) -> float:
    """Return when the middleware received a message, s of `time.monotonic`.

    Args:
        info: what the middleware knows of the message.
    """
    queued_s = (time.time_ns() - (info.get("received_timestamp") or 0)) / 1e9
    return time.monotonic() - (queued_s if 0.0 <= queued_s <= _LONGEST_QUEUED_S else 0.0)


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


@dataclass(frozen=True)
class _Topic:
    """What a subscription is made of, and made again of."""

    kind: Any
    name: str
    depth: int
    latched: bool
    callback: Callable[[Any, Mapping[str, Any]], None]
    on_publishers: Callable[[int], None] | None = None

    def qos(self) -> QoSProfile:
        return QoSProfile(
            depth=self.depth, reliability=ReliabilityPolicy.BEST_AVAILABLE,
            durability=_BEST if self.latched else DurabilityPolicy.VOLATILE,
        )

    def qos_of_what_is_kept(self) -> QoSProfile:
        return QoSProfile(
            depth=self.depth, reliability=ReliabilityPolicy.BEST_AVAILABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )


def subscribe(
    node: Node, kind: Any, topic: str, depth: int,
    callback: Callable[[Any, Mapping[str, Any]], None], *,
    on_publishers: Callable[[int], None] | None = None,
) -> None:
    """Subscribe so that reliable and best-effort publishers both connect.

    Args:
        node: who listens.
        kind: type of the messages.
        topic: relative name.
        depth: how many messages wait at most; the newest ones stay.
        callback: called with a message and what the middleware knows of it.
        on_publishers: called with the number of publishers when it has changed.
    """
    _Subscription(node, _Topic(kind, topic, depth, False, callback, on_publishers))


def subscribe_latched(
    node: Node, kind: Any, topic: str, depth: int,
    callback: Callable[[Any, Mapping[str, Any]], None],
) -> None:
    """Subscribe as `subscribe`, and hear what a publisher keeps for those that come later."""
    _Subscription(node, _Topic(kind, topic, depth, True, callback))


class _Subscription:
    """A subscription that is made again where the publishers there are by then need another QoS.

    BEST_AVAILABLE is settled when the subscription is made, as the stricter policy where no
    publisher is known yet. One with the laxer policy that appears later does not match then, but
    announces itself as incompatible: subscribing again settles it anew, with that publisher known.
    For durability it is the other way round, lest each camera that starts later should complain:
    without a publisher it is VOLATILE, until one comes that keeps its messages. Where some keep
    them and others do not, what is kept comes over a second subscription.
    """

    def __init__(self, node: Node, topic: _Topic) -> None:
        self._node, self._topic = node, topic
        self._name = node.resolve_topic_name(topic.name)
        self._second: Any = None
        self._is_best = False
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._on_incompatible, matched=self._on_matched
        )
        self._subscription = node.create_subscription(
            topic.kind, topic.name, topic.callback, topic.qos(), event_callbacks=events,
            qos_overriding_options=QoSOverridingOptions(_SUBSCRIBED, callback=self._settle),
        )

    def _settle(self, qos: QoSProfile) -> SetParametersResult:
        self._is_best = qos.durability == _BEST  # unless a user has overridden it
        if self._is_best and not self._node.get_publishers_info_by_topic(self._name):
            qos.durability = DurabilityPolicy.VOLATILE
        return SetParametersResult(successful=True)

    def _again(self) -> None:
        self._node.destroy_subscription(self._subscription)
        if self._second is not None:
            self._node.destroy_subscription(self._second)
        _Subscription(self._node, self._topic)

    def _on_incompatible(self, _: Any) -> None:
        self._node.get_logger().info(
            f"{self._topic.name}: subscribing again for a publisher of another QoS"
        )
        self._again()

    def _on_matched(self, info: Any) -> None:
        if self._topic.on_publishers is not None:
            self._topic.on_publishers(int(info.current_count))
        if info.current_count_change <= 0 or not self._is_best or self._second is not None:
            return
        kept, all_keep = _keeping(self._node, self._name)
        if kept and all_keep:
            self._again()
        elif kept:
            self._hear_what_is_kept()

    def _hear_what_is_kept(self) -> None:
        topic = self._topic
        # Those that keep nothing are incompatible with it, which is all right.
        events = SubscriptionEventCallbacks(incompatible_qos=lambda _: None)
        self._second = self._node.create_subscription(
            topic.kind, topic.name, topic.callback, topic.qos_of_what_is_kept(),
            event_callbacks=events,
        )


def _keeping(node: Node, name: str) -> tuple[bool, bool]:
    """Return whether some publishers keep messages that this node does not hear, and whether all.

    It hears them where it did not ask for VOLATILE.
    """
    me = (node.get_name(), node.get_namespace())
    mine = [
        info.qos_profile.durability for info in node.get_subscriptions_info_by_topic(name)
        if (info.node_name, info.node_namespace) == me
    ]
    keep = [
        info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        for info in node.get_publishers_info_by_topic(name)
    ]
    return any(keep) and DurabilityPolicy.VOLATILE in mine, all(keep)
