"""Rotation matrices and quaternions, each formula once.

A rotation matrix R turns camera-frame vectors into ICRS: v_icrs = R v_camera. Its columns are
therefore the camera's x, y and z axes seen from the sky. Quaternions are (x, y, z, w).
"""

import numpy as np

from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats, tangent_basis

#: Largest error of a product of two columns of a rotation.
_ORTHOGONAL = 1e-6
Elements = tuple[float, float, float, float, float, float, float, float, float]


def rotation_matrix(quaternion_xyzw: Floats) -> Floats:
    """Return the rotation matrix (3, 3) of a quaternion (4,) of any length but 0."""
    rotation = np.empty((3, 3))
    write_rotation(np.ascontiguousarray(quaternion_xyzw, float), rotation)
    return rotation


@compiled
def write_rotation(q: Floats, rotation: Floats) -> None:
    """Write the rotation matrix of a quaternion (4,) of any length; of length 0, the identity."""
    if q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] == 0.0:
        q[3] = 1.0
    elements = rotation_elements(q[0], q[1], q[2], q[3])
    for i in range(9):
        rotation[i // 3, i % 3] = elements[i]


@inlined
def rotation_elements(x: float, y: float, z: float, w: float) -> Elements:
    """Return the nine elements, row by row, of the rotation of a quaternion of any length but 0.

    A tuple stays in registers: no memory is asked for.
    """
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
        s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w),
        s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y),
    )


@compiled
def write_quaternion(r: Floats, quaternion_xyzw: Floats) -> None:
    """Write the unit quaternion (4,), w >= 0, of a rotation (3, 3) (Shepperd 1978).

    Its largest element is taken from the diagonal.
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
        quaternion_xyzw[i] = q[i] * scale


@compiled
def boresight_of(r: Floats) -> tuple[float, float, float]:
    """Return right ascension, declination and roll of a rotation (3, 3), radians.

    Right ascension and roll, the position angle of the image's up direction -y, lie in [0, 2 pi).
    """
    turn = 2 * np.pi
    ra = np.arctan2(r[1, 2], r[0, 2]) % turn
    dec = np.arctan2(r[2, 2], np.hypot(r[0, 2], r[1, 2]))
    # North and east components of the image's up direction at the boresight.
    roll = np.arctan2(r[0, 1] * r[1, 2] - r[1, 1] * r[0, 2], -r[2, 1]) % turn
    # A tiny negative angle rounds up to a whole turn.
    return 0.0 if ra >= turn else ra, dec, 0.0 if roll >= turn else roll


def rotation_from_boresight(ra_rad: float, dec_rad: float, roll: float) -> Floats:
    """Return the rotation (3, 3), camera to ICRS, for a boresight and roll, radians."""
    z = np.array([
        np.cos(dec_rad) * np.cos(ra_rad), np.cos(dec_rad) * np.sin(ra_rad), np.sin(dec_rad)
    ])
    east, north = tangent_basis(z)
    y = -(np.cos(roll) * north + np.sin(roll) * east)
    return np.column_stack([np.cross(y, z), y, z])


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


@inlined
def copy_rotation(source: Floats, target: Floats) -> None:
    """Copy a matrix (3, 3). Written out: an assignment of slices compiles to much more."""
    for i in range(3):
        for j in range(3):
            target[i, j] = source[i, j]
