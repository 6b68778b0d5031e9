"""Brightness as evidence: matched centroids differ in magnitude as their guide stars do.

If the matches are true, instrumental magnitudes differ from the catalogue's by one zero point and
some scatter; if not, they are any of the frame's. A pose whose places alone leave no doubt is not
asked for it: it takes longer than they do.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats

#: Brightness as evidence: scatter of a star's measured about its catalogue magnitude (colour
#: included), share of stars for which that does not hold, range of the unknown zero point, and
#: share of frames whose intensities mean anything.
_MAGNITUDE_SIGMA, _MAGNITUDE_OUTLIERS = 0.3, 0.1
_ZERO_POINT_RANGE, _MEANINGFUL = 3.0, 0.5
#: No field of stars scatters more than this, magnitudes (the catalogue to V = 8: 1.0). Intensities
#: that do mean nothing: most of them alike and one of 1e12 made wrong poses look certain.
_WIDEST_SCATTER = 2.0
#: Magnitudes as near as that are alike, where a frame's are counted: a box of the same area as the
#: normal distribution of a star's scatter.
_ALIKE = _MAGNITUDE_SIGMA * np.sqrt(2 * np.pi) / 2
#: Evidence of places that needs no other: more than ends any search (`search.certain`), in all or
#: a centroid.
_PLENTY, _PLENTY_A_STAR = 40.0, 0.8


@compiled
def with_brightness(
    score: float, frame: Any, v_mag: Floats,
    matches: tuple[NDArray[np.int64], NDArray[np.int64]], k: int,
) -> float:
    """Return log10 evidence of the first `k` matches, of places, with that of brightness.

    `matches` are indices into the frame, which has brightness, and the catalogue.
    Where it is plenty without it stays; brightness lifts it no farther than that, so that of two
    poses the one with more evidence of places keeps more where either has plenty.
    """
    plenty = max(_PLENTY, _PLENTY_A_STAR * frame.n)
    if score >= plenty:
        return score
    if not frame.usual_is_known:
        write_magnitudes(frame.intensity, frame.n, frame.magnitude)
        how_usual(frame.magnitude, frame.n, frame.usual)
        frame.usual_is_known = True
    seen = frame.magnitude, frame.usual
    return min(score + brightness(seen, v_mag, matches[0], matches[1], k), plenty)


@compiled
def write_magnitudes(intensity: Floats, n: int, magnitude: Floats) -> None:
    """Write the instrumental magnitudes of the first `n` intensities, NaN = not known."""
    for i in range(n):
        magnitude[i] = -2.5 * np.log10(intensity[i]) if intensity[i] > 0.0 else np.nan


@compiled
def how_usual(magnitude: Floats, n: int, usual: Floats) -> None:
    """Write how usual each of the first `n` magnitudes is among a frame's; NaN = not known.

    Half by their normal distribution, half as they are. By the former alone a star among hundreds
    of points that are all alike was more unusual than can be: of 40 frames with 400 such points
    7 were solved wrongly. All 0 where they scatter so much that they mean nothing.
    """
    mean = spread = 0.0
    known = 0
    for i in range(n):
        if np.isfinite(magnitude[i]):
            mean += magnitude[i]
            spread += magnitude[i] * magnitude[i]
            known += 1
    if known == 0:
        return
    mean /= known
    variance = max(spread / known - mean * mean, _MAGNITUDE_SIGMA**2)
    peak = _MAGNITUDE_SIGMA / np.sqrt(variance) if variance <= _WIDEST_SCATTER**2 else 0.0
    for i in range(n):
        alike = 0
        for j in range(n):
            alike += abs(magnitude[j] - magnitude[i]) < _ALIKE
        normal = peak * np.exp(-0.5 * (magnitude[i] - mean) ** 2 / variance)
        usual[i] = 0.5 * (normal + alike / known) if peak > 0.0 else 0.0


@compiled
def brightness(
    seen: tuple[Floats, Floats],
    v_mag: Floats,
    observed: NDArray[np.int64],
    catalog: NDArray[np.int64],
    k: int,
) -> float:
    """Return log10 of the evidence that brightness adds to the first `k` matches.

    `seen` is the frame's magnitudes and how usual they are. Never less than -0.3: the intensities
    may mean nothing, which then cost half of a pose's evidence and no more.
    """
    magnitude, usual = seen
    difference = np.empty(k)
    n = 0
    for i in range(k):
        value = magnitude[observed[i]] - v_mag[catalog[i]]
        if np.isfinite(value):
            difference[n] = value
            n += 1
    if n < 3:
        return 0.0
    zero_point = np.median(difference[:n])
    total = np.log(_MAGNITUDE_SIGMA * np.sqrt(2 * np.pi / n) / _ZERO_POINT_RANGE)
    for i in range(k):
        off = magnitude[observed[i]] - v_mag[catalog[i]] - zero_point
        if np.isfinite(off):
            any_star = usual[observed[i]]
            if any_star == 0.0:
                return np.log10(1 - _MEANINGFUL)
            ratio = np.exp(-0.5 * (off / _MAGNITUDE_SIGMA) ** 2) / any_star
            total += np.log((1 - _MAGNITUDE_OUTLIERS) * ratio + _MAGNITUDE_OUTLIERS)
    # log(share e^total + 1 - share) without overflow.
    high = max(total, 0.0)
    return (
        high + np.log(_MEANINGFUL * np.exp(total - high) + (1 - _MEANINGFUL) * np.exp(-high))
    ) / np.log(10.0)
