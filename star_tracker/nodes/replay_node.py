"""replay_node: streams star maps as `centroids` and `camera_info`, then ends by itself."""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from star_tracker.maps.star_map import StarMap, paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.point_cloud import Centroids, cloud_from_centroids
from star_tracker.nodes.declaring import DeclaringNode, ParameterError, declare, unknown_parameters
from star_tracker.nodes.listening import PUBLISHED, overrides_checked
from star_tracker.nodes.parameters import ReplayParameters
from star_tracker.nodes.running import run

#: How long the last frames may take to be acknowledged before the node says that some were not.
_ACKNOWLEDGE_S = 10.0
_LOOK_FOR_SUBSCRIBER_S = 0.05
#: Discovery was seen to take up to 2.4 s.
_CAMERA_INFO_GRACE_S = 3.0


class ReplayNode(DeclaringNode):
    """Publishes each map once, at a fixed rate, from when a subscriber is there.

    Reliable and deep enough for all maps, so that none is lost. Raises ParameterError for a
    configuration that cannot be used and ExternalShutdownException, out of spin, at its end.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "replay_node", automatically_declare_parameters_from_overrides=True, **node_options
        )
        try:
            p, given = declare(self, ReplayParameters)
            self._maps = paper_maps(p.maps, Path(p.folder) if p.folder else None)
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        self._told = p
        self._rng = np.random.default_rng(p.seed)
        self._sent = 0
        self._found: Time | None = None
        qos = QoSProfile(
            depth=max(50, len(self._maps)), reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.VOLATILE,
        )
        try:
            with overrides_checked():
                make = partial(self.create_publisher, qos_overriding_options=PUBLISHED)
                self._centroids = make(PointCloud2, "centroids", qos)
                self._infos = make(CameraInfo, "camera_info", qos)
        except ParameterError:
            self.destroy_node()
            raise
        self._timer = self.create_timer(_LOOK_FOR_SUBSCRIBER_S, self._wait_for_subscriber)
        for sentence in unknown_parameters(self, given):
            self.get_logger().warning(sentence)
        self.get_logger().info(
            f"{len(self._maps)} maps at {p.rate_hz:g} Hz, waiting for a subscriber"
        )

    def _wait_for_subscriber(self) -> None:
        if self._centroids.get_subscription_count() == 0:
            self.get_logger().info(
                f"waiting for a subscriber to {self._centroids.topic_name}",
                throttle_duration_sec=5.0, skip_first=True,
            )
            return
        now = self.get_clock().now()
        self._found = self._found or now
        # Who wants both topics is not always discovered on both at once.
        if self._told.publish_camera_info and self._infos.get_subscription_count() == 0:
            if now - self._found < Duration(seconds=_CAMERA_INFO_GRACE_S):
                return
            self.get_logger().warning("nobody listens to camera_info, starting all the same")
        self._again_every(1 / self._told.rate_hz, self._send_next)

    def _again_every(self, period_s: float, callback: Callable[[], None]) -> None:
        self.destroy_timer(self._timer)
        self._timer = self.create_timer(period_s, callback)

    def _send_next(self) -> None:
        if self._sent >= len(self._maps) and not self._told.loop:
            self._again_every(_LOOK_FOR_SUBSCRIBER_S, self._wait_for_acknowledgement)
            self._give_up = self.get_clock().now() + Duration(seconds=_ACKNOWLEDGE_S)
            return
        star_map = self._maps[self._sent % len(self._maps)]
        header = Header(
            stamp=self.get_clock().now().to_msg(), frame_id=self._told.camera_frame
        )
        if self._told.publish_camera_info:
            self._infos.publish(info_from_camera(star_map.camera, header))
        self._centroids.publish(cloud_from_centroids(Centroids(self._observed(star_map)), header))
        self._sent += 1

    def _observed(self, star_map: StarMap) -> np.ndarray:
        xy = star_map.xy_px + self._rng.normal(0.0, self._told.noise_px, star_map.xy_px.shape)
        return self._rng.permutation(xy) if self._told.shuffle else xy

    def _wait_for_acknowledgement(self) -> None:
        # A longer wait in one piece would hold up signals: rclpy waits without releasing the GIL.
        acknowledged = self._centroids.wait_for_all_acked(Duration(seconds=0.01))
        if not acknowledged and self.get_clock().now() < self._give_up:
            return
        if not acknowledged:
            self.get_logger().error("the subscriber did not acknowledge all frames")
        self.get_logger().info(f"{self._sent} frames sent")
        raise ExternalShutdownException


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("replay_node", ReplayNode, args)


if __name__ == "__main__":
    sys.exit(main())
