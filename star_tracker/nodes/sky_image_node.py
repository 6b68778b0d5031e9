"""sky_image_node: images of a sky that turns, with their `camera_info` and the true attitude."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import QuaternionStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.render import check_size, render
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters.attitude import quaternion_from_attitude
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.image import Picture, image_from_picture
from star_tracker.nodes.declaring import DeclaringNode, ParameterError, declare, unknown_parameters
from star_tracker.nodes.listening import PUBLISHED, overrides_checked
from star_tracker.nodes.running import run
from star_tracker.nodes.sending import Sending
from star_tracker.nodes.sky_parameters import SkyImageParameters
from star_tracker.optics.camera import PIXEL_ORIGINS

#: The faintest stars that are rendered.
_FAINTEST_MAG = 8.0
_DEPTH = 5


class SkyImageNode(DeclaringNode):
    """Publishes rendered images at a fixed rate, from when a subscriber is there.

    The sky stands where the image's stamp says. `truth/attitude` and `camera_info` have the same
    stamp. Raises ParameterError for a configuration that cannot be used, and
    ExternalShutdownException, out of spin, after the last of `count` images.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "sky_image_node", automatically_declare_parameters_from_overrides=True, **node_options
        )
        try:
            self._told, given = declare(self, SkyImageParameters)
            self._camera, self._settings = self._told.camera, self._told.settings
            check_size(self._camera)
            self._catalog = StarCatalog.hipparcos(
                limiting_magnitude=_FAINTEST_MAG, min_separation_deg=0.0, epoch=self._told.epoch
            )
            self._make_topics()
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        self._first_ns = 0
        self._sending = Sending(
            self, self._images, self._infos, self._told.rate_hz, self._send, "images"
        )
        for sentence in unknown_parameters(self, given):
            self.get_logger().warning(sentence)
        self.get_logger().info(
            f"images of {self._told.fov_deg:g} deg over {self._told.width_px} x "
            f"{self._told.height_px} px at {self._told.rate_hz:g} Hz, waiting for a subscriber"
        )

    def _make_topics(self) -> None:
        with overrides_checked():
            qos = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
            make = partial(self.create_publisher, qos_overriding_options=PUBLISHED)
            self._images = make(Image, "image", qos)
            self._infos = make(CameraInfo, "camera_info", qos)
            self._truth = make(QuaternionStamped, "truth/attitude", qos)

    def _send(self, number: int) -> bool:
        """Send an image; return False after the last one."""
        if number == self._told.count > 0:
            return False
        now = self.get_clock().now()
        self._first_ns = self._first_ns if number else now.nanoseconds
        rotation, rate = self._told.rotation_at((now.nanoseconds - self._first_ns) / 1e9)
        x, y, z = rate.tolist()
        rendered = render(self._camera, rotation, self._catalog, replace(
            self._settings, rate_deg_s=(x, y, z), seed=self._told.seed + number
        ))
        self._publish(rendered.image, rotation, Header(
            stamp=now.to_msg(), frame_id=self._told.camera_frame
        ))
        return True

    def _publish(self, pixels: np.ndarray, rotation: Floats, header: Header) -> None:
        self._infos.publish(info_from_camera(
            self._camera.moved(-PIXEL_ORIGINS["center"]), header
        ))
        attitude = Attitude.from_rotation(rotation, np.zeros((3, 3)))
        self._truth.publish(quaternion_from_attitude(
            attitude, Header(stamp=header.stamp, frame_id="icrs")
        ))
        self._images.publish(image_from_picture(Picture(pixels), self._told.encoding, header))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("sky_image_node", SkyImageNode, args)


if __name__ == "__main__":
    sys.exit(main())
