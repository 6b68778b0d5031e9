"""replay_node: streams star maps as `centroids` and `camera_info`, then ends by itself."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from star_tracker.maps.star_map import StarMap, paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.point_cloud import Centroids, cloud_from_centroids
from star_tracker.nodes.declaring import DeclaringNode, ParameterError, declare, unknown_parameters
from star_tracker.nodes.listening import PUBLISHED, overrides_checked
from star_tracker.nodes.parameters import ReplayParameters
from star_tracker.nodes.running import run
from star_tracker.nodes.sending import Sending


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
        self._sending = Sending(
            self, self._centroids, self._infos if p.publish_camera_info else None, p.rate_hz,
            self._send, "frames",
        )
        for sentence in unknown_parameters(self, given):
            self.get_logger().warning(sentence)
        self.get_logger().info(
            f"{len(self._maps)} maps at {p.rate_hz:g} Hz, waiting for a subscriber"
        )

    def _send(self, number: int) -> bool:
        """Send a map; return False after the last one."""
        if number >= len(self._maps) and not self._told.loop:
            return False
        star_map = self._maps[number % len(self._maps)]
        header = Header(
            stamp=self.get_clock().now().to_msg(), frame_id=self._told.camera_frame
        )
        if self._told.publish_camera_info:
            self._infos.publish(info_from_camera(star_map.camera, header))
        self._centroids.publish(cloud_from_centroids(Centroids(self._observed(star_map)), header))
        return True

    def _observed(self, star_map: StarMap) -> np.ndarray:
        xy = star_map.xy_px + self._rng.normal(0.0, self._told.noise_px, star_map.xy_px.shape)
        return self._rng.permutation(xy) if self._told.shuffle else xy


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("replay_node", ReplayNode, args)


if __name__ == "__main__":
    sys.exit(main())
