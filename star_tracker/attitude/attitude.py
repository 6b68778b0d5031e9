"""Attitude from matched directions: Wahba's problem, its covariance, boresight and roll.

A rotation matrix R here turns camera-frame vectors into ICRS: v_icrs = R v_camera. Its columns
are therefore the camera's x, y and z axes seen from the sky.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats, position_angle, tangent_basis

#: Largest error of a product of two columns of a rotation.
_ORTHOGONAL = 1e-6


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
        values = np.empty(7)
        describe(np.ascontiguousarray(rotation, float), values)
        return cls(
            values[:4], covariance_rad2, float(values[4]), float(values[5]), float(values[6])
        )

    @property
    def rotation(self) -> Floats:
        """The rotation matrix (3, 3), camera to ICRS."""
        return np.asarray(Rotation.from_quat(self.quaternion_xyzw).as_matrix())


def covariance(camera_vectors: Floats, sigma_rad: float) -> Floats:
    """Return the attitude covariance (3, 3), rad^2, about the camera's axes.

    sigma^2 (sum(I - b b^T))^-1 for unit vectors b (k, 3) that each carry an error of `sigma_rad`
    along both tangent axes (Shuster and Oh 1981).
    """
    result = np.empty((3, 3))
    vectors = np.ascontiguousarray(camera_vectors, float)
    write_covariance(vectors, np.arange(len(vectors)), len(vectors), sigma_rad, result)
    return result


@compiled
def write_covariance(
    vectors: Floats, observed: NDArray[np.int64], k: int, sigma_rad: float, result: Floats
) -> None:
    """Write the covariance of an attitude fitted to the first `k` of the vectors observed."""
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(k):
        b = vectors[observed[i]]
        xx += 1 - b[0] * b[0]
        yy += 1 - b[1] * b[1]
        zz += 1 - b[2] * b[2]
        xy -= b[0] * b[1]
        xz -= b[0] * b[2]
        yz -= b[1] * b[2]
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    scale = sigma_rad * sigma_rad / (xx * a + xy * b + xz * c)
    result[0, 0], result[1, 1], result[2, 2] = a, xx * zz - xz * xz, xx * yy - xy * xy
    result[0, 1] = result[1, 0] = b
    result[0, 2] = result[2, 0] = c
    result[1, 2] = result[2, 1] = xz * xy - xx * yz
    for i in range(3):
        for j in range(3):
            result[i, j] *= scale


@compiled
def is_rotation(r: Floats) -> bool:
    """Return whether a matrix (3, 3) turns and neither stretches nor mirrors."""
    for i in range(3):
        for j in range(i, 3):
            product = r[0, i] * r[0, j] + r[1, i] * r[1, j] + r[2, i] * r[2, j]
            # Written so that what is not a number is refused too.
            if not abs(product - (1.0 if i == j else 0.0)) < _ORTHOGONAL:
                return False
    x = r[1, 0] * r[2, 1] - r[2, 0] * r[1, 1]
    y = r[2, 0] * r[0, 1] - r[0, 0] * r[2, 1]
    z = r[0, 0] * r[1, 1] - r[1, 0] * r[0, 1]
    return x * r[0, 2] + y * r[1, 2] + z * r[2, 2] > 0.0


@compiled
def describe(r: Floats, values: Floats) -> None:
    """Write quaternion (x, y, z, w), right ascension, declination and roll of a rotation (3, 3).

    The quaternion's largest element is taken from the diagonal (Shepperd 1978).
    """
    squares = (
        1 + r[0, 0] - r[1, 1] - r[2, 2], 1 - r[0, 0] + r[1, 1] - r[2, 2],
        1 - r[0, 0] - r[1, 1] + r[2, 2], 1 + r[0, 0] + r[1, 1] + r[2, 2],
    )
    largest = 0
    for i in range(4):
        if squares[i] > squares[largest]:
            largest = i
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    if largest == 0:
        q = (squares[0], xy, xz, x)
    elif largest == 1:
        q = (xy, squares[1], yz, y)
    elif largest == 2:
        q = (xz, yz, squares[2], z)
    else:
        q = (x, y, z, squares[3])
    scale = 1 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[3] < 0:
        scale = -scale
    for i in range(4):
        values[i] = q[i] * scale
    turn = 2 * np.pi
    ra = np.arctan2(r[1, 2], r[0, 2]) % turn
    values[4] = 0.0 if ra >= turn else ra  # a tiny negative angle rounds up to a whole turn
    values[5] = np.arctan2(r[2, 2], np.hypot(r[0, 2], r[1, 2]))
    # North and east components of the image's up direction, -y, at the boresight.
    roll = np.arctan2(r[0, 1] * r[1, 2] - r[1, 1] * r[0, 2], -r[2, 1]) % turn
    values[6] = 0.0 if roll >= turn else roll


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
