"""Wahba's problem: the rotation that best turns directions in the camera into those of the sky.

A rotation matrix R turns camera-frame vectors into ICRS: v_icrs = R v_camera.
"""

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.information import adjugate, determinant, with_direction
from star_tracker.compiled import compiled
from star_tracker.geometry.rotation import rotation_elements, write_rotation
from star_tracker.geometry.spherical import Floats

#: Below this determinant of the information (of one star's) the directions are nearly on one line
#: of sight, within some microradians: roll is not determined.
_MIN_INFORMATION = 1e-12
#: Directions within this chord of the first are a narrow field.
_NARROW = 0.02
_Three = tuple[int, int, int]


def wahba(camera_vectors: Floats, icrs_vectors: Floats) -> Floats:
    """Return the rotation (3, 3) that best turns camera vectors (k, 3) into ICRS vectors (k, 3).

    Wahba's problem with equal weights; the determinant is +1 by construction. Raises ValueError
    where the directions do not fix the rotation (fewer than two, or all along one line).
    """
    rotation = np.empty((3, 3))
    camera = np.ascontiguousarray(camera_vectors, float)
    icrs = np.ascontiguousarray(icrs_vectors, float)
    every = np.arange(len(camera))
    if not solve_wahba(camera, every, icrs, every, len(camera), rotation):
        raise ValueError("the matched directions do not determine a rotation")
    return rotation


@compiled
def solve_wahba(
    camera: Floats,
    observed: NDArray[np.int64],
    icrs: Floats,
    catalog: NDArray[np.int64],
    k: int,
    rotation: Floats,
) -> bool:
    """Solve Wahba's problem for the first `k` matches of two lists; return whether it has one.

    Match i is of camera[observed[i]] with icrs[catalog[i]]; the result is written to `rotation`.
    In a wide field Davenport's quaternion, the eigenvector of the largest eigenvalue of a 4 x 4
    matrix (Wertz 1978, 12.3; Horn 1987); in a narrow one, where that eigenvalue has a near
    neighbour, the two directions farthest apart (TRIAD, Black 1964). Linear least squares over
    all of them makes the result exact.
    """
    if k < 2:
        return False
    far, chord2 = _farthest(camera, observed, k)
    steps = 2
    if chord2 < _NARROW**2:
        steps = 4
        if not _triad(
            camera[observed[0]], camera[observed[far]], icrs[catalog[0]], icrs[catalog[far]],
            rotation,
        ):
            return False
    else:
        b = np.zeros((3, 3))
        for i in range(k):
            v, u = icrs[catalog[i]], camera[observed[i]]
            for row in range(3):
                for column in range(3):
                    b[row, column] += v[row] * u[column]
        _rotation_of_profile(b, k, rotation)
    determined = True
    for _ in range(steps):
        determined &= refine(camera, observed, icrs, catalog, k, rotation)
    return determined


@compiled
def _farthest(vectors: Floats, observed: NDArray[np.int64], k: int) -> tuple[int, float]:
    """Return which of `k` vectors is farthest from the first, and the squared chord to it."""
    first, far, most = vectors[observed[0]], 0, 0.0
    for i in range(1, k):
        v = vectors[observed[i]]
        x, y, z = v[0] - first[0], v[1] - first[1], v[2] - first[2]
        chord2 = x * x + y * y + z * z
        if chord2 > most:
            far, most = i, chord2
    return far, most


@compiled
def _triad(u1: Floats, u2: Floats, v1: Floats, v2: Floats, rotation: Floats) -> bool:
    """Write the rotation that turns u1 into v1 and the plane of u1 and u2 into that of v1 and v2.

    Returns whether there is one. The second directions enter as differences from the first, so
    that no digits are lost where they are close.
    """
    a, b = np.empty((3, 3)), np.empty((3, 3))
    if not (_frame_of(u1, u2, a) and _frame_of(v1, v2, b)):
        return False
    for i in range(3):
        for j in range(3):
            rotation[i, j] = b[0, i] * a[0, j] + b[1, i] * a[1, j] + b[2, i] * a[2, j]
    return True


@compiled
def _frame_of(first: Floats, second: Floats, axes: Floats) -> bool:
    """Write a right-handed frame (3, 3), an axis in each row, of which `first` is the first."""
    along = 0.0
    for i in range(3):
        axes[0, i] = first[i]
        axes[1, i] = second[i] - first[i]
        along += axes[1, i] * first[i]
    length2 = 0.0
    for i in range(3):
        axes[1, i] -= along * first[i]
        length2 += axes[1, i] * axes[1, i]
    if not length2 > 0.0:
        return False
    for i in range(3):
        axes[1, i] /= np.sqrt(length2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        axes[2, i] = axes[0, j] * axes[1, k] - axes[0, k] * axes[1, j]
    return True


@compiled
def _rotation_of_profile(b: Floats, k: int, rotation: Floats) -> None:
    """Write the rotation that maximises trace(b^T rotation), for b = sum of k products v u^T."""
    trace = b[0, 0] + b[1, 1] + b[2, 2]
    m = np.empty((4, 4))
    for i in range(3):
        for j in range(3):
            m[i, j] = b[i, j] + b[j, i]
        m[i, i] -= trace
    m[0, 3] = m[3, 0] = b[2, 1] - b[1, 2]
    m[1, 3] = m[3, 1] = b[0, 2] - b[2, 0]
    m[2, 3] = m[3, 2] = b[1, 0] - b[0, 1]
    m[3, 3] = trace
    x = _largest_eigenvalue(b, m, k)
    for i in range(4):
        m[i, i] -= x
    # Every column of the adjugate is a multiple of the eigenvector: the longest is the best.
    longest, q = -1.0, np.empty(4)
    for column in range(4):
        q0, q1 = _cofactor4(m, 0, column), _cofactor4(m, 1, column)
        q2, q3 = _cofactor4(m, 2, column), _cofactor4(m, 3, column)
        length2 = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3
        if length2 > longest:
            longest = length2
            q[0], q[1], q[2], q[3] = q0, q1, q2, q3
    write_rotation(q, rotation)


@compiled
def _largest_eigenvalue(b: Floats, m: Floats, k: int) -> float:
    """Return the largest eigenvalue of m (4, 4), Davenport's matrix of the profile b (3, 3)."""
    # The characteristic polynomial x^4 + c2 x^2 + c1 x + c0.
    c2 = 0.0
    for i in range(3):
        for j in range(3):
            c2 -= 2 * b[i, j] * b[i, j]
    c1 = -8 * _determinant3(b, (0, 1, 2), (0, 1, 2))
    c0 = 0.0
    for j in range(4):
        c0 += m[0, j] * _cofactor4(m, 0, j)
    x = float(k)  # no eigenvalue is larger: it is the number of unit vectors
    for _ in range(60):
        slope = (4 * x * x + 2 * c2) * x + c1
        if slope <= 0.0:
            break
        step = (((x * x + c2) * x + c1) * x + c0) / slope
        x -= step
        if abs(step) < 1e-15 * k:
            break
    return x


@compiled
def _determinant3(m: Floats, rows: _Three, columns: _Three) -> float:
    """Return the determinant of three rows and columns of a matrix."""
    a, b, c = rows
    d, e, f = columns
    return (
        m[a, d] * (m[b, e] * m[c, f] - m[b, f] * m[c, e])
        - m[a, e] * (m[b, d] * m[c, f] - m[b, f] * m[c, d])
        + m[a, f] * (m[b, d] * m[c, e] - m[b, e] * m[c, d])
    )


@compiled
def _cofactor4(m: Floats, i: int, j: int) -> float:
    """Return the cofactor of an element of a 4 x 4 matrix."""
    rows = (1 if i < 1 else 0), (2 if i < 2 else 1), (3 if i < 3 else 2)
    columns = (1 if j < 1 else 0), (2 if j < 2 else 1), (3 if j < 3 else 2)
    value = _determinant3(m, rows, columns)
    return value if (i + j) % 2 == 0 else -value


@compiled
def refine(
    camera: Floats,
    observed: NDArray[np.int64],
    icrs: Floats,
    catalog: NDArray[np.int64],
    k: int,
    rotation: Floats,
) -> bool:
    """Improve a rotation that nearly fits, in place, by one step of linear least squares.

    The arguments are those of `solve_wahba`; `catalog` are rows of `icrs`, whatever that holds.
    Returns whether the directions fix a rotation.
    """
    m = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    gx = gy = gz = 0.0
    r = rotation
    for i in range(k):
        u, v = camera[observed[i]], icrs[catalog[i]]
        px = r[0, 0] * u[0] + r[0, 1] * u[1] + r[0, 2] * u[2]
        py = r[1, 0] * u[0] + r[1, 1] * u[1] + r[1, 2] * u[2]
        pz = r[2, 0] * u[0] + r[2, 1] * u[1] + r[2, 2] * u[2]
        m = with_direction(m, px, py, pz)
        gx += py * v[2] - pz * v[1]
        gy += pz * v[0] - px * v[2]
        gz += px * v[1] - py * v[0]
    a = adjugate(m)
    size = determinant(m, a)
    if not size > _MIN_INFORMATION * k * k * k:
        return False
    turn = rotation_elements(
        0.5 * (a[0] * gx + a[1] * gy + a[2] * gz) / size,
        0.5 * (a[1] * gx + a[3] * gy + a[4] * gz) / size,
        0.5 * (a[2] * gx + a[4] * gy + a[5] * gz) / size,
        1.0,
    )
    for column in range(3):
        x, y, z = r[0, column], r[1, column], r[2, column]
        r[0, column] = turn[0] * x + turn[1] * y + turn[2] * z
        r[1, column] = turn[3] * x + turn[4] * y + turn[5] * z
        r[2, column] = turn[6] * x + turn[7] * y + turn[8] * z
    return True
