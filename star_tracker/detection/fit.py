"""A star's place by least squares: the image of a star is fitted to the pixels around it.

Unknown are the place, the width (held near the image's own by a prior), the background and the
flux (one for each colour of a Bayer pattern). Pixels count by their variance, sigma^2 + shot x
star: the background's noise and the star's own. Saturated and unusable pixels do not count at
all. For a star that looks as supposed, the place has no bias and reaches the Cramer-Rao bound,
whatever the sampling (King 1983, PASP 95, 163, for the bound).
"""

import math
from typing import NamedTuple

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.detection.centroids import Flag
from star_tracker.detection.equations import (
    BACKGROUND,
    FLUX,
    MOST_UNKNOWNS,
    PLACE,
    WIDTH,
    equations,
    solve,
)
from star_tracker.detection.psf import Psf, star_shape
from star_tracker.detection.stars import Scene, Star, Window, noise_at, window_of
from star_tracker.geometry.spherical import Floats

_SATURATED = int(Flag.SATURATED)
#: Standard deviation of the logarithm of a star's width: lenses are not equally sharp all over.
_WIDTH_SPREAD, _WINGS_SPREAD = 0.25, 1.0
_MAX_ITERATIONS = 15
#: A fit looks so many widths far: less than 1 % of what the pixels know of the place is beyond.
_REACH_SIGMAS = 2.6
#: Standard deviation of the background's error, in noises and, for the halo that lenses draw about
#: bright stars, as a part of the star's peak.
_FLAT_NOISES, _HALO = 0.3, 0.02
#: Longest steps: in the place, in widths of the star; in the logarithm of the width.
_STEP_SIGMAS, _STEP_WIDTH = 0.7, 0.4
#: Widths that a fit may take, px; and what may still become a star, in widths of one.
_WIDTHS_PX, _WIDEST = (0.1, 30.0), 3.5
#: Of the error that a star's noise gives its place anyway, so much does not matter.
_SETTLED_PART = 0.05
_LEFT_OVER = 0.25
#: Fewer pixels than this determine nothing.
_FEWEST_PIXELS = 8


class Fitting(NamedTuple):
    """How a star is fitted.

    Attributes:
        hold: standard deviation of the prior on the logarithm of the width about the PSF's.
        settled_px: the fit is at its end where no more than this is left to go, as it looks.
        widest_px: what gets wider than this is no star, and its fit is given up.
    """

    hold: float
    settled_px: float
    widest_px: float


@compiled
def fitting(star: Star, psf: Psf, settled_px: float) -> Fitting:
    """Return how a star is fitted: the wings of a saturated one are wider than its core."""
    if star.flags & _SATURATED != 0:
        return Fitting(_WINGS_SPREAD, settled_px, _WIDTHS_PX[1])
    return Fitting(_WIDTH_SPREAD, settled_px, _WIDEST * psf.sigma_px)


@compiled
def fit_star(scene: Scene, star: Star, flux: Floats, psf: Psf, how: Fitting) -> bool:
    """Fit a star, starting from what it holds, and write what comes of it.

    `flux` (3,) is that of each colour. Returns whether the fit settled.
    """
    hold = how.hold
    window = window_of(scene, star, psf, _REACH_SIGMAS)
    start_x, start_y = star.x, star.y
    farthest = 2.0 * star.sigma + 1.0 + star.reach
    star.noise = noise_at(scene, star.x, star.y)
    n_fluxes = 1 + np.max(scene.channel)
    flat = _FLAT_NOISES * star.noise + _HALO * max(star.peak, 0.0)
    normal, right = np.empty((MOST_UNKNOWNS, MOST_UNKNOWNS)), np.empty(MOST_UNKNOWNS)
    before, settled = 0.0, how.settled_px
    if star.snr > 0.0:
        settled = max(settled, _SETTLED_PART * star.sigma / star.snr)
    for _ in range(_MAX_ITERATIONS):
        shape = Psf(star.sigma, psf.dx_px, psf.dy_px)
        star_shape(shape, star.x, star.y, window.corner, window.shape)
        if equations(scene, star, flux, window, (normal, right)) < _FEWEST_PIXELS:
            return False
        normal[WIDTH, WIDTH] += 1 / hold**2
        right[WIDTH] += math.log(psf.sigma_px / star.sigma) / hold**2
        normal[BACKGROUND, BACKGROUND] += 1 / flat**2
        right[BACKGROUND] -= star.background / flat**2
        if not solve(normal, right, FLUX + n_fluxes):
            return False
        moved = _step(star, flux, right, n_fluxes)
        if not (math.hypot(star.x - start_x, star.y - start_y) < farthest
                and _WIDTHS_PX[0] < star.sigma < how.widest_px):
            return False
        # Of the error a step leaves a part, the same each time and hardly ever more than this.
        if _LEFT_OVER * moved < settled or moved * moved < 0.5 * settled * before:
            _sum_up(scene, star, flux, window)
            return True
        before = moved
    return False


@compiled
def _step(star: Star, flux: Floats, step: Floats, n_fluxes: int) -> float:
    """Take a step, not too long a one; return its length in place and width, px."""
    longest = max(
        abs(step[0]) / (_STEP_SIGMAS * star.sigma), abs(step[1]) / (_STEP_SIGMAS * star.sigma),
        abs(step[WIDTH]) / _STEP_WIDTH, 1.0,
    )
    star.x += step[PLACE] / longest
    star.y += step[PLACE + 1] / longest
    star.background += step[BACKGROUND] / longest
    for colour in range(n_fluxes):
        # The flux stays positive: a star that is none would otherwise turn over and over.
        flux[colour] = max(flux[colour] + step[FLUX + colour] / longest, 1e-3 * flux[colour])
    before = star.sigma
    star.sigma *= math.exp(step[WIDTH] / longest)
    return float(max(abs(step[0]), abs(step[1]), 0.1 * abs(star.sigma - before)))


@compiled
def _sum_up(scene: Scene, star: Star, flux: Floats, window: Window) -> None:
    """Write flux, signal to noise and what of the star is left unexplained."""
    left, top = window.corner
    power = left_over = 0.0
    n_pixels = 0
    _, ny, nx = window.shape.shape
    colours = np.zeros(3)
    for i in range(ny):
        for j in range(nx):
            colour = scene.channel[(top + i) & 1, (left + j) & 1]
            colours[colour] += window.shape[0, i, j] ** 2
            if not scene.pixels[top + i, left + j] < scene.saturation_level:
                continue
            value = flux[colour] * window.shape[0, i, j]
            off = scene.residual[top + i, left + j] - star.background - value
            variance = star.noise**2 + scene.shot * max(value, 0.0)
            n_pixels += 1
            power += value * value / variance
            left_over += off * off / variance
    share, variance = np.zeros(3), 0.0
    for k in range(4):
        share[scene.channel[k // 2, k % 2]] += 0.25
    star.flux = 0.0
    for colour in range(3):
        if share[colour] > 0.0 and colours[colour] > 0.0:
            star.flux += share[colour] * flux[colour]
            variance += (share[colour] * star.noise) ** 2 / colours[colour]
    star.snr = star.flux / math.sqrt(variance) if variance > 0.0 else 0.0
    # Of noise alone the sum is n +- sqrt(2 n).
    expected = n_pixels + 3.0 * math.sqrt(2.0 * n_pixels)
    star.unexplained = max(0.0, left_over - expected) / max(power, 1e-30)
