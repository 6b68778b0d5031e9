"""The parameters of sky_image_node: a camera, its sensor, and how it turns under the sky."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from star_tracker.catalogue.catalog import EPOCH_RANGE, REFERENCE_EPOCH
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import Floats
from star_tracker.nodes.declaring import ParameterError, parameter, parameters_of
from star_tracker.optics.camera import FOV_RANGE_DEG, Camera
from star_tracker.optics.distortion import Distortion

#: The Earth's rotation against the stars, deg/s: 360 in a sidereal day of 86164.0905 s.
SIDEREAL_DEG_S = 360.0 / 86164.0905
#: The converter of each encoding: its bits, and electrons for each unit.
_CONVERTERS = {"mono8": (8, 10.0), "mono16": (12, 5.0)}
_RENDER = RenderSettings()


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
