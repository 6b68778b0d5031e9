"""The attitude of a camera, or of what carries it, against the Earth.

The attitude fitted to catalogue directions, R: camera to ICRS, becomes that of the camera in GCRS
by the rotation E that aberration and refraction have put into the fit (`absorbed_rotation`), and
then turns with the Earth: R_itrs = W(stamp) E R, R_enu = (enu from itrs) R_itrs.
"""

from dataclasses import dataclass
from math import log1p

import numpy as np

from star_tracker.attitude.attitude import Attitude
from star_tracker.earth.apparent import (
    Atmosphere,
    ScaleFit,
    aberrated,
    absorbed_rotation,
    refracted,
)
from star_tracker.earth.rotation import EarthOrientation, earth_velocity_m_per_s, itrs_from_gcrs
from star_tracker.earth.site import Site
from star_tracker.geometry.rotation import rotation_matrix, write_quaternion
from star_tracker.geometry.spherical import Floats
from star_tracker.solution import Solution

_NOTHING_MEASURED, _NO_AIR = EarthOrientation(), Atmosphere()


@dataclass(frozen=True)
class Fix:
    """An attitude with the stars that it was fitted to.

    Attributes:
        attitude: camera to ICRS, as fitted to directions of the catalogue.
        vectors: (n, 3) those directions, ICRS. With the boresight alone, aberration is right to
            20.5" times the distance of the stars' centre from the boresight in radians: 1" for 3
            degrees.
        scale_fit: where the focal length was fitted too.
    """

    attitude: Attitude
    vectors: Floats
    scale_fit: ScaleFit | None = None

    @classmethod
    def of_boresight(cls, attitude: Attitude) -> "Fix":
        """Take an attitude of which the stars are not known."""
        return cls(attitude, attitude.rotation[:, 2][None, :])

    @classmethod
    def of_solution(cls, solution: Solution) -> "Fix":
        """Take a solved frame. Raises ValueError where it was not solved."""
        attitude, catalog, camera = solution.attitude, solution.catalog, solution.told_camera
        if attitude is None or catalog is None or camera is None:
            raise ValueError("the frame was not solved: it has no attitude")
        identified = solution.identification.catalog_index[solution.identification.identified]
        fit = None
        if solution.focal_length_error > 0:
            # The prior of `judge.refine_pose`.
            told = log1p(camera.tolerance_percent / 100)
            noise = solution.centroid_sigma_px / camera.focal_length_px
            fit = ScaleFit(attitude.rotation[:, 2], (noise / told) ** 2 if told else 0.0)
        return cls(attitude, catalog.vectors[identified], fit)


@dataclass(frozen=True)
class EarthAttitude:
    """An attitude against a frame that turns with the Earth.

    Attributes:
        quaternion_xyzw: (4,) rotates vectors of the camera, or of the body, into the Earth's
            frame; w >= 0.
        covariance_rad2: (3, 3) of the small rotation about the camera's, or the body's, own axes.
    """

    quaternion_xyzw: Floats
    covariance_rad2: Floats

    @classmethod
    def from_rotation(cls, rotation: Floats, covariance_rad2: Floats) -> "EarthAttitude":
        """Describe a rotation (3, 3), camera to the Earth's frame."""
        quaternion = np.empty(4)
        write_quaternion(np.ascontiguousarray(rotation, float), quaternion)
        return cls(quaternion, covariance_rad2)

    @property
    def rotation(self) -> Floats:
        """The rotation matrix (3, 3), camera or body to the Earth's frame."""
        return rotation_matrix(self.quaternion_xyzw)

    def of_body(self, camera_from_body: Floats) -> "EarthAttitude":
        """Return the attitude of what carries the camera, by a fixed rotation (3, 3)."""
        return EarthAttitude.from_rotation(
            self.rotation @ camera_from_body,
            camera_from_body.T @ self.covariance_rad2 @ camera_from_body,
        )


def azimuth_altitude_rad(enu: Floats) -> tuple[float, float]:
    """Return azimuth, from north towards east in [0, 2 pi), and altitude of a vector in ENU."""
    east, north, up = (float(value) for value in enu)
    azimuth = np.arctan2(east, north) % (2 * np.pi)
    return float(azimuth), float(np.arctan2(up, np.hypot(east, north)))


def itrs_attitude(
    fix: Fix, stamp_ns: int, *, orientation: EarthOrientation = _NOTHING_MEASURED,
    velocity_m_per_s: Floats | None = None,
) -> EarthAttitude:
    """Return the attitude against ITRS, the Earth-fixed frame (`earth` of REP-105).

    Args:
        fix: the attitude against the stars.
        stamp_ns: when the image was taken, ns since 1970, UTC. 1 ms is 0.015".
        orientation: what is measured of the Earth's rotation.
        velocity_m_per_s: (3,) of the camera in GCRS, about the Earth's centre. Left out, a
            satellite in a low orbit errs by 5", the ground by 0.3".

    Raises ValueError for a stamp before 1972, ImportError where pyerfa is missing.
    """
    velocity = earth_velocity_m_per_s(stamp_ns)
    if velocity_m_per_s is not None:
        velocity = velocity + velocity_m_per_s
    seen = aberrated(fix.vectors, velocity)
    return _turned(fix, seen, itrs_from_gcrs(stamp_ns, orientation))


def enu_attitude(
    fix: Fix, stamp_ns: int, site: Site, *, orientation: EarthOrientation = _NOTHING_MEASURED,
    air: Atmosphere = _NO_AIR,
) -> EarthAttitude:
    """Return the attitude against east, north, up of a place, for a camera at rest there.

    Args:
        fix: the attitude against the stars.
        stamp_ns: when the image was taken, ns since 1970, UTC. 1 ms is 0.015".
        site: where the camera stands. It moves with the ground.
        orientation: what is measured of the Earth's rotation.
        air: at the camera.

    Raises ValueError for a stamp before 1972 and for stars too low for refraction, ImportError
    where pyerfa is missing.
    """
    to_itrs = itrs_from_gcrs(stamp_ns, orientation)
    to_enu = site.enu_from_itrs @ to_itrs
    ground = to_itrs.T @ site.velocity_itrs_m_per_s
    seen = aberrated(fix.vectors, earth_velocity_m_per_s(stamp_ns) + ground)
    return _turned(fix, refracted(seen, to_enu[2], air), to_enu)


def _turned(fix: Fix, seen: Floats, to_earth: Floats) -> EarthAttitude:
    """Return the attitude of a camera that sees the stars at `seen` (n, 3), GCRS."""
    absorbed = absorbed_rotation(fix.vectors, seen, fix.scale_fit)
    return EarthAttitude.from_rotation(
        to_earth @ absorbed @ fix.attitude.rotation, fix.attitude.covariance_rad2
    )
