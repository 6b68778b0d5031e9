"""How strong is a pose? The Bayes factor of "these stars are matched" against "nothing is".

A frame of n centroids is either unrelated to the catalogue, each centroid anywhere in the image of
area A, or it shows, at a pose R, k of the m guide stars that are in the image, the other n - k
centroids being false. With k of n and k of m drawn at random, all values of k equally likely, and
matched centroids normally distributed about their predicted places with standard deviation sigma::

    B(R, sigma) = (n - k)! / n!  *  k! (m - k)! / m!  /  (min(n, m) + 1)
                  *  (A / (2 pi sigma^2))^k  exp(-S / (2 sigma^2)),

S being the sum of squared residuals. Two things are not known and integrated out. The pose, which
is uniformly distributed over all rotations (volume 8 pi^2): about the best fit this gives
(2 pi)^1.5 (sigma / f)^3 det(M)^-0.5 / (8 pi^2) with M = sum(I - b b^T). And sigma^2, which has
a scaled inverse chi-square distribution of nu degrees of freedom about a typical sigma_0^2 (Gelman
et al. 2013, 2.6): wide (nu = 1) where the noise is not known, narrow where it is.

Averaged over unrelated frames B is at most 1, so that by Markov's inequality at most one unrelated
frame in x reaches B > x anywhere on the sky: searching more of it need not be charged. Hence
-log10 B is reported as the log10 of expected false alarms. See Shuster and Oh (1981) for M, and
Lang et al. (2010) for a likelihood ratio in the service of astrometry.

Where the focal length is not known, log f is a fourth unknown, integrated out over a uniform prior
of `log_range`: (2 pi)^2 (sigma / f)^4 / sqrt(det) / (8 pi^2 log_range) with the information matrix
of `attitude.joint_fit`. A search over many focal lengths is so charged for all of them at once.
Where one is told and may be wrong, the told one and the range share the belief, half each. What
the frames of a stream teach shares it in the same way (`stream.py`).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri, gammaln

from star_tracker.attitude.information import (
    adjugate,
    determinant,
    with_direction,
    with_scale,
)
from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.stream import (
    begin,
    gain,
    is_as_expected,
    nothing_expected,
    one_more,
)

#: Centroid noise where none is given: a typical value, px, and how sure that is.
_TYPICAL_SIGMA_PX = 0.7
_UNKNOWN_FREEDOM = 1.0
#: How sure a given noise is: that of 10 stars' residuals, 15 % of sigma.
_KNOWN_FREEDOM = 20.0
#: No detector's centroids and no lens's model are better than this, px.
_FLOOR_PX = 0.01
#: The bound that an attitude's errors should keep within so often, and degrees of freedom beyond
#: which a variance is as good as known.
_BOUND, _MOST_FREEDOM = 0.99, 400
#: Focal lengths are searched so many times the tolerance away: it is told in round numbers.
_BEYOND_TOLERANCE = 1.1


class ScalePrior(NamedTuple):
    """What is known of the focal length beforehand, as a multiple of the camera's own.

    Attributes:
        low, high: least and greatest log of it.
        log_range: of the whole range that is searched, of which low to high may be a part.
        told: whether the camera's own is more than a place in the range.
        sigma: standard deviation of its log about 0; 0 = it is exact, infinity = any will do.
    """

    low: float
    high: float
    log_range: float
    told: bool
    sigma: float


#: The camera is exactly as told.
EXACT = ScalePrior(0.0, 0.0, 0.0, True, 0.0)


def scale_prior(tolerance_percent: float) -> ScalePrior:
    """Return what is known of a focal length that is told with a tolerance, 0 = exact."""
    if tolerance_percent == 0:
        return EXACT
    reach = math.log1p(_BEYOND_TOLERANCE * tolerance_percent / 100)
    return ScalePrior(-reach, reach, 2 * reach, True, math.log1p(tolerance_percent / 100))


#: By so much the focal length of a camera may be wrong that was told as exact.
DOUBT = scale_prior(10.0)


class Evidence(NamedTuple):
    """What does not change from frame to frame.

    Attributes:
        log_factorial: (most + 1,) natural logarithms of 0!, 1!, ...
        log_gamma: (2 most + 4,) natural logarithms of gamma(nu / 2), gamma((nu + 1) / 2), ...
        freedom: nu, how sure the noise is.
        scale_px2: nu sigma_0^2.
        widening: by how much a variance of so many degrees of freedom is widened; see `variance`.
        expected: (1,) of `stream.EXPECTED`: what does change, as earlier frames teach it.
    """

    log_factorial: Floats
    log_gamma: Floats
    freedom: float
    scale_px2: float
    widening: Floats
    expected: NDArray[np.void]


def evidence(
    most: int, centroid_sigma_px: float, expected: NDArray[np.void] | None = None
) -> Evidence:
    """Prepare for up to `most` centroids and guide stars; a noise of 0 px stands for unknown.

    `expected` (1,) is what earlier frames teach, None for a lone frame.
    """
    known = centroid_sigma_px > 0
    sigma = centroid_sigma_px if known else _TYPICAL_SIGMA_PX
    freedom = _KNOWN_FREEDOM if known else _UNKNOWN_FREEDOM
    degrees = np.arange(1, _MOST_FREEDOM)
    widening = np.ones(_MOST_FREEDOM)
    widening[1:] = fdtri(3, degrees, _BOUND) / (chdtri(3, 1 - _BOUND) / 3)
    return Evidence(
        gammaln(np.arange(most + 1) + 1.0), gammaln(0.5 * (freedom + np.arange(2 * most + 4))),
        freedom, freedom * sigma**2, widening,
        nothing_expected() if expected is None else expected,
    )


@compiled
def variance(e: Evidence, sum2: float, k: int, free: bool) -> float:
    """Return the variance of a centroid along each axis, px^2, to be believed of k matches.

    What was told of the noise and the squared residuals together (Gelman et al. 2013, 2.6), or the
    residuals alone where nothing was: what is typical would hide how good a detector is. What
    earlier frames have taught joins them too, unless the residuals are too large for that. Few
    residuals may all be small by chance, so that the variance is widened until an error beyond the
    99 % bound of a normal distribution with it is as rare as it should be, which makes it that of
    Student's distribution there. Never below `_FLOOR_PX`.
    """
    # Three of the 2 k coordinates went into the rotation, and one into the focal length.
    freedom, scale_px2 = 2 * k - (4 if free else 3), sum2
    if e.freedom > _UNKNOWN_FREEDOM:
        freedom += int(e.freedom)
        scale_px2 += e.scale_px2
    elif is_as_expected(e.expected[0], sum2, freedom):
        freedom += int(e.expected[0].freedom)
        scale_px2 += e.expected[0].scale_px2
    value = scale_px2 / freedom * e.widening[min(freedom, len(e.widening) - 1)]
    return max(value, _FLOOR_PX * _FLOOR_PX)


@compiled
def strongest(
    sky: Any, frame: Any, pose: Any, matches: Any, n_seen: tuple[int, int]
) -> tuple[int, float]:
    """Return how many of the best matches carry most evidence (3 or more), and its log10.

    Args:
        sky: camera and `Evidence`.
        frame: all centroids.
        pose: whose scale is known or fitted.
        matches: the matched ones, `observed`, in ascending order of `residual2`.
        n_seen: how many are matched, 3 or more, and m, how many guide stars are in the image.
    """
    e, optics, vectors, observed = sky.evidence, sky.optics, frame.vectors, matches.observed
    n_matched = n_seen[0]
    n, m = frame.n, max(n_seen[1], n_matched)
    constant = _of_frame(sky, pose, n, m)
    per_star = np.log(optics[0] * optics[1] / (2 * np.pi))
    information, of_scale = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    s = 0.0
    at = 2 if pose.free else 3
    half = 0.5 * (e.freedom + at)
    of_prior = 0.5 * e.freedom * np.log(0.5 * e.scale_px2) - e.log_gamma[0]
    expected, stream = e.expected[0], (0.0, 0.0, 0.0)
    if expected.freedom > 0.0:
        stream = begin(expected, n, m, 0.5 * at)
    best, most = -np.inf, 0
    for i in range(n_matched):
        b = vectors[observed[i]]
        information = with_direction(information, b[0], b[1], b[2])
        if pose.free:
            of_scale = with_scale(of_scale, b[0], b[1], b[2])
        s += matches.residual2[i]
        k = i + 1
        if k < 3:
            continue
        size = _size(information, of_scale, pose.free)
        of_noise = of_prior + e.log_gamma[at] - half * np.log(0.5 * (s + e.scale_px2))
        value = constant + of_noise + k * per_star - 0.5 * np.log(max(size, 1e-300))
        value += e.log_factorial[n - k] + e.log_factorial[k] + e.log_factorial[m - k]
        if expected.freedom > 0.0:
            value += gain(expected, stream, s, of_noise)
            stream = one_more(expected, stream, n, k)
        if value > best:
            best, most = value, k
        at += 2
        half += 1.0
    return most, best / np.log(10.0)


@inlined
def _size(m: Any, c: Any, free: bool) -> float:
    """Return the determinant of the information about rotation, and scale where that is free."""
    a = adjugate(m)
    size = determinant(m, a)
    if free:
        size = size * c[2] - (
            c[0] * c[0] * a[0] + 2 * c[0] * c[1] * a[1] + c[1] * c[1] * a[3]
        )
    return size


@compiled
def _of_frame(sky: Any, pose: Any, n: int, m: int) -> float:
    """Return the part of the log evidence that n centroids and m guide stars have anyway."""
    e, prior = sky.evidence, sky.scale_prior
    constant = (
        -np.log(min(n, m) + 1.0)
        - e.log_factorial[n] - e.log_factorial[m]
        + 1.5 * np.log(2 * np.pi) - np.log(8 * np.pi**2) - 3 * np.log(sky.focal_px * pose.scale)
    )
    if pose.free:
        constant += 0.5 * np.log(2 * np.pi) - np.log(sky.focal_px * pose.scale)
        constant -= np.log(prior.log_range)
    if prior.told and prior.log_range > 0.0:
        constant += np.log(0.5)
    return constant
