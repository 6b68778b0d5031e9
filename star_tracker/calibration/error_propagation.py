"""How errors of the centroids reach the boresight (paper, 4.3), exactly to first order.

The noise is that of a centroid along each pixel axis, standard deviation `sigma_px`, independent
between stars; the catalogue's own errors are left out. Star vectors are unit vectors in ICRS, a
star in each row.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from star_tracker.calibration.three_star import (
    cofactors,
    cosine_by_focal_length,
    cosine_by_radius,
    cosines,
    error_factor,
    tetrahedron_volume,
)
from star_tracker.geometry.spherical import Floats, tangent_basis

#: What triples can be ranked by.
CRITERIA = ("error", "k", "volume")
#: With more stars the arrays of all triples (551,300 of 150) no longer fit in little memory.
_MAX_STARS = 150
#: Determinants below this, for a trace of 1, are those of directions along one line.
_SINGULAR = 1e-14


@dataclass(frozen=True)
class Triples:
    """All triples of a field's stars.

    Attributes:
        index: (m, 3) indices into the stars.
        k: (m,) error factor K (4-27).
        volume: (m,) tetrahedron volume (4-29).
        boresight_rad_per_px: (m,) root mean square boresight error of the closed form with known
            focal length, radians for each pixel of centroid noise.
    """

    index: NDArray[np.intp]
    k: Floats
    volume: Floats
    boresight_rad_per_px: Floats


def three_star_covariance(
    star_vectors: Floats, a_px: Floats, f_px: float, sigma_px: float
) -> Floats:
    """Return the covariance (2, 2), rad^2, of the boresight from three stars and a known f.

    The axes are east and north at the boresight. For m = S^-1 k, `d(m / |m|)` is the tangential
    part of `S^-1 dk / |m|`, and dk_i = -a_i f (a_i^2 + f^2)^(-3/2) da_i. Stars (3, 3), radii (3,).
    """
    inverse = np.linalg.inv(star_vectors)
    m = inverse @ cosines(a_px, f_px)
    jacobian = np.stack(tangent_basis(m / np.linalg.norm(m))) @ inverse / np.linalg.norm(m)
    weighted = jacobian * cosine_by_radius(a_px, f_px) * sigma_px
    return np.asarray(weighted @ weighted.T)


def unknown_focal_length_covariance(
    star_vectors: Floats, direction: Floats, a_px: Floats, f_px: float, sigma_px: float
) -> Floats:
    """Return the covariance (3, 3) of the boresight and the focal length found with it (4-15).

    Order: east and north at the boresight, rad, and f, px. From the differential of
    s_i . direction = k_i(f, a_i) for stars (3, 3), direction (3,) and radii (3,).
    """
    east, north = tangent_basis(direction)
    system = np.column_stack([
        star_vectors @ east, star_vectors @ north, -cosine_by_focal_length(a_px, f_px)
    ])
    jacobian = np.linalg.solve(system, np.diag(cosine_by_radius(a_px, f_px))) * sigma_px
    return np.asarray(jacobian @ jacobian.T)


def pixel_jacobians(camera_vectors: Floats) -> Floats:
    """Return how pixels move as the camera turns: (n, 2, 3) by rotations about x, y, z.

    In units of the focal length for each radian; `camera_vectors` (n, 3) in the optical frame.
    """
    x, y = (camera_vectors[:, :2] / camera_vectors[:, 2:]).T
    return np.stack([
        np.stack([x * y, -1 - x * x, y], axis=-1), np.stack([1 + y * y, -x * y, -x], axis=-1)
    ], axis=1)


def cramer_rao_covariance(camera_vectors: Floats, sigma_rad: float) -> Floats:
    """Return the smallest covariance (3, 3), rad^2, that any unbiased attitude can have.

    About the camera's axes, for isotropic pixel noise of `sigma_rad` = sigma_px / f on stars
    (n, 3) of the optical frame. Raises LinAlgError for fewer than two directions.
    """
    j = pixel_jacobians(camera_vectors).reshape(-1, 3)
    return np.asarray(sigma_rad**2 * np.linalg.inv(j.T @ j))


def wahba_covariance(camera_vectors: Floats, sigma_rad: float) -> Floats:
    """Return the exact first-order covariance (3, 3), rad^2, of the unweighted Wahba solution.

    About the camera's axes, for isotropic pixel noise of `sigma_rad` = sigma_px / f on stars
    (n, 3) of the optical frame. `attitude.covariance` is its limit near the axis, where pixel
    noise is the same angle in all directions. The solution turns by
    (sum(I - b b^T))^-1 sum(b x db), and a pixel error e moves b by (I - b b^T) e b_z / f.
    """
    b = camera_vectors
    moved = np.zeros((len(b), 2, 3))
    moved[:, 0, 0] = moved[:, 1, 1] = b[:, 2]
    turned = np.cross(b[:, None], moved).reshape(-1, 3)  # b x b vanishes
    inverse = np.linalg.inv(len(b) * np.eye(3) - b.T @ b)
    return np.asarray(sigma_rad**2 * inverse @ (turned.T @ turned) @ inverse)


def boresight_covariance(rotation: Floats, attitude_covariance: Floats) -> Floats:
    """Return the boresight's covariance (2, 2), rad^2, along east and north.

    `rotation` (3, 3) turns camera vectors into ICRS; `attitude_covariance` (3, 3), rad^2, is that
    of the rotation about the camera's axes, which moves the boresight by (theta_y, -theta_x).
    """
    towards = np.stack(tangent_basis(rotation[:, 2])) @ rotation  # east and north, camera axes
    moved = np.column_stack([-towards[:, 1], towards[:, 0]])
    return np.asarray(moved @ attitude_covariance[:2, :2] @ moved.T)


def triples(star_vectors: ArrayLike, a_px: ArrayLike, f_px: float) -> Triples:
    """Return K, volume and predicted error of all triples of stars (n, 3) with radii (n,).

    The stars are ICRS unit vectors, radii and focal length pixels. Triples on one great circle
    have an infinite error. Raises ValueError for fewer than 3 or more than 150 stars.
    """
    stars, a = np.asarray(star_vectors, float), np.asarray(a_px, float)
    if not 3 <= len(stars) <= _MAX_STARS or a.shape != (len(stars),):
        raise ValueError(
            f"{len(stars)} stars with {len(a)} radii: give one radius for each of 3 to "
            f"{_MAX_STARS} stars"
        )
    index = np.array(list(combinations(range(len(stars)), 3)))
    s, radius = stars[index], a[index]
    c, determinant = cofactors(s)
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = c / determinant[:, None, None]  # of the inverses of S
        m = np.einsum("tij,ti->tj", columns, cosines(radius, f_px))
        norm = np.linalg.norm(m, axis=1)
        along = np.einsum("tij,tj->ti", columns, m / norm[:, None])
        across2 = np.einsum("tij,tij->ti", columns, columns) - along**2
        error2 = np.sum(across2 * cosine_by_radius(radius, f_px) ** 2, axis=1) / norm**2
    error = np.where(determinant != 0, np.sqrt(np.maximum(error2, 0)), np.inf)
    return Triples(index, error_factor(s), tetrahedron_volume(s), error)


def ranking(of: Triples, *, by: str = "error") -> NDArray[np.intp]:
    """Return the rows of all triples, the best first: least error or K, or largest volume.

    Raises ValueError for another criterion than `error`, `k` or `volume`.
    """
    if by not in CRITERIA:
        raise ValueError(f"criterion {by!r} is unknown: use {', '.join(CRITERIA)}")
    values = {"error": of.boresight_rad_per_px, "k": of.k, "volume": -of.volume}[by]
    return np.argsort(values, kind="stable")


def best_triple(of: Triples, *, by: str = "error") -> tuple[int, int, int]:
    """Return the star indices of the best triple; criteria and errors are those of `ranking`."""
    first, second, third = of.index[ranking(of, by=by)[0]]
    return int(first), int(second), int(third)


def azimuth_factor(azimuth_rad: ArrayLike, *, fit_norm: bool = False) -> Floats:
    """Return boresight error over radius error for stars at azimuths (..., n) about the boresight.

    All radii carry the same error and f is known; the field is narrow. Least squares of the two
    coordinates of the boresight has the covariance sigma^2 (sum(u u^T))^-1 for the unit vectors u
    towards the stars. It is least, with n = 3, for the azimuths of table 4-1. With `fit_norm` the
    length of m is free too, as in the closed form with stars at equal radii: u then counts from
    its mean.
    """
    azimuth = np.asarray(azimuth_rad, float)
    u = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    if fit_norm:
        u = u - u.mean(axis=-2, keepdims=True)
    information = np.swapaxes(u, -1, -2) @ u
    # The trace of the inverse of a symmetric 2 x 2 matrix.
    trace = information[..., 0, 0] + information[..., 1, 1]
    determinant = information[..., 0, 0] * information[..., 1, 1] - information[..., 0, 1] ** 2
    regular = determinant > _SINGULAR * trace**2
    factor2 = np.divide(trace, determinant, out=np.full(trace.shape, np.inf), where=regular)
    return np.asarray(np.sqrt(factor2))
