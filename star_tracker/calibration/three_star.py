"""The boresight from three stars and their distances from the image's centre (paper, 4.1 and 4.2).

Only the radii a_i of the three star images are used, not their directions in the image: a star
that is seen at a radius a lies arctan(a / f) away from the boresight. Star vectors are rows of
unit vectors in ICRS, radii and focal lengths are pixels, and the boresight is a direction in ICRS.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.geometry.spherical import Floats, ra_dec, separation, tangent_basis
from star_tracker.optics.camera import Camera

#: Triples with a larger K (4-27) are refused: one star lies within some 3.2' of the great circle
#: through the others, and an error of one pixel of 84" moves the boresight of a 12 deg field by
#: 2.9 deg, half of its half-width. K starts at 4 in fields of 20 deg and at 8 in those of 12 deg;
#: in one of 0.5 deg two of three random triples are below the limit (docs/boresight.md).
MAX_ERROR_FACTOR = 1000.0
#: Stars closer than this are one star to any sensor, radians (0.2").
_SAME_STAR_RAD = 1e-6
_MAX_ITERATIONS = 50
#: Newton's method has converged when f changes by less than this fraction.
_CONVERGED = 1e-10


@dataclass(frozen=True)
class Boresight:
    """The boresight that three stars give.

    Attributes:
        direction: (3,) unit vector, ICRS.
        norm: `|m|` as solved; 1 where radii and focal length agree exactly (4-15).
        focal_length_px: the focal length it was computed with, or that was found.
        iterations: Newton steps taken, 0 for a known focal length.
    """

    direction: Floats
    norm: float
    focal_length_px: float
    iterations: int = 0

    @property
    def ra_rad(self) -> float:
        """Right ascension, [0, 2 pi). The quadrant is that of (m31, m32): see (4-11)."""
        return float(ra_dec(self.direction)[0])

    @property
    def dec_rad(self) -> float:
        """Declination (4-10)."""
        return float(ra_dec(self.direction)[1])


def radii_px(camera: Camera, xy_px: ArrayLike) -> Floats:
    """Return the distances a_i (n,) of centroids (n, 2) from the principal point, pixels.

    With a distorting lens they are those that a pinhole of the same focal length would show.
    """
    plane = camera.plane(xy_px)
    return np.asarray(camera.focal_length_px * np.hypot(plane[:, 0], plane[:, 1]))


def cosines(a_px: ArrayLike, f_px: ArrayLike) -> Floats:
    """Return k_i, the cosine of the angle between star and boresight (4-6, 4-13).

    The k_i printed below (4-9) lacks the factor f in its numerator.
    """
    a, f = np.asarray(a_px, float), np.asarray(f_px, float)
    return np.asarray(f / np.hypot(f, a))


def cofactors(star_vectors: Floats) -> tuple[Floats, Floats]:
    """Return the cross products c (..., 3, 3) of stars (..., 3, 3) and their determinant (...).

    c_1 = s_2 x s_3 and so on, in rows: the inverse of the matrix of stars is c^T / determinant.
    """
    s = star_vectors
    c = np.cross(s[..., (1, 2, 0), :], s[..., (2, 0, 1), :])
    return c, np.sum(s[..., 0, :] * c[..., 0, :], axis=-1)


def error_factor(star_vectors: ArrayLike) -> Floats:
    """Return K of triples of unit vectors (..., 3, 3), a star in each row (4-27).

    K^2 = tr(adj(R^T R)) / (2 det(R^T R)), where the trace is the sum of the squared cross
    products of the stars. Infinity for stars on one great circle.
    """
    c, determinant = cofactors(np.asarray(star_vectors, float))
    with np.errstate(divide="ignore"):
        k = np.sqrt(np.sum(c * c, axis=(-2, -1)) / 2) / np.abs(determinant)
    return np.asarray(k)


def tetrahedron_volume(star_vectors: ArrayLike) -> Floats:
    """Return the volume V_s of the tetrahedra that the origin and three stars span (4-29).

    `star_vectors` (..., 3, 3) are unit vectors in rows; the unit is that of the unit sphere.
    """
    return np.asarray(np.abs(cofactors(np.asarray(star_vectors, float))[1]) / 6)


def boresight_linear(star_vectors: ArrayLike, a_px: ArrayLike, f_px: float) -> Boresight:
    """Return the boresight by method one, the linear system S m = k (4-6 to 4-10).

    S holds the star vectors (3, 3) in rows, ICRS, and k the cosines of the radii `a_px` (3,) at
    the focal length `f_px`. m is the boresight times a factor near 1, which is divided out.
    Raises ValueError for input of another shape or sign, or stars that do not fix the boresight.
    """
    stars, a = _checked(star_vectors, a_px, f_px)
    return _boresight(np.asarray(np.linalg.solve(stars, cosines(a, f_px))), f_px)


def boresight_spherical(star_vectors: ArrayLike, a_px: ArrayLike, f_px: float) -> Boresight:
    """Return the boresight by method two, spherical triangles (4-12 to 4-14).

    The law of cosines of each triangle star - boresight - pole, with the pole at the first star
    instead of the celestial one, so that no part of the sky is singular. Seen from there the
    boresight lies at distance rho and position angle theta, and the other stars at c_i and
    theta_i, so that k_i / k_1 = cos c_i + sin c_i tan rho cos(theta - theta_i).
    Arguments and errors are those of `boresight_linear`.
    """
    stars, a = _checked(star_vectors, a_px, f_px)
    k = cosines(a, f_px)
    first, others = stars[0], stars[1:]
    east, north = tangent_basis(first)
    theta_2, theta_3 = np.arctan2(others @ east, others @ north)
    c = separation(first, others)
    q_2, q_3 = (k[1:] / k[0] - np.cos(c)) / np.sin(c)  # tan rho cos(theta - theta_i)
    across = (q_3 - q_2 * np.cos(theta_3 - theta_2)) / np.sin(theta_3 - theta_2)
    theta, rho = theta_2 + np.arctan2(across, q_2), np.arctan(np.hypot(q_2, across))
    towards = np.cos(theta) * north + np.sin(theta) * east
    direction = np.cos(rho) * first + np.sin(rho) * towards
    return Boresight(direction, float(k[0] / np.cos(rho)), float(f_px))


def boresight_unknown_focal_length(
    star_vectors: ArrayLike, a_px: ArrayLike, f0_px: float, *, max_deviation: float = 0.1
) -> Boresight:
    """Return boresight and focal length by Newton's method on `|m(f)|^2 = 1` (4-15).

    In general two focal lengths satisfy it. In a narrow field their boresights are inverse points
    of the circle through the three stars and f_2 / f_1 = d / R, the boresight's distance from
    that circle's centre over its radius; they coincide for a boresight on the circle.

    Args:
        star_vectors: (3, 3) unit vectors in rows, ICRS.
        a_px: (3,) radii.
        f0_px: where to start, for instance the nominal focal length (4-16).
        max_deviation: the fraction by which the true focal length can differ from `f0_px`.

    A step that leaves the bracket of the solution is replaced by halving it, so that exactly one
    focal length within `max_deviation` is always found. Raises ValueError where there is none or
    there are two, and where the stars do not fix a boresight.
    """
    stars, a = _checked(star_vectors, a_px, f0_px)
    if not 0 < max_deviation < 1:
        raise ValueError(f"max_deviation {max_deviation:g} is outside of 0 to 1")
    inverse = np.asarray(np.linalg.inv(stars))
    low, high = f0_px * (1 - max_deviation), f0_px * (1 + max_deviation)
    rising = _excess(inverse, a, high)[0] > 0
    if rising == (_excess(inverse, a, low)[0] > 0):
        raise ValueError(
            f"no focal length or two within {max_deviation:.0%} of {f0_px:.6g} px fit the radii: "
            "unless stars or radii are wrong, the boresight lies near the circle through the "
            "three stars, choose others"
        )
    f = float(f0_px)
    for iteration in range(1, _MAX_ITERATIONS + 1):
        excess, slope = _excess(inverse, a, f)
        low, high = (low, f) if (excess > 0) == rising else (f, high)
        newton = f - excess / slope if slope != 0 else np.inf
        following = newton if low <= newton <= high else (low + high) / 2
        if abs(following - f) <= _CONVERGED * f:
            return _boresight(inverse @ cosines(a, following), following, iteration)
        f = following
    raise ValueError(f"the focal length did not converge in {_MAX_ITERATIONS} steps")


def _boresight(m: Floats, f_px: float, iterations: int = 0) -> Boresight:
    norm = float(np.linalg.norm(m))
    return Boresight(np.asarray(m / norm), norm, float(f_px), iterations)


def _excess(inverse: Floats, a_px: Floats, f_px: float) -> tuple[float, float]:
    """Return |m(f)|^2 - 1 and its derivative by f, for the inverse of the matrix of stars."""
    m = inverse @ cosines(a_px, f_px)
    slope = inverse @ cosine_by_focal_length(a_px, f_px)
    return float(m @ m - 1), float(2 * m @ slope)


def cosine_by_focal_length(a_px: Floats, f_px: float) -> Floats:
    """Return the derivative of k_i by the focal length, 1/px."""
    return np.asarray(a_px**2 / np.hypot(a_px, f_px) ** 3)


def cosine_by_radius(a_px: Floats, f_px: float) -> Floats:
    """Return the derivative of k_i by the radius a_i, 1/px."""
    return np.asarray(-a_px * f_px / np.hypot(a_px, f_px) ** 3)


def _checked(star_vectors: ArrayLike, a_px: ArrayLike, f_px: float) -> tuple[Floats, Floats]:
    """Return stars (3, 3) and radii (3,) as arrays; raise ValueError for what gives no answer."""
    stars, a = np.asarray(star_vectors, float), np.asarray(a_px, float)
    if stars.shape != (3, 3) or a.shape != (3,):
        raise ValueError(
            f"three stars need vectors (3, 3) and radii (3,), not {stars.shape} and {a.shape}"
        )
    if not np.allclose(np.linalg.norm(stars, axis=1), 1.0, rtol=0, atol=1e-9):
        raise ValueError("the star vectors are not unit vectors")
    if not (np.all(np.isfinite(a)) and np.all(a >= 0)):
        raise ValueError(
            "the radii must be finite numbers of pixels, 0 or more: give the distance of each "
            "star from the principal point"
        )
    if not (np.isfinite(f_px) and f_px > 0):
        raise ValueError("the focal length must be a finite number of pixels greater than 0")
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if separation(stars[i], stars[j]) < _SAME_STAR_RAD:
            raise ValueError(f"stars {i + 1} and {j + 1} have the same direction: choose others")
    k = float(error_factor(stars))
    if not k <= MAX_ERROR_FACTOR:
        raise ValueError(
            f"the three stars lie nearly on one great circle (K = {k:.4g}, at most "
            f"{MAX_ERROR_FACTOR:g}): they do not fix the boresight, choose others"
        )
    return stars, a
