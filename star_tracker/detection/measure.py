"""Peaks of the filtered image -> stars: what is one, what only looks like one, and where it is.

Peaks are taken from the brightest on, and each star found is taken out of the image before the
next peak is looked at; so the wings of a bright star do not become stars, and of two that overlap
both are fitted.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.centroids import Flag
from star_tracker.detection.fit import fit_star, fitting
from star_tracker.detection.hot import is_hot
from star_tracker.detection.moments import adaptive_moments, is_endless
from star_tracker.detection.planes import Plane
from star_tracker.detection.psf import PIXEL_VARIANCE, Psf
from star_tracker.detection.stars import Scene, Star, Stars, add_star, noise_at
from star_tracker.geometry.spherical import Floats

_SATURATED, _EDGE = int(Flag.SATURATED), int(Flag.EDGE)
_STREAK, _HOT, _EXTENDED = int(Flag.STREAK), int(Flag.HOT), int(Flag.EXTENDED)
SUSPECT = _STREAK | _HOT | _EXTENDED
#: The first fit only has to tell what a peak is.
_ROUGHLY_PX = 0.008
#: A star's width is within this factor of the image's, and its square is explained up to this.
_WIDTH_FACTOR, _UNEXPLAINED = 2.2, 0.35
#: A star saturates up to where it is this many times fainter than its peak; a lamp does more. Ten
#: magnitudes: from the brightest star to where the sensor saturates.
_SATURATED_RANGE = 1e4


#: Two peaks closer than so many widths disturb each other's fits; without what is farther out than
#: the core, by so many widths, they do less.
_CROWDED, _CORE = 6.0, 1.3


class Hunt(NamedTuple):
    """What peaks are judged by.

    Attributes:
        psf: the image of a star.
        flatness: of the sharpest star, see `psf.flatness`.
        threshold: least signal to noise.
        most: so many stars are enough.
        suspects: whether what is no star is measured, too.
    """

    psf: Psf
    flatness: float
    threshold: float
    most: int
    suspects: bool


@compiled
def measure(
    scene: Scene, peaks: NDArray[np.int64], brightness: Plane, hunt: Hunt,
    found: tuple[Stars, Floats],
) -> int:
    """Write the stars, and what only looks like one, of peaks (m, 2); return their number.

    `brightness` (h, w) is the filtered image; `found` has room for m rows of `STAR` and (m, 3)
    fluxes.
    """
    stars, fluxes = found
    claimed = np.zeros(scene.residual.shape, np.uint8)
    n = n_good = 0
    for k in range(len(peaks)):
        row, column = peaks[k]
        if n_good == hunt.most:
            break
        if claimed[row, column]:
            continue
        star = stars[n]
        _begin(scene, star, (row, column), brightness, hunt.psf)
        fluxes[n, :] = star.flux
        _saturated(scene, star, claimed, hunt.psf)
        _judge(scene, star, fluxes[n], hunt)
        if star.flags & SUSPECT == _EXTENDED and _is_crowded(peaks, k, hunt.psf):
            # The core alone tells whether it is a star that another one disturbs.
            _begin(scene, star, (row, column), brightness, hunt.psf)
            fluxes[n, :], star.reach = star.flux, -_CORE * star.sigma
            _judge(scene, star, fluxes[n], hunt)
            star.reach = 0.0
        if star.flags & SUSPECT == 0:
            if star.snr < hunt.threshold:
                continue
            add_star(scene, star, fluxes[n], hunt.psf, -1.0)
            n_good += 1
        n += 1
    return n


@compiled
def _begin(
    scene: Scene, star: Star, peak: tuple[int, int], brightness: Plane, psf: Psf
) -> None:
    """Write what a peak, row and column, tells of a star before it is fitted."""
    row, column = peak
    star.x = column + 0.5 + _vertex(brightness, row, column, 0, 1)
    star.y = row + 0.5 + _vertex(brightness, row, column, 1, 0)
    star.sigma = psf.sigma_px
    star.background = star.reach = star.snr = star.unexplained = 0.0
    star.flags = star.neighbours = 0
    star.flux = brightness[row, column]
    star.peak = _peak(scene.residual, row, column)
    star.noise = noise_at(scene, star.x, star.y)


@compiled
def _is_crowded(peaks: NDArray[np.int64], k: int, psf: Psf) -> bool:
    """Return whether just one other peak stands where a round star's pixels still count.

    More than one are no pair of stars but pieces of a trail or a cloud.
    """
    if psf.dx_px != 0.0 or psf.dy_px != 0.0:
        return False
    near = _CROWDED * math.sqrt(psf.sigma_px**2 + PIXEL_VARIANCE) + 1.0
    n = 0
    for other in range(len(peaks)):
        apart = math.hypot(
            peaks[other, 0] - peaks[k, 0], peaks[other, 1] - peaks[k, 1]
        )
        n += 0.0 < apart < near
    return n == 1


@compiled
def _vertex(brightness: Plane, row: int, column: int, down: int, right: int) -> float:
    """Return where the parabola through a peak and its neighbours along an axis is highest."""
    height, width = brightness.shape
    if not (down <= row < height - down and right <= column < width - right):
        return 0.0
    before, after = brightness[row - down, column - right], brightness[row + down, column + right]
    curvature = 2.0 * brightness[row, column] - before - after
    return 0.5 * float(after - before) / curvature if curvature > 0.0 else 0.0


@compiled
def _peak(residual: Plane, row: int, column: int) -> float:
    """Return the highest pixel of a peak's neighbourhood."""
    height, width = residual.shape
    rows = residual[max(row - 1, 0) : min(row + 2, height)]
    return float(np.max(rows[:, max(column - 1, 0) : min(column + 2, width)]))


@compiled
def _judge(scene: Scene, star: Star, flux: Floats, hunt: Hunt) -> None:
    """Fit a star and say what it is."""
    height, width = scene.residual.shape
    saturated = star.flags & _SATURATED != 0
    if star.flags & SUSPECT:
        return
    if not saturated and is_hot(scene, int(star.y), int(star.x), hunt.flatness):
        star.flags |= _HOT
        return
    psf = hunt.psf
    begin_x, begin_y = star.x, star.y
    settled = fit_star(scene, star, flux, psf, fitting(star, psf, _ROUGHLY_PX))
    widest = _WIDTH_FACTOR * psf.sigma_px if not saturated else np.inf
    if settled and star.sigma < psf.sigma_px / _WIDTH_FACTOR:
        star.flags |= _HOT
    elif not settled and saturated:
        # The wings tell nothing: the middle of the saturated pixels has to do.
        star.x, star.y, star.sigma = begin_x, begin_y, psf.sigma_px
        star.snr = star.peak / star.noise
    elif not settled or star.sigma > widest or (
        star.unexplained > _UNEXPLAINED and not saturated
    ):
        star.flags |= _EXTENDED
        if hunt.suspects:
            _drawn(scene, star, (begin_x, begin_y), psf)
    margin = 2.0 * star.sigma + 0.5
    if min(star.x, star.y, width - star.x, height - star.y) < margin:
        star.flags |= _EDGE


@compiled
def _drawn(scene: Scene, star: Star, begin: tuple[float, float], psf: Psf) -> None:
    """Turn what is extended into a streak where it is as narrow as a star; find its middle."""
    moments = adaptive_moments(scene.residual, begin[0], begin[1], psf.sigma_px)
    star.x, star.y = begin
    if math.isnan(moments[0]) or is_endless(moments):
        return
    half = 0.5 * (moments[2] + moments[4])
    spread = math.hypot(0.5 * (moments[2] - moments[4]), moments[3])
    star.x, star.y, star.sigma = moments[0], moments[1], math.sqrt(half)
    narrow = half - spread < (_WIDTH_FACTOR * psf.sigma_px) ** 2
    if narrow and half + spread > _WIDTH_FACTOR**2 * max(half - spread, 0.0):
        star.flags = (star.flags & ~_EXTENDED) | _STREAK


@compiled
def _saturated(scene: Scene, star: Star, claimed: NDArray[np.uint8], psf: Psf) -> None:
    """Where a star is saturated, start from the middle of the saturated pixels and claim them."""
    height, width = claimed.shape
    row, column = int(star.y), int(star.x)
    level = scene.saturation_level
    most = int(2 * math.pi * psf.sigma_px**2 * math.log(_SATURATED_RANGE)) + 9
    most += int(2 * psf.sigma_px * math.hypot(psf.dx_px, psf.dy_px))
    places = np.empty((most, 2), np.int64)
    n = 0
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(column - 1, 0), min(column + 2, width)):
            if scene.pixels[i, j] >= level and not claimed[i, j] and n == 0:
                claimed[i, j] = 1
                places[0], n = (i, j), 1
    if n == 0:
        return
    done, sum_x, sum_y = 0, 0.0, 0.0
    while done < n < most:
        y, x = places[done]
        done += 1
        sum_x += x + 0.5
        sum_y += y + 0.5
        for i in range(max(y - 1, 0), min(y + 2, height)):
            for j in range(max(x - 1, 0), min(x + 2, width)):
                if scene.pixels[i, j] >= level and not claimed[i, j] and n < most:
                    claimed[i, j] = 1
                    places[n], n = (i, j), n + 1
    star.flags |= _SATURATED
    if n >= most:
        star.flags |= _EXTENDED
        return
    star.x, star.y = sum_x / n, sum_y / n
    star.reach = math.sqrt(n / math.pi)
