"""Attitude from matched directions: Wahba's problem, its covariance, boresight and roll.

A rotation matrix R here turns camera-frame vectors into ICRS: v_icrs = R v_camera. Its columns
are therefore the camera's x, y and z axes seen from the sky.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from star_tracker.spherical import Floats, position_angle, ra_dec, tangent_basis

#: Below this second singular value the directions are nearly on one line: roll is not determined.
_MIN_SINGULAR_VALUE = 1e-12


@dataclass(frozen=True)
class Attitude:
    """Where the camera points.

    Attributes:
        quaternion_xyzw: (4,) rotates camera-frame vectors into ICRS; w >= 0.
        covariance_rad2: (3, 3) of the small rotation about the camera's x, y, z axes, rad^2.
        ra_rad, dec_rad: boresight, ICRS; right ascension in [0, 2 pi).
        roll_rad: position angle of the image's up direction (-y), from north towards east.
    """

    quaternion_xyzw: Floats
    covariance_rad2: Floats
    ra_rad: float
    dec_rad: float
    roll_rad: float

    @classmethod
    def from_rotation(cls, rotation: Floats, covariance_rad2: Floats) -> "Attitude":
        """Describe the rotation matrix (3, 3), camera to ICRS.

        Raises ValueError for a matrix that mirrors: its determinant is not +1.
        """
        if np.linalg.det(rotation) < 0:
            raise ValueError("a rotation has determinant +1, this matrix mirrors (determinant -1)")
        quaternion = Rotation.from_matrix(rotation).as_quat()
        if quaternion[3] < 0:
            quaternion = -quaternion
        ra, dec = ra_dec(rotation[:, 2])
        return cls(quaternion, covariance_rad2, float(ra), float(dec), roll_rad(rotation))

    @property
    def rotation(self) -> Floats:
        """The rotation matrix (3, 3), camera to ICRS."""
        return np.asarray(Rotation.from_quat(self.quaternion_xyzw).as_matrix())


def wahba(camera_vectors: Floats, icrs_vectors: Floats) -> Floats:
    """Return the rotation (3, 3) that best turns camera vectors (k, 3) into ICRS vectors (k, 3).

    Wahba's problem with equal weights, solved by singular value decomposition (Markley 1988);
    the determinant is +1 by construction. Raises ValueError where the directions do not fix the
    rotation (fewer than two, or all along one line).
    """
    u, singular, vt = np.linalg.svd(icrs_vectors.T @ camera_vectors)
    if len(camera_vectors) < 2 or singular[1] < _MIN_SINGULAR_VALUE * singular[0]:
        raise ValueError("the matched directions do not determine a rotation")
    rotation = u @ vt
    if np.linalg.det(rotation) < 0:
        rotation = (u * (1.0, 1.0, -1.0)) @ vt
    return np.asarray(rotation)


def covariance(camera_vectors: Floats, sigma_rad: float) -> Floats:
    """Return the attitude covariance (3, 3), rad^2, about the camera's axes.

    sigma^2 (sum(I - b b^T))^-1 for unit vectors b (k, 3) that each carry an error of `sigma_rad`
    along both tangent axes (Shuster and Oh 1981).
    """
    information = len(camera_vectors) * np.eye(3) - camera_vectors.T @ camera_vectors
    return np.asarray(sigma_rad**2 * np.linalg.inv(information))


def roll_rad(rotation: Floats) -> float:
    """Return the position angle of the image's up direction at the boresight, [0, 2 pi)."""
    return float(position_angle(rotation[:, 2], -rotation[:, 1]))


def rotation_from_boresight(ra_rad: float, dec_rad: float, roll: float) -> Floats:
    """Return the rotation (3, 3), camera to ICRS, for a boresight and roll, radians."""
    z = np.array([
        np.cos(dec_rad) * np.cos(ra_rad), np.cos(dec_rad) * np.sin(ra_rad), np.sin(dec_rad)
    ])
    east, north = tangent_basis(z)
    y = -(np.cos(roll) * north + np.sin(roll) * east)
    return np.column_stack([np.cross(y, z), y, z])
