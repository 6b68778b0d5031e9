"""identify_node: star centroids in, attitude and identified stars out."""

import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from msg_adapters import MessageError
from msg_adapters.attitude import boresight_from_attitude, quaternion_from_attitude
from msg_adapters.camera_info import camera_from_info
from msg_adapters.point_cloud import centroids_from_cloud, cloud_from_identification
from msg_adapters.solution import diagnostics_from_solution
from msg_adapters.stamp import nanoseconds_from_header
from star_tracker.camera import Camera
from star_tracker.catalog import StarCatalog
from star_tracker.database import FeatureDatabase
from star_tracker.match_group import MatchGroupSettings
from star_tracker.nodes.camera_feed import CameraFeed
from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS, ParameterError, declare
from star_tracker.nodes.running import run
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker
from star_tracker.verification import Identification

_QUEUE_DEPTH = 50
_LOOK_AT_WAITING_S = 0.01


class IdentifyNode(Node):
    """Identifies each frame of `centroids` and publishes what it found under the frame's stamp.

    Raises ParameterError for a configuration that cannot be used.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__("identify_node", **node_options)
        #: Frames that were not searched, by reason.
        self.rejected: Counter[str] = Counter()
        self._feed = CameraFeed()
        self._waiting: deque[tuple[PointCloud2, float]] = deque()
        try:
            self._configure(declare(self, IDENTIFY_PARAMETERS))
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        self._advertise()
        self._listen()

    def _configure(self, p: dict[str, Any]) -> None:
        self._settled = p
        catalog = StarCatalog.named(
            p["catalog"], limiting_magnitude=p["limiting_magnitude"],
            min_separation_deg=p["min_separation_deg"], epoch=p["epoch"],
        )
        self._database = FeatureDatabase.build(
            catalog, max_separation_deg=p["max_separation_deg"]
        )
        self._settings = SolveSettings(
            method=p["method"],
            match_group=MatchGroupSettings(pair_tolerance_px=p["pair_tolerance_px"]),
            displaced_gate_px=p["displaced_gate_px"],
            max_log10_false_alarms=p["max_log10_false_alarms"],
            deadline_ms=p["deadline_ms"], max_centroids=p["max_centroids"],
        )
        for name in ("cx_px", "cy_px"):
            if -1 < p[name] < 0:
                raise ParameterError(f"parameter {name} is {p[name]:g}: it must be -1 or >= 0 px")
        camera = Camera.from_fov(
            p["fov_deg"], p["width_px"], p["height_px"], parity=p["parity"],
            cx_px=None if p["cx_px"] < 0 else p["cx_px"],
            cy_px=None if p["cy_px"] < 0 else p["cy_px"],
        )
        self._tracker = StarTracker(self._database, camera, self._settings)
        source = "camera_info" if p["use_camera_info"] else (
            f"{p['fov_deg']:g} deg over {p['width_px']} px"
        )
        self.get_logger().info(
            f"ready: {catalog.description}, {self._database.pairs.n_pairs} pairs, "
            f"camera {source}, parity {p['parity']}"
        )

    def _advertise(self) -> None:
        self._attitude = self.create_publisher(QuaternionStamped, "attitude", _QUEUE_DEPTH)
        self._boresight = self.create_publisher(Vector3Stamped, "boresight_deg", _QUEUE_DEPTH)
        self._stars = self.create_publisher(PointCloud2, "identified_stars", _QUEUE_DEPTH)
        self._solution = self.create_publisher(DiagnosticArray, "solution", _QUEUE_DEPTH)

    def _listen(self) -> None:
        if self._settled["use_camera_info"]:
            self._subscribe(CameraInfo, "camera_info", self._on_camera_info)
            self.create_timer(_LOOK_AT_WAITING_S, self._serve_waiting)
        self._subscribe(PointCloud2, "centroids", self._on_centroids)

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe so that reliable and best-effort publishers both connect.

        BEST_AVAILABLE is settled when the subscription is made, as RELIABLE where no publisher is
        known yet. A best-effort publisher that appears later does not match then, but announces
        itself as incompatible; subscribing again settles it anew, with that publisher known.
        """

        def subscribe_again(_: Any) -> None:
            self.get_logger().info(f"{topic}: subscribing again for a best-effort publisher")
            self.destroy_subscription(subscription)
            self._subscribe(kind, topic, callback)

        qos = QoSProfile(depth=_QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_AVAILABLE)
        events = SubscriptionEventCallbacks(incompatible_qos=subscribe_again)
        subscription = self.create_subscription(
            kind, topic, callback, qos, event_callbacks=events
        )

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            camera = camera_from_info(message, self._settled["parity"])
        except MessageError as error:
            self.rejected["camera_info"] += 1
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
            return
        self._feed.announce(nanoseconds_from_header(message.header), camera)
        self._serve_waiting()

    def _on_centroids(self, message: PointCloud2) -> None:
        if not self._settled["use_camera_info"]:
            self._identify(message, self._tracker.camera)
            return
        self._waiting.append((message, time.monotonic()))
        self._serve_waiting()

    def _serve_waiting(self) -> None:
        """Identify the frames whose camera is known, in order; give up on waiting in time."""
        patience = self._settled["camera_info_wait_ms"] / 1e3
        while self._waiting:
            message, arrived = self._waiting[0]
            stamp = nanoseconds_from_header(message.header)
            camera = self._feed.settled(stamp)
            if camera is None:
                if time.monotonic() - arrived < patience:
                    return
                camera = self._feed.best(stamp)
            self._waiting.popleft()
            if camera is None:
                self._reject(
                    message.header, "camera_info_missing",
                    "no CameraInfo was received for this frame: publish it on camera_info with "
                    "the frame's stamp or an earlier one, or set use_camera_info to false",
                )
            else:
                self._identify(message, camera)

    def _identify(self, message: PointCloud2, camera: Camera) -> None:
        try:
            centroids = centroids_from_cloud(message)
        except MessageError as error:
            self._reject(message.header, "malformed_cloud", str(error))
            return
        if camera != self._tracker.camera:
            self._tracker = StarTracker(self._database, camera, self._settings)
        solution = self._tracker.solve(centroids.xy_px)
        self._report(solution)
        self._publish(solution, message.header)
        frame_id = self._settled["camera_frame"] or message.header.frame_id
        header = Header(stamp=message.header.stamp, frame_id=frame_id)
        self._stars.publish(
            cloud_from_identification(
                solution.identification, centroids.xy_px, self._database.catalog, header
            )
        )

    def _publish(self, solution: Solution, header: Header) -> None:
        if solution.attitude is not None:
            reference = Header(stamp=header.stamp, frame_id=self._settled["reference_frame"])
            self._attitude.publish(quaternion_from_attitude(solution.attitude, reference))
            self._boresight.publish(boresight_from_attitude(solution.attitude, reference))
        self._solution.publish(diagnostics_from_solution(solution, self.get_name(), header))

    def _report(self, solution: Solution) -> None:
        if solution.status is Status.BAD_INPUT:
            self.rejected["bad_centroids"] += 1
            self.get_logger().error(solution.reason, throttle_duration_sec=1.0)
        elif solution.n_ignored:
            self.rejected["ignored_centroids"] += solution.n_ignored
            self.get_logger().warning(
                f"{solution.n_ignored} centroids are non-finite or outside of the image and were "
                "left out: check the camera's size and the detector",
                throttle_duration_sec=1.0,
            )

    def _reject(self, header: Header, kind: str, reason: str) -> None:
        """Count a frame that cannot be used and say why, in the log and to the subscribers."""
        self.rejected[kind] += 1
        self.get_logger().error(reason, throttle_duration_sec=1.0)
        nothing = Identification.empty(0)
        self._publish(Solution(Status.BAD_INPUT, reason, nothing), header)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("identify_node", IdentifyNode, args)


if __name__ == "__main__":
    sys.exit(main())
