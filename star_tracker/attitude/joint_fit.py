"""Rotation and focal length together: least squares, information and covariance.

A small rotation w about the camera's axes and a step s of log f move a direction u in the camera
by w x u + s d, with d = u (1 - u_z^2) - (u_x, u_y, 0): towards the axis where f grows. The four
unknowns have the information matrix [[M, c], [c^T, e]], M = sum(I - u u^T), c = sum(u x d),
e = sum(d^2), and what is known of log f beforehand adds to e.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.information import adjugate, determinant, with_direction, with_scale
from star_tracker.compiled import compiled
from star_tracker.geometry.rotation import rotation_elements
from star_tracker.geometry.spherical import Floats

#: Least information about three angles, as in `wahba`.
_MIN_INFORMATION = 1e-12
#: The scale is fitted where the rotation leaves this part of its information.
_LEAST_LEFT = 1e-3
#: Largest step of log f in one round.
_LARGEST_STEP = 0.03


@compiled
def refine_scaled(
    camera: Floats, icrs: Floats, matches: Any, k: int, pose: Any, prior: float
) -> None:
    """Improve a pose that nearly fits, and its scale, by one step of linear least squares.

    Args:
        camera: (n, 3) unit vectors in the camera, for the pose's scale.
        icrs: (m, 3) unit vectors of guide stars.
        matches: the first `k` of `observed` and `listed`, places in `icrs`, count.
        k: how many.
        pose: rotation and scale, improved in place.
        prior: information about log f about 0, in the units of e; 0 = nothing is known.
    """
    m, c = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    gx = gy = gz = gs = 0.0
    r = pose.rotation
    for i in range(k):
        u, v = camera[matches.observed[i]], icrs[matches.listed[i]]
        wx = r[0, 0] * v[0] + r[1, 0] * v[1] + r[2, 0] * v[2]
        wy = r[0, 1] * v[0] + r[1, 1] * v[1] + r[2, 1] * v[2]
        wz = r[0, 2] * v[0] + r[1, 2] * v[1] + r[2, 2] * v[2]
        m = with_direction(m, u[0], u[1], u[2])
        c = with_scale(c, u[0], u[1], u[2])
        gx += u[1] * wz - u[2] * wy
        gy += u[2] * wx - u[0] * wz
        gz += u[0] * wy - u[1] * wx
        off = 1 - u[2] * u[2]
        dx, dy, dz = u[0] * (off - 1), u[1] * (off - 1), u[2] * off
        gs += dx * (wx - u[0]) + dy * (wy - u[1]) + dz * (wz - u[2])
    a = adjugate(m)
    size = determinant(m, a)
    if not size > _MIN_INFORMATION * k * k * k:
        return
    px, py = (a[0] * c[0] + a[1] * c[1]) / size, (a[1] * c[0] + a[3] * c[1]) / size
    pz = (a[2] * c[0] + a[4] * c[1]) / size
    left = c[2] - (c[0] * px + c[1] * py) + prior
    s = 0.0
    if k > 2 and left > _LEAST_LEFT * c[2]:
        gs -= prior * np.log(pose.scale)
        s = (gs - (px * gx + py * gy + pz * gz)) / left
        s = min(max(s, -_LARGEST_STEP), _LARGEST_STEP)
    hx, hy, hz = gx - s * c[0], gy - s * c[1], gz
    _turn(pose.rotation, (
        (a[0] * hx + a[1] * hy + a[2] * hz) / size, (a[1] * hx + a[3] * hy + a[4] * hz) / size,
        (a[2] * hx + a[4] * hy + a[5] * hz) / size,
    ))
    pose.scale *= np.exp(s)


@compiled
def _turn(r: Floats, angles: tuple[float, float, float]) -> None:
    """Turn the camera of a rotation back by small angles about its own axes."""
    turn = rotation_elements(0.5 * angles[0], 0.5 * angles[1], 0.5 * angles[2], 1.0)
    for row in range(3):
        x, y, z = r[row, 0], r[row, 1], r[row, 2]
        r[row, 0] = x * turn[0] + y * turn[3] + z * turn[6]
        r[row, 1] = x * turn[1] + y * turn[4] + z * turn[7]
        r[row, 2] = x * turn[2] + y * turn[5] + z * turn[8]


@compiled
def write_covariance(
    vectors: Floats, observed: NDArray[np.int64], k: int, precision: tuple[float, float],
    result: Floats,
) -> float:
    """Write the covariance (3, 3), rad^2, of a fitted attitude; return that of log f.

    Args:
        vectors: (n, 3) unit vectors in the camera.
        observed: the first `k` are those that were fitted to.
        k: how many.
        precision: variance of a direction along each axis, rad^2, and information about log f
            beforehand, in the units of e; infinite where the focal length is known, and was not
            fitted. Otherwise the covariance is marginal over it.
        result: what is written.
    """
    variance, prior = precision
    m, c = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(k):
        b = vectors[observed[i]]
        m = with_direction(m, b[0], b[1], b[2])
        c = with_scale(c, b[0], b[1], b[2])
    variance_log_f = 0.0
    if prior < np.inf:
        e = c[2] + prior
        a = adjugate(m)
        shared = c[0] * c[0] * a[0] + 2 * c[0] * c[1] * a[1] + c[1] * c[1] * a[3]
        variance_log_f = variance / max(e - shared / determinant(m, a), _LEAST_LEFT * e)
        m = (
            m[0] - c[0] * c[0] / e, m[1] - c[0] * c[1] / e, m[2], m[3] - c[1] * c[1] / e,
            m[4], m[5],
        )
    a = adjugate(m)
    scale = variance / determinant(m, a)
    result[0, 0], result[1, 1], result[2, 2] = a[0] * scale, a[3] * scale, a[5] * scale
    result[0, 1] = result[1, 0] = a[1] * scale
    result[0, 2] = result[2, 0] = a[2] * scale
    result[1, 2] = result[2, 1] = a[4] * scale
    return variance_log_f
