"""The image of a star as this image shows it: from its bright, unsaturated peaks."""

import math

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.centroids import PSF_RANGE_PX
from star_tracker.detection.fit import Fitting, fit_star
from star_tracker.detection.hot import is_hot
from star_tracker.detection.moments import adaptive_moments
from star_tracker.detection.psf import PIXEL_VARIANCE, Psf, flatness
from star_tracker.detection.stars import STAR, Scene, Star, Stars
from star_tracker.geometry.spherical import Floats

#: So many stars tell the width well enough, and fewer than these do not tell it at all.
_MOST, _FEWEST = 24, 3
#: So many peaks are looked at, so many of them are fitted, and so many give their moments.
_MOST_PEAKS, _MOST_FITS, _MOST_MOMENTS = 150, 60, 15
#: A star wider by this factor than supposed needs a larger window, so many times at the most.
_WIDER, _WINDOWS = 1.3, 3
#: Room about a star beyond a fit's usual window, and the widest that is looked for, in widths:
#: what is wider is for an image of larger pixels.
_ROOM, _WIDEST = 1.4, 4.0
#: Their least signal to noise: a width is then good to some 20 %.
_LEAST_SNR = 7.0
#: Nothing is supposed of the width itself: a prior of this standard deviation of its logarithm.
_ANY_WIDTH, _ROUGHLY_PX = 3.0, 0.02
#: Stars are drawn to lines where half of them are longer than wide by this factor, and these
#: point the same way: the length of the mean direction, from 0 for all ways to 1 for one.
_LONG, _SAME_WAY = 1.8, 0.8
#: A line's length in the unit that adaptive moments give it. A window of standard deviation w
#: over an endless line shows w^2; on a line of length 2 a w it is w^2 / 2 at a = 1.4 (where
#: 2 a phi(a) = Phi(a) - 1/2), which is where the moments settle.
_LINE = 2.8
#: Longer lines than this, px, are longer than their moments can tell.
LONGEST_PX = 66.0
#: A line's peaks are those within so many of its own standard deviations, squared: half of the
#: length. It ends before the border by so many px and widths, or else it is cut off there.
_ON_LINE, _BORDER_PX, _BORDER_SIGMAS = (0.5 * _LINE) ** 2, 1.0, 2.0


def image_psf(
    scene: Scene, peaks: NDArray[np.int64], first: Psf, sigma_px: float | None
) -> Psf | None:
    """Return the image of a star from peaks (n, 2), row and column; None where too few show it.

    `first` is what they were found with, `sigma_px` the width where it is known. The width is that
    of the densest half of all: where many peaks are hot pixels, clouds or lamps, these are of all
    widths but stars are of one. Of lines of `LONGEST_PX` and more only the direction is known.
    """
    shapes = np.empty((_MOST, 4))
    sharpest = flatness(Psf(PSF_RANGE_PX[0]))
    known = (first, sharpest, scene.saturation_level)
    n = _shapes(scene, peaks, known, np.zeros(1, STAR), shapes)
    if np.count_nonzero(np.isfinite(shapes[:n, 0])) < _FEWEST and _common_line(shapes[:n]) is None:
        # The wings of saturated stars have a width, too; charge that runs over makes lines.
        n = _shapes(scene, peaks, (first, sharpest, np.inf), np.zeros(1, STAR), shapes)
        shapes[:, 1:] = np.nan
    line = _common_line(shapes[:n])
    widths = shapes[:n, 0][np.isfinite(shapes[:n, 0])]
    if line is not None:
        sigma, dx, dy = line
    elif len(widths) < _FEWEST:
        return None
    else:
        sigma, dx, dy = math.exp(_densest(np.log(widths))), 0.0, 0.0
    low, high = PSF_RANGE_PX
    return Psf(sigma_px or min(max(sigma, low), high), dx, dy)


def _densest(values: Floats) -> float:
    """Return the median of the half of the values that lie closest together."""
    ordered = np.sort(values)
    half = (len(ordered) + 1) // 2
    begin = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
    return float(np.median(ordered[begin : begin + half]))


def _common_line(shapes: Floats) -> tuple[float, float, float] | None:
    """Return width and line (dx, dy) of stars that are drawn to lines, None where they are not."""
    xx, xy, yy = shapes[:, 1:].T
    usable = np.isfinite(xx)
    if np.count_nonzero(usable) < _FEWEST:
        return None
    xx, xy, yy = xx[usable], xy[usable], yy[usable]
    half, spread = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    wide = np.maximum(half - spread, PIXEL_VARIANCE)
    long = (half + spread) > _LONG**2 * wide
    if np.count_nonzero(long) < max(_FEWEST, len(xx) / 2):
        return None
    # An axis has no sense of direction: twice its angle has.
    twice = ((0.5 * (xx - yy) + 1j * xy) / spread)[long]
    mean = np.mean(twice)
    if abs(mean) < _SAME_WAY:
        return None
    length = _LINE * math.exp(0.5 * _densest(np.log(2 * spread[long])))
    angle = 0.5 * float(np.angle(mean))
    sigma = math.sqrt(max(float(np.median(wide[long])) - PIXEL_VARIANCE, PSF_RANGE_PX[0] ** 2))
    return sigma, length * math.cos(angle), length * math.sin(angle)


@compiled
def _shapes(
    scene: Scene, peaks: NDArray[np.int64], known: tuple[Psf, float, float], stars: Stars,
    shapes: Floats,
) -> int:
    """Write the width and the moments xx, xy, yy of peaks that may be stars; return their number.

    `known` is the image of a star, how flat the sharpest is, and the value that no pixel reaches.
    The width is that of a round star fitted to the peak, NaN where none fits. The moments tell
    lines from points: those of some are enough. A line gives them once, and none where the border
    cuts it off.
    """
    psf, sharpest, limit = known
    lines = np.empty((_MOST_MOMENTS, 5))
    n = n_fits = n_lines = 0
    for k in range(min(len(peaks), _MOST_PEAKS)):
        if n == len(shapes) or n_fits == _MOST_FITS:
            break
        row, column = peaks[k]
        brightest = np.max(scene.pixels[
            max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2
        ])
        if not brightest < limit or is_hot(scene, row, column, sharpest):
            continue
        if _is_on_line(lines, n_lines, column + 0.5, row + 0.5):
            continue  # a bright streak has many peaks, and one length
        n_fits += 1
        shapes[n] = np.nan
        shapes[n, 0] = _width(scene, row, column, psf.sigma_px, stars[0])
        if n_fits <= _MOST_MOMENTS:
            moments = adaptive_moments(scene.residual, column + 0.5, row + 0.5, psf.sigma_px)
            if _is_long(moments):
                lines[n_lines], n_lines = moments, n_lines + 1
            if not _is_cut(moments, scene.residual.shape, psf.sigma_px):
                shapes[n, 1:] = moments[2:]
        if not (math.isnan(shapes[n, 0]) and math.isnan(shapes[n, 1])):
            n += 1
    return n


@compiled
def _is_long(moments: Floats) -> bool:
    """Return whether moments x, y, xx, xy, yy are those of a line; NaN is none."""
    half = 0.5 * (moments[2] + moments[4])
    spread = math.hypot(0.5 * (moments[2] - moments[4]), moments[3])
    return bool(half + spread > _LONG**2 * max(half - spread, PIXEL_VARIANCE))


@compiled
def _is_on_line(lines: Floats, n: int, x: float, y: float) -> bool:
    """Return whether a place is on one of `n` lines, moments (m, 5)."""
    for k in range(n):
        dx, dy = x - lines[k, 0], y - lines[k, 1]
        # A line may be thinner than a pixel, and a peak beside it.
        xx, xy, yy = lines[k, 2] + 1.0, lines[k, 3], lines[k, 4] + 1.0
        if (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) < _ON_LINE * (xx * yy - xy * xy):
            return True
    return False


@compiled
def _is_cut(moments: Floats, shape: tuple[int, int], sigma_px: float) -> bool:
    """Return whether what has these moments reaches to the border of the image (h, w)."""
    x, y, xx, _, yy = moments
    room = _BORDER_PX + _BORDER_SIGMAS * sigma_px
    reach_x, reach_y = 0.5 * _LINE * math.sqrt(xx) + room, 0.5 * _LINE * math.sqrt(yy) + room
    return not (reach_x < x < shape[1] - reach_x and reach_y < y < shape[0] - reach_y)


@compiled
def _width(scene: Scene, row: int, column: int, sigma: float, star: Star) -> float:
    """Return the width of a round star fitted to a peak, NaN where none fits."""
    width, flux = np.nan, np.empty(3)
    for _ in range(_WINDOWS):
        star.x, star.y, star.sigma = column + 0.5, row + 0.5, sigma
        # Room for a star that is wider, and for the background that tells it from one.
        star.background, star.reach = 0.0, 2.0 + _ROOM * sigma
        star.peak = scene.residual[row, column]
        flux[:] = star.peak * 2 * math.pi * (sigma * sigma + PIXEL_VARIANCE)
        free = Fitting(_ANY_WIDTH, _ROUGHLY_PX, _WIDEST * sigma)
        if not fit_star(scene, star, flux, Psf(sigma, 0.0, 0.0), free) or star.snr < _LEAST_SNR:
            break
        width, before, sigma = star.sigma, sigma, star.sigma
        if sigma < _WIDER * before:
            break
    return width
