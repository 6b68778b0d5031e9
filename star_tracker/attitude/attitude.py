"""The attitude: a quaternion with its covariance, boresight and roll.

A rotation matrix R here turns camera-frame vectors into ICRS: v_icrs = R v_camera. Its columns
are therefore the camera's x, y and z axes seen from the sky.
"""

from dataclasses import dataclass

import numpy as np

from star_tracker.attitude.joint_fit import write_covariance
from star_tracker.geometry.rotation import boresight_of, rotation_matrix, write_quaternion
from star_tracker.geometry.spherical import Floats


@dataclass(frozen=True, eq=False)  # arrays have no one answer
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
        r, quaternion = np.ascontiguousarray(rotation, float), np.empty(4)
        write_quaternion(r, quaternion)
        return cls(quaternion, covariance_rad2, *boresight_of(r))

    @property
    def rotation(self) -> Floats:
        """The rotation matrix (3, 3), camera to ICRS."""
        return rotation_matrix(self.quaternion_xyzw)


def covariance(camera_vectors: Floats, sigma_rad: float) -> Floats:
    """Return the attitude covariance (3, 3), rad^2, about the camera's axes.

    sigma^2 (sum(I - b b^T))^-1 for unit vectors b (k, 3) that each carry an error of `sigma_rad`
    along both tangent axes (Shuster and Oh 1981).
    """
    result = np.empty((3, 3))
    vectors = np.ascontiguousarray(camera_vectors, float)
    every, known = np.arange(len(vectors)), np.inf
    write_covariance(vectors, every, len(vectors), (sigma_rad * sigma_rad, known), result)
    return result
