"""The evidence of a frame of a stream: what the frames before it have taught of its centroids.

Alone, a frame has any noise about a typical one, and any share of its centroids are stars
(`evidence.py`). After others of the same camera both are known better: the noise has a scaled
inverse chi-square distribution of more degrees of freedom about what was seen, and the share of
stars a beta distribution, so that k of n centroids are stars with the beta-binomial probability
(Gelman et al. 2013, 2.6 and 5.3) in place of 1 / (min(n, m) + 1). Both factors average to 1 over
all k and all noises, as those of a lone frame do, so that B keeps its meaning.

A stream may change from one frame to the next. So the two are believed half and half,

    B = (B_alone + B_stream) / 2,

and a frame that is not like those before it loses no more than half of its evidence.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled, inlined

#: What is expected of the next frame: the noise, as `freedom` and `scale_px2` of `Evidence`, and
#: the parameters of the share of stars. Where `freedom` is 0 nothing is.
EXPECTED = np.dtype([
    ("freedom", np.float64), ("scale_px2", np.float64), ("stars", np.float64),
    ("false_stars", np.float64),
])
#: Squared residuals that are larger than this quantile, in standard deviations of a normal
#: distribution (99 %), are those of another noise than was expected.
_SURPRISING = 2.326


class Expectation(NamedTuple):
    """What is expected of the next frame of a stream.

    Attributes:
        sigma_px: noise of a centroid along each axis.
        freedom: how sure it is: that of so many residuals, more than 1.
        stars, false_stars: parameters of the beta distribution of the share of stars among the
            centroids, as if so many of each had been seen.
    """

    sigma_px: float
    freedom: float
    stars: float
    false_stars: float


def nothing_expected() -> NDArray[np.void]:
    """Return what searchers look at (1,), of `EXPECTED`, with nothing in it."""
    return np.zeros(1, EXPECTED)


def expect(what: Expectation | None, expected: NDArray[np.void]) -> None:
    """Write what is expected from now on; None for nothing."""
    if what is None:
        expected[0] = (0.0, 0.0, 0.0, 0.0)
        return
    expected[0] = (
        what.freedom, what.freedom * what.sigma_px**2, what.stars, what.false_stars
    )


@compiled
def begin(expected: Any, n: int, m: int, half: float) -> tuple[float, float, float]:
    """Return what `gain` needs for three matches of n centroids and m guide stars in view.

    That is the logarithm of what depends on neither residuals nor noise, half of the degrees of
    freedom, and the logarithm of their gamma function. `half` are those of the matches alone.
    """
    a, b, k = expected.stars, expected.false_stars, 3
    of_noise = 0.5 * expected.freedom
    offset = (
        math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k + 1.0)
        + math.lgamma(k + a) + math.lgamma(n - k + b) - math.lgamma(n + a + b)
        + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
        + np.log(min(n, m) + 1.0)
        + of_noise * np.log(0.5 * expected.scale_px2) - math.lgamma(of_noise)
    )
    return offset, of_noise + half, math.lgamma(of_noise + half)


@inlined
def one_more(
    expected: Any, state: tuple[float, float, float], n: int, k: int
) -> tuple[float, float, float]:
    """Return the state of `begin` for k + 1 matches, given that of k."""
    offset, half, log_gamma = state
    more = (k + expected.stars) * (n - k) / ((k + 1.0) * (n - k - 1.0 + expected.false_stars))
    return offset + np.log(max(more, 1e-300)), half + 1.0, log_gamma + np.log(half)


@inlined
def gain(expected: Any, state: tuple[float, float, float], s: float, of_noise: float) -> float:
    """Return the logarithm of what the stream adds to the evidence of matches.

    `s` is the sum of their squared residuals and `of_noise` the part of a lone frame's log
    evidence that depends on the noise.
    """
    offset, half, log_gamma = state
    ratio = offset + log_gamma - half * np.log(0.5 * (s + expected.scale_px2)) - of_noise
    return np.log(0.5 + 0.5 * np.exp(min(ratio, 500.0)))


@compiled
def is_as_expected(expected: Any, sum2: float, freedom: int) -> bool:
    """Return whether squared residuals of so many degrees of freedom may have the noise expected.

    Only larger ones may not: chance makes few residuals small.
    """
    if expected.freedom == 0.0:
        return False
    bound = chi_square_bound(freedom, _SURPRISING)
    return sum2 <= bound * expected.scale_px2 / expected.freedom


@inlined
def chi_square_bound(freedom: int, sigmas: float) -> float:
    """Return what a chi-square distribution exceeds as rarely as a normal one so many sigmas.

    Wilson and Hilferty (1931).
    """
    part = 2.0 / (9.0 * freedom)
    return freedom * (1.0 - part + sigmas * math.sqrt(part)) ** 3
