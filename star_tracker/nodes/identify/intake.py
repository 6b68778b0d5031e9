"""How frames come in to identify_node: queued, counted, and each with its camera."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from star_tracker.msg_adapters import MessageError, shown
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.msg_adapters.stamp import nanoseconds_from_header
from star_tracker.nodes.identify.camera_feed import CameraFeeds
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.listening import (
    DropCounter,
    received_s,
    subscribe,
    subscribe_latched,
)
from star_tracker.optics.camera import Camera

#: A timer that is set again at once has to have some period.
_SHORTEST_S = 1e-3


@dataclass(frozen=True, eq=False)  # each is itself alone, whatever it holds
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
    def frame_id(self) -> str:
        """The frame's frame_id."""
        return str(self.message.header.frame_id)

    @property
    def stamp_ns(self) -> int:
        """The frame's stamp."""
        return nanoseconds_from_header(self.message.header)


class Intake:
    """The subscriptions of one node. Frames wait, as many as the queue holds, until it is opened.

    Args:
        node: who listens.
        setup: returns the one that holds now.
        identify: called with each frame and its camera, None for one to be found out.
        reject: called with a frame that has no camera, or None for a camera that cannot be used,
            the kind of trouble and a sentence.
        listens: whether it subscribes to `centroids`; else frames come by `take` alone.
    """

    def __init__(
        self, node: Node, setup: Callable[[], SolverSetup],
        identify: Callable[[IncomingFrame, Camera | None], None],
        reject: Callable[[IncomingFrame | None, str, str], None], listens: bool = True,
    ) -> None:
        self._node, self._setup = node, setup
        self._identify, self._reject = identify, reject
        self._feeds = CameraFeeds()
        self._refused = ""
        self._waiting: deque[IncomingFrame] = deque()
        self._drops = DropCounter()
        self._n_overtaken = 0
        self._open = False
        self._last_chance: dict[str, IncomingFrame] = {}
        p = setup().parameters
        self._depth, self._use_info = p.queue_depth, p.use_camera_info
        # Steady, as the ROS time may stand still; it runs only while a frame waits.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_SHORTEST_S, self._on_timer, clock=steady)
        self._timer.cancel()
        if self._use_info:
            subscribe_latched(
                node, CameraInfo, "camera_info", self._depth, self._on_camera_info
            )
        if not listens:
            return
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
            p = self._setup().parameters
            # Parity and tolerance are those of the time when a frame is solved.
            camera = camera_from_info(message, p.parity, rectified=p.rectified)
        except MessageError as error:
            self._refused = str(error)
            self._reject(None, "camera_info", self._refused)
            return
        header = message.header
        self._feeds.announce(str(header.frame_id), nanoseconds_from_header(header), camera)
        self._serve_waiting()

    def _on_centroids(self, message: PointCloud2, info: Mapping[str, Any]) -> None:
        self._drops.on_message(info.get("publication_sequence_number"))
        self._take(IncomingFrame(message, received_s(info)))

    def take(self, message: PointCloud2) -> None:
        """Take a frame that did not come over a topic."""
        self._take(IncomingFrame(message, time.monotonic()))

    def _take(self, frame: IncomingFrame) -> None:
        self._waiting.append(frame)
        if len(self._waiting) > self._depth:
            overtaken = self._waiting.popleft()
            self._last_chance.pop(overtaken.frame_id, None)
            self._n_overtaken += 1
        self._serve_waiting()

    def _on_timer(self) -> None:
        self._timer.cancel()
        self._serve_waiting()

    def _serve_waiting(self) -> None:
        """Identify the frames whose camera is known; give up on waiting in time.

        Those of one frame_id stay in order, and wait for nobody else's.
        """
        held: dict[str, float] = {}
        for frame in list(self._waiting) if self._open else ():
            if frame.frame_id in held:
                continue
            if not self._use_info:
                self._waiting.remove(frame)
                self._identify(frame, self._setup().camera)
                continue
            camera = self._feeds.settled(frame.frame_id, frame.stamp_ns)
            if camera is None:
                patience_s = self._setup().parameters.camera_info_wait_ms / 1e3
                left_s = frame.taken_s + patience_s - time.monotonic()
                if left_s > 0 or self._last_chance.get(frame.frame_id) is not frame:
                    # Timers go before subscriptions: what came meanwhile, while the process had
                    # no processor perhaps, is read before a frame gives up.
                    if left_s <= 0:
                        self._last_chance[frame.frame_id] = frame
                    held[frame.frame_id] = left_s
                    continue
                camera = self._best(frame)
            self._waiting.remove(frame)
            self._last_chance.pop(frame.frame_id, None)
            self._feeds.answered(frame.frame_id, frame.stamp_ns)
            if camera is None:
                self._reject(frame, "camera_info_missing", self._why_no_camera(frame))
            else:
                self._identify(frame, camera)
        if held:
            self._look_again_in(min(held.values()))

    def _look_again_in(self, seconds: float) -> None:
        self._timer.timer_period_ns = int(1e9 * max(seconds, _SHORTEST_S))
        self._timer.reset()

    def _best(self, frame: IncomingFrame) -> Camera | None:
        """Return the camera that a frame gets after its wait."""
        timeless = self._feeds.timeless
        camera = self._feeds.best(frame.frame_id, frame.stamp_ns)
        if self._feeds.timeless and not timeless:
            self._node.get_logger().warning(
                f"the only camera announced on {self._topic} is younger than the frame"
                f"{_zero(frame)}: it is taken for frames of any stamp"
            )
        return camera

    def _why_no_camera(self, frame: IncomingFrame) -> str:
        """Say why a frame has no camera, and what to do."""
        topic, frame_ids = self._topic, self._feeds.frame_ids
        if len(frame_ids) > 1 and frame.frame_id not in frame_ids:
            return (
                f"the CameraInfo of {topic} have frame_id {', '.join(map(shown, frame_ids))}, "
                f"this frame has {shown(frame.frame_id)}: give it that of its camera"
            )
        if frame_ids:
            return (
                f"all CameraInfo of {topic} are younger than this frame{_zero(frame)}, and not of "
                "one camera: publish each with its frame's stamp or an earlier one"
            )
        if self._refused:
            return f"no CameraInfo of {topic} can be used, the last one: {self._refused}"
        n = self._node.count_publishers(topic)
        heard = "nothing is published there" if n == 0 else "its publisher has sent none yet"
        return (
            f"no CameraInfo was received on {topic}, {heard}: publish the camera there, or set "
            "use_camera_info to false"
        )

    @property
    def _topic(self) -> str:
        return self._node.resolve_topic_name("camera_info")


def _zero(frame: IncomingFrame) -> str:
    """Say that a frame's stamp is zero, where it is."""
    return ", whose stamp is 0" if frame.stamp_ns == 0 else ""
