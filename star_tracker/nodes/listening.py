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
    _subscribe(node, _Topic(kind, topic, depth, False, callback, on_publishers))


def subscribe_latched(
    node: Node, kind: Any, topic: str, depth: int,
    callback: Callable[[Any, Mapping[str, Any]], None],
) -> None:
    """Subscribe as `subscribe`, and hear what a publisher keeps for those that come later."""
    _subscribe(node, _Topic(kind, topic, depth, True, callback))


def _subscribe(node: Node, topic: _Topic) -> None:
    """Subscribe, and again where the publishers that there are by then need another QoS.

    BEST_AVAILABLE is settled when the subscription is made, as the stricter policy where no
    publisher is known yet. One with the laxer policy that appears later does not match then, but
    announces itself as incompatible: subscribing again settles it anew, with that publisher known.
    For durability it is the other way round, lest each camera that starts later should complain:
    without a publisher it is VOLATILE, until one comes that keeps its messages.
    """
    settled: dict[str, bool] = {}

    def settle(qos: QoSProfile) -> SetParametersResult:
        settled["best"] = qos.durability == _BEST  # unless a user has overridden it
        if settled["best"] and not node.get_publishers_info_by_topic(name):
            qos.durability = DurabilityPolicy.VOLATILE
        return SetParametersResult(successful=True)

    def again() -> None:
        node.destroy_subscription(subscription)
        _subscribe(node, topic)

    def incompatible(_: Any) -> None:
        node.get_logger().info(f"{topic.name}: subscribing again for a publisher of another QoS")
        again()

    def matched(info: Any) -> None:
        if topic.on_publishers is not None:
            topic.on_publishers(int(info.current_count))
        came = info.current_count_change > 0
        if came and settled["best"] and _misses_what_is_kept(node, name):
            again()

    name = node.resolve_topic_name(topic.name)
    events = SubscriptionEventCallbacks(incompatible_qos=incompatible, matched=matched)
    subscription = node.create_subscription(
        topic.kind, topic.name, topic.callback, topic.qos(), event_callbacks=events,
        qos_overriding_options=QoSOverridingOptions(_SUBSCRIBED, callback=settle),
    )


def _misses_what_is_kept(node: Node, name: str) -> bool:
    """Return whether all publishers of a topic keep messages that this node did not ask for."""
    me = (node.get_name(), node.get_namespace())
    mine = [
        info.qos_profile.durability for info in node.get_subscriptions_info_by_topic(name)
        if (info.node_name, info.node_namespace) == me
    ]
    theirs = [info.qos_profile.durability for info in node.get_publishers_info_by_topic(name)]
    kept = all(one == DurabilityPolicy.TRANSIENT_LOCAL for one in theirs)
    return kept and DurabilityPolicy.VOLATILE in mine
