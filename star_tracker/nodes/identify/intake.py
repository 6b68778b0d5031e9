"""How frames come in to identify_node: queued, counted, and each with its camera."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from msg_adapters import MessageError
from msg_adapters.camera_info import camera_from_info
from msg_adapters.stamp import nanoseconds_from_header
from star_tracker.nodes.identify.camera_feed import CameraFeed
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.listening import DropCounter, subscribe
from star_tracker.optics.camera import Camera

_LOOK_AT_WAITING_S = 0.01
#: Longer in the queue than that, and the wall clock has jumped or the middleware gives no time.
_LONGEST_QUEUED_S = 60.0
_NO_INFO = (
    "no CameraInfo was received for this frame: publish it on camera_info with the frame's stamp "
    "or an earlier one, or set use_camera_info to false"
)


@dataclass(frozen=True)
class IncomingFrame:
    """A frame that has come: its message, when it was received and when it was taken.

    Both times are seconds of `time.monotonic`; between them it lay in the queue.
    """

    message: PointCloud2
    received_s: float
    taken_s: float = field(default_factory=time.monotonic)

    @property
    def header(self) -> Header:
        """The frame's header."""
        return self.message.header

    @property
    def stamp_ns(self) -> int:
        """The frame's stamp."""
        return nanoseconds_from_header(self.message.header)


class Intake:
    """The subscriptions of one node. Frames wait, as many as the queue holds, until it is opened.

    Args:
        node: who listens.
        setup: returns the one that holds now.
        identify: called with each frame and its camera.
        reject: called with a frame that has no camera, or None for a camera that cannot be used,
            the kind of trouble and a sentence.
    """

    def __init__(
        self, node: Node, setup: Callable[[], SolverSetup],
        identify: Callable[[IncomingFrame, Camera], None],
        reject: Callable[[IncomingFrame | None, str, str], None],
    ) -> None:
        self._setup, self._identify, self._reject = setup, identify, reject
        self._feed = CameraFeed()
        self._waiting: deque[IncomingFrame] = deque()
        self._drops = DropCounter()
        self._n_overtaken = 0
        self._open = False
        p = setup().parameters
        self._depth, self._use_info = p.queue_depth, p.use_camera_info
        if self._use_info:
            subscribe(node, CameraInfo, "camera_info", self._depth, self._on_camera_info)
            node.create_timer(_LOOK_AT_WAITING_S, self._serve_waiting)
        subscribe(
            node, PointCloud2, "centroids", self._depth, self._on_centroids,
            on_publishers=self._drops.on_publishers,
        )

    def open(self) -> None:
        """Let frames through, those that wait first."""
        self._open = True
        self._serve_waiting()

    @property
    def n_waiting(self) -> int:
        """Frames that wait."""
        return len(self._waiting)

    @property
    def n_dropped(self) -> int:
        """Frames that were published but never looked at, as newer ones took their place."""
        return self._drops.n_dropped + self._n_overtaken

    def _on_camera_info(self, message: CameraInfo, _: Mapping[str, Any]) -> None:
        try:
            camera = camera_from_info(message, self._setup().parameters.parity)
        except MessageError as error:
            self._reject(None, "camera_info", str(error))
            return
        self._feed.announce(nanoseconds_from_header(message.header), camera)
        self._serve_waiting()

    def _on_centroids(self, message: PointCloud2, info: Mapping[str, Any]) -> None:
        self._drops.on_message(info.get("publication_sequence_number"))
        queued_s = (time.time_ns() - (info.get("received_timestamp") or 0)) / 1e9
        queued_s = queued_s if 0.0 <= queued_s <= _LONGEST_QUEUED_S else 0.0
        frame = IncomingFrame(message, time.monotonic() - queued_s)
        self._waiting.append(frame)
        if len(self._waiting) > self._depth:
            self._waiting.popleft()
            self._n_overtaken += 1
        self._serve_waiting()

    def _serve_waiting(self) -> None:
        """Identify the frames whose camera is known, in order; give up on waiting in time."""
        patience_s = self._setup().parameters.camera_info_wait_ms / 1e3
        while self._open and self._waiting:
            frame = self._waiting[0]
            camera = self._setup().camera
            if self._use_info:
                camera = self._feed.settled(frame.stamp_ns)
            if camera is None:
                if time.monotonic() - frame.taken_s < patience_s:
                    return
                camera = self._feed.best(frame.stamp_ns)
            self._waiting.popleft()
            if camera is None:
                self._reject(frame, "camera_info_missing", _NO_INFO)
            else:
                self._identify(frame, camera)
