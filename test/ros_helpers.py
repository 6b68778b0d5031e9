"""A bench for nodes: one process, one thread, and waits that end on an event.

A bench has a context and a namespace of its own, the node under test and a probe node that talks
to it. `until` spins both and looks at its condition after each event that the probe notices.
"""

import functools
import itertools
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from waiting import longest_s

from star_tracker.msg_adapters.point_cloud import Centroids, cloud_from_centroids, stars_from_cloud
from star_tracker.msg_adapters.solution import values_from_diagnostics

#: What most tests tell identify_node: the paper's stars and a camera that needs no learning.
PAPER_CAMERA = {
    "fov_deg": 12.0, "fov_tolerance_percent": 0.0, "width_px": 512, "height_px": 512,
    "parity": "normal", "catalog": "paper", "camera_info_tolerance_percent": 0.0,
}
#: Deep enough for every burst of the tests.
DEPTH = 200
_numbers = itertools.count(1)


def stamp_ns(header):
    """Return a header's stamp in nanoseconds."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def new_header(frame_id="camera"):
    """Return a header whose stamp no other header has; later ones are younger."""
    header = Header(frame_id=frame_id)
    header.stamp.sec, header.stamp.nanosec = 1_000 + next(_numbers), 250_000_000
    return header


def frame_of(xy_px, header=None):
    """Return the message of a frame with these centroids (n, 2)."""
    return cloud_from_centroids(Centroids(xy_px), header or new_header())


def array_from_quaternion(message):
    """Return the quaternion (4,) of a QuaternionStamped, order x, y, z, w."""
    q = message.quaternion
    return np.array([q.x, q.y, q.z, q.w])


def health_from_diagnostics(message, name):
    """Return the keys and values of the status of this name in a DiagnosticArray."""
    (status,) = [status for status in message.status if status.name == name]
    return {pair.key: pair.value for pair in status.values}


@dataclass
class Inbox:
    """The messages of a topic in order of arrival; `n_publishers` are connected now."""

    messages: list = field(default_factory=list)
    n_publishers: int = 0

    def at(self, stamp):
        """Return the messages with this stamp, nanoseconds."""
        return [message for message in self.messages if stamp_ns(message.header) == stamp]


@dataclass
class Outbox:
    """A publisher of the probe; `n_subscribers` are connected now."""

    publisher: Publisher
    n_subscribers: int = 0

    def publish(self, message):
        self.publisher.publish(message)


class Bench:
    """The node under test and a probe. Use `open_bench`, which also cleans up."""

    def __init__(self):
        self.namespace = f"/bench{next(_numbers)}"
        self.context = Context()
        rclpy.init(context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self._nodes = []
        self.probe = self._add(Node(
            "probe", context=self.context, namespace=self.namespace, enable_rosout=False,
            start_parameter_services=False,
        ))
        self.node = None
        self._lookouts = []

    def close(self):
        """Destroy the nodes and the context."""
        self.executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        self.context.try_shutdown()

    def start(self, make, parameters=None, **options):
        """Make the node under test with parameters given by name.

        identify_node is told the paper's camera of 12 deg, exactly, unless they say otherwise.
        """
        is_identify = make.__name__ == "IdentifyNode" and "cli_args" not in options
        told = PAPER_CAMERA if is_identify else {}
        overrides = [
            Parameter(name, value=value) for name, value in {**told, **(parameters or {})}.items()
        ]
        self.node = self._add(make(
            context=self.context, namespace=self.namespace, parameter_overrides=overrides,
            **options,
        ))
        return self.node

    def until(self, condition, what):
        """Spin until `condition()` is true; it is looked at after each event."""
        future = Future(executor=self.executor)

        def look():
            if not future.done() and condition():
                future.set_result(True)

        self._lookouts.append(look)
        try:
            look()
            self.executor.spin_until_future_complete(future, timeout_sec=longest_s())
        finally:
            self._lookouts.remove(look)
        assert future.done(), f"no {what}"

    def outbox(
        self, kind, topic, reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
    ):
        """Publish a topic of the node under test, which need not be there yet."""

        def matched(info):
            outbox.n_subscribers = info.current_count
            self._event()

        outbox = Outbox(self.probe.create_publisher(
            kind, topic,
            QoSProfile(depth=DEPTH, reliability=reliability, durability=durability),
            event_callbacks=PublisherEventCallbacks(matched=matched),
        ))
        return outbox

    def connected_outbox(self, kind, topic, *qos):
        """Publish a topic and wait until the node under test listens."""
        outbox = self.outbox(kind, topic, *qos)
        self.until(lambda: outbox.n_subscribers, f"subscriber to {topic}")
        return outbox

    def inbox(self, kind, topic, reliability=ReliabilityPolicy.RELIABLE):
        """Subscribe to a topic of the node under test, which need not be there yet."""
        inbox = Inbox()

        def take(message):
            inbox.messages.append(message)
            self._event()

        def matched(info):
            inbox.n_publishers = info.current_count
            self._event()

        self.probe.create_subscription(
            kind, topic, take, QoSProfile(depth=DEPTH, reliability=reliability),
            event_callbacks=SubscriptionEventCallbacks(matched=matched),
        )
        return inbox

    def calls_of(self, topic):
        """Return a list that grows with each message of a topic that the node has taken."""
        return self.count_calls(next(
            s for s in self.node.subscriptions if s.topic_name == f"{self.namespace}/{topic}"
        ))

    def until_true(self, condition, what):
        """Spin until `condition()` is true of the node itself, looking often: no event tells."""
        timer = self.probe.create_timer(0.01, self._event)
        try:
            self.until(condition, what)
        finally:
            self.probe.destroy_timer(timer)

    def until_ready(self):
        """Spin until an identify_node in this process has its solver."""
        self.until_true(lambda: self.node.ready, "solver")

    def count_calls(self, entity):
        """Return a list that grows with each callback of a subscription or timer."""
        calls, callback = [], entity.callback

        @functools.wraps(callback)  # rclpy looks at how many arguments it takes
        def watched(*arguments):
            callback(*arguments)
            calls.append(arguments)
            self._event()

        entity.callback = watched
        return calls

    def _add(self, node):
        self.executor.add_node(node)
        self._nodes.append(node)
        return node

    def _event(self):
        for look in list(self._lookouts):
            look()


@contextmanager
def open_bench():
    """Give a bench and close it at the end."""
    bench = Bench()
    try:
        yield bench
    finally:
        bench.close()


@dataclass(frozen=True)
class Outcome:
    """All that identify_node published for one frame: messages, or None where it did not."""

    solution: DiagnosticArray
    attitude: QuaternionStamped | None
    boresight: Vector3Stamped | None
    cloud: PointCloud2 | None

    @property
    def values(self):
        """The keys and values of the solution."""
        return values_from_diagnostics(self.solution)

    @property
    def status(self):
        return self.values["status"]

    @property
    def stars(self):
        """The identified stars as a structured array."""
        return stars_from_cloud(self.cloud)


class IdentifyClient:
    """Sends frames to an identify_node and gathers its answers by stamp.

    Make it before the node, so that the node's first answer finds its subscribers.
    """

    def __init__(self, bench):
        self.bench = bench
        self.solutions = bench.inbox(DiagnosticArray, "solution")
        self.attitudes = bench.inbox(QuaternionStamped, "attitude")
        self.boresights = bench.inbox(Vector3Stamped, "boresight_deg")
        self.clouds = bench.inbox(PointCloud2, "identified_stars")
        self.centroids = None

    def connect(self, reliability=ReliabilityPolicy.RELIABLE):
        """Wait until both directions are connected."""
        inboxes = (self.solutions, self.attitudes, self.boresights, self.clouds)
        self.bench.until(lambda: all(i.n_publishers for i in inboxes), "publishers of the node")
        self.centroids = self.centroids or self.bench.outbox(PointCloud2, "centroids", reliability)
        self.bench.until(lambda: self.centroids.n_subscribers, "subscriber to centroids")
        if self.bench.node is not None:
            self.bench.until_ready()
        return self

    def publish(self, frame):
        self.centroids.publish(frame)

    def send(self, frame):
        """Publish a frame and return its outcome."""
        self.publish(frame)
        return self.outcome(frame)

    def outcome(self, frame):
        """Wait for the answer to a frame that was published.

        A frame that cannot be read has no row to report in `identified_stars`, all others have.
        """
        stamp = stamp_ns(frame.header)
        self.bench.until(lambda: self.solutions.at(stamp), f"solution of the frame at {stamp} ns")
        answered = []
        if values_from_diagnostics(self.solutions.at(stamp)[0])["status"] == "SOLVED":
            answered = [self.attitudes, self.boresights, self.clouds]
        self.bench.until(lambda: all(i.at(stamp) for i in answered), "complete answer")
        return self.gathered(frame)

    def unsolved(self, frame, good_frame):
        """Send a frame that has no solution, then a good one; return the first's outcome.

        Topics keep their order: once the good frame's answer is here, nothing more of the first
        one can come.
        """
        self.send(frame)
        assert self.send(good_frame).status == "SOLVED"
        outcome = self.gathered(frame)
        assert outcome.attitude is None
        assert outcome.boresight is None
        return outcome

    def gathered(self, frame):
        """Return what has come for a frame so far."""

        def only(inbox):
            messages = inbox.at(stamp_ns(frame.header))
            assert len(messages) <= 1, f"{len(messages)} answers to one frame"
            return messages[0] if messages else None

        return Outcome(*(
            only(inbox)
            for inbox in (self.solutions, self.attitudes, self.boresights, self.clouds)
        ))
