"""sky_image_node: images of a sky that turns, with their `camera_info` and the true attitude."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import QuaternionStamped
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from msg_adapters.attitude import quaternion_from_attitude
from msg_adapters.camera_info import info_from_camera
from msg_adapters.detected_stars import PIXEL_ORIGINS
from msg_adapters.image import Picture, image_from_picture
from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import EPOCH_RANGE, REFERENCE_EPOCH, StarCatalog
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import Floats
from star_tracker.nodes.declaring import (
    ParameterError,
    declare,
    parameter,
    parameters_of,
    unknown_parameters,
)
from star_tracker.nodes.listening import PUBLISHED, overrides_checked
from star_tracker.nodes.running import run
from star_tracker.optics.camera import FOV_RANGE_DEG, Camera
from star_tracker.optics.distortion import Distortion

#: The Earth's rotation against the stars, deg/s: 360 in a sidereal day of 86164.0905 s.
SIDEREAL_DEG_S = 360.0 / 86164.0905
#: The converter of each encoding: its bits, and electrons for each unit.
_CONVERTERS = {"mono8": (8, 10.0), "mono16": (12, 5.0)}
_FAINTEST_MAG = 8.0
_RENDER = RenderSettings()
_LOOK_FOR_SUBSCRIBER_S = 0.05
#: As replay_node: who wants several topics is not discovered on all at once.
_GRACE_S = 3.0
_ACKNOWLEDGE_S = 10.0
_DEPTH = 5


@dataclass(frozen=True)
class SkyImageParameters:
    """What sky_image_node is told. Raises ValueError for values that do not go together."""

    ra_deg: float = parameter(
        83.0, "right ascension of the boresight at the first image", "deg",
        allowed=(0.0, 360.0), fixed=True,
    )
    dec_deg: float = parameter(
        0.0, "its declination", "deg", allowed=(-90.0, 90.0), fixed=True
    )
    roll_deg: float = parameter(
        0.0, "position angle of the image's up direction, from north to east", "deg",
        allowed=(-360.0, 360.0), fixed=True,
    )
    sidereal: bool = parameter(
        True, "turn with the Earth, as a camera on the ground", fixed=True
    )
    rate_deg_s: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "the camera's own rate of turn about its x, y and z axis", "deg/s",
        allowed=(-1000.0, 1000.0), fixed=True,
    )
    fov_deg: float = parameter(
        20.0, "field of view across the image's width", "deg", allowed=FOV_RANGE_DEG, fixed=True
    )
    width_px: int = parameter(640, "image width", "px", allowed=(16, 65536), fixed=True)
    height_px: int = parameter(480, "image height", "px", allowed=(16, 65536), fixed=True)
    parity: str = parameter(
        "normal", "normal: y down; mirrored: seen in a mirror", choices=("normal", "mirrored"),
        fixed=True,
    )
    distortion: tuple[float, ...] = parameter(
        (0.0, 0.0), "radial distortion of the lens, k1 and k2", allowed=(-10.0, 10.0), fixed=True
    )
    encoding: str = parameter(
        "mono16", "of the image: 8 bits, or 12 bits in 16", choices=tuple(_CONVERTERS), fixed=True
    )
    rate_hz: float = parameter(
        5.0, "images per second", "Hz", allowed=(0.001, 1000.0), fixed=True
    )
    count: int = parameter(
        0, "the node ends after so many images; 0 = never", allowed=(0, 2**31 - 1), fixed=True
    )
    exposure_s: float = parameter(
        _RENDER.exposure_s, "time of exposure", "s", allowed=(1e-6, 1000.0), fixed=True
    )
    psf_sigma_px: float = parameter(
        _RENDER.psf_sigma_px, "width of a star, the standard deviation of a Gaussian", "px",
        allowed=(0.4, 12.0), fixed=True,
    )
    sky_e_per_s: float = parameter(
        _RENDER.sky_e_per_s, "background, electrons a second and pixel", "e/s",
        allowed=(0.0, 1e6), fixed=True,
    )
    read_noise_e: float = parameter(
        _RENDER.read_noise_e, "noise of a read-out, electrons", "e", allowed=(0.0, 1e4),
        fixed=True,
    )
    hot_pixels: float = parameter(
        0.0, "part of the pixels that are hot", allowed=(0.0, 1.0), fixed=True
    )
    epoch: float = parameter(
        REFERENCE_EPOCH, "of the stars' places", "Julian year", allowed=EPOCH_RANGE, fixed=True
    )
    seed: int = parameter(
        0, "of the noise; each image adds 1", allowed=(0, 2**31 - 1), fixed=True
    )
    camera_frame: str = parameter("camera", "frame_id of the images", fixed=True)

    def __post_init__(self) -> None:
        for name, n in (("rate_deg_s", 3), ("distortion", 2)):
            if len(getattr(self, name)) != n:
                raise ParameterError(
                    f"parameter {name} has {len(getattr(self, name))} numbers: it must be {n}"
                )

    @property
    def camera(self) -> Camera:
        """The camera, counted from the outer corner of the first pixel. Raises ValueError."""
        camera = Camera.from_fov(self.fov_deg, self.width_px, self.height_px, parity=self.parity)
        if not any(self.distortion):
            return camera
        k1, k2 = self.distortion
        camera = replace(camera, distortion=Distortion("plumb_bob", (k1, k2, 0.0, 0.0, 0.0)))
        _ = camera.radius_rad  # of a lens that shows no sky it raises
        return camera

    @property
    def settings(self) -> RenderSettings:
        """Sensor and lens."""
        bits, gain = _CONVERTERS[self.encoding]
        return RenderSettings(
            exposure_s=self.exposure_s, psf_sigma_px=self.psf_sigma_px,
            sky_e_per_s=self.sky_e_per_s, read_noise_e=self.read_noise_e,
            hot_pixels=self.hot_pixels, bits=bits, gain_e_per_dn=gain,
        )

    def rotation_at(self, seconds: float) -> tuple[Floats, Floats]:
        """Return attitude (3, 3), camera to ICRS, and rate (3,) about the camera's axes, deg/s.

        Args:
            seconds: since the first image.
        """
        own = np.array(self.rate_deg_s)
        pole = np.array([0.0, 0.0, SIDEREAL_DEG_S if self.sidereal else 0.0])
        start = rotation_from_boresight(*np.radians([self.ra_deg, self.dec_deg, self.roll_deg]))
        turned = Rotation.from_rotvec(np.radians(pole) * seconds).as_matrix() @ start
        rotation = turned @ Rotation.from_rotvec(np.radians(own) * seconds).as_matrix()
        return rotation, own + rotation.T @ pole


SKY_IMAGE_PARAMETERS = parameters_of(SkyImageParameters)


class SkyImageNode(Node):
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
            self._catalog = StarCatalog.hipparcos(
                limiting_magnitude=_FAINTEST_MAG, min_separation_deg=0.0, epoch=self._told.epoch
            )
            self._make_topics()
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        self._sent = 0
        self._found: Time | None = None
        self._first_ns = 0
        self._timer = self.create_timer(_LOOK_FOR_SUBSCRIBER_S, self._wait_for_subscriber)
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

    def _wait_for_subscriber(self) -> None:
        if self._images.get_subscription_count() == 0:
            return
        now = self.get_clock().now()
        self._found = self._found or now
        if self._infos.get_subscription_count() == 0:
            if now - self._found < Duration(seconds=_GRACE_S):
                return
            self.get_logger().info("nobody listens to camera_info, starting all the same")
        self._again_every(1 / self._told.rate_hz, self._send_next)

    def _again_every(self, period_s: float, callback: Callable[[], None]) -> None:
        self.destroy_timer(self._timer)
        self._timer = self.create_timer(period_s, callback)

    def _send_next(self) -> None:
        if self._sent == self._told.count > 0:
            self._give_up = self.get_clock().now() + Duration(seconds=_ACKNOWLEDGE_S)
            self._again_every(_LOOK_FOR_SUBSCRIBER_S, self._wait_for_acknowledgement)
            return
        now = self.get_clock().now()
        self._first_ns = self._first_ns if self._sent else now.nanoseconds
        rotation, rate = self._told.rotation_at((now.nanoseconds - self._first_ns) / 1e9)
        x, y, z = rate.tolist()
        rendered = render(self._camera, rotation, self._catalog, replace(
            self._settings, rate_deg_s=(x, y, z), seed=self._told.seed + self._sent
        ))
        self._publish(rendered.image, rotation, Header(
            stamp=now.to_msg(), frame_id=self._told.camera_frame
        ))
        self._sent += 1

    def _publish(self, pixels: np.ndarray, rotation: Floats, header: Header) -> None:
        shift, camera = PIXEL_ORIGINS["center"], self._camera
        self._infos.publish(info_from_camera(
            replace(camera, cx_px=camera.cx_px - shift, cy_px=camera.cy_px - shift), header
        ))
        attitude = Attitude.from_rotation(rotation, np.zeros((3, 3)))
        self._truth.publish(quaternion_from_attitude(
            attitude, Header(stamp=header.stamp, frame_id="icrs")
        ))
        self._images.publish(image_from_picture(Picture(pixels), self._told.encoding, header))

    def _wait_for_acknowledgement(self) -> None:
        # In short waits, as replay_node's: rclpy waits without releasing the GIL.
        acknowledged = self._images.wait_for_all_acked(Duration(seconds=0.01))
        if not acknowledged and self.get_clock().now() < self._give_up:
            return
        self.get_logger().info(f"{self._sent} images sent")
        raise ExternalShutdownException


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("sky_image_node", SkyImageNode, args)


if __name__ == "__main__":
    sys.exit(main())
