"""The second fit: each star alone, its pixels weighted by what their noise turned out to be."""

import math

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.detection.centroids import Flag
from star_tracker.detection.fit import fit_star, fitting
from star_tracker.detection.measure import SUSPECT
from star_tracker.detection.psf import REACH_SIGMAS, Psf, star_shape
from star_tracker.detection.stars import Scene, Star, Stars, add_star, window_of
from star_tracker.geometry.spherical import Floats

_SATURATED, _BLEND = int(Flag.SATURATED), int(Flag.BLEND)
#: Stars with this signal to noise tell the noise of their own light.
_SHOT_SNR, _SHOT_STARS = 20.0, 50
#: Two stars so near to each other, in widths, share pixels; one with this part of the other's
#: flux is worth a flag.
_BLEND_SIGMAS, _BLEND_SHARE = 5.0, 0.05
#: Rounds in which neighbours are fitted in turn, and where a fit is at its end.
_ROUNDS, _FINELY_PX = 3, 0.002


@compiled
def shot_noise(scene: Scene, stars: Stars, n: int, fluxes: Floats, psf: Psf) -> float:
    """Return the variance that stars add to pixels for each unit of light, from what fits leave.

    The stars are those taken out of the scene. Light that the fit does not explain counts as
    noise, too.
    """
    ratio = np.empty(_SHOT_STARS)
    found = 0
    for k in range(n):
        if stars[k].flags & (SUSPECT | _SATURATED) or stars[k].snr < _SHOT_SNR:
            continue
        ratio[found] = _excess(scene, stars[k], fluxes[k], psf)
        found += 1
        if found == _SHOT_STARS:
            break
    return max(0.0, float(np.median(ratio[:found]))) if found > 0 else 0.0


@compiled
def _excess(scene: Scene, star: Star, flux: Floats, psf: Psf) -> float:
    """Return by how much squared residuals exceed the background's noise, per unit of light."""
    window = window_of(scene, star, psf, REACH_SIGMAS)
    own = Psf(star.sigma, psf.dx_px, psf.dy_px)
    star_shape(own, star.x, star.y, window.corner, window.shape)
    left, top = window.corner
    excess, total = 0.0, 1e-30
    _, ny, nx = window.shape.shape
    for i in range(ny):
        for j in range(nx):
            if np.isnan(scene.pixels[top + i, left + j]):
                continue
            colour = scene.channel[(top + i) & 1, (left + j) & 1]
            light = flux[colour] * window.shape[0, i, j]
            off = scene.residual[top + i, left + j] - star.background
            excess += (off * off - star.noise**2) * light
            total += light * light
    return float(excess / total)


@compiled
def _note_neighbours(stars: Stars, n: int) -> None:
    """Count the neighbours of each star and flag blends."""
    for k in range(n):
        star = stars[k]
        for other in range(n):
            if other == k or (star.flags | stars[other].flags) & SUSPECT:
                continue
            apart = math.hypot(star.x - stars[other].x, star.y - stars[other].y)
            if apart < 0.5 * _BLEND_SIGMAS * (star.sigma + stars[other].sigma) + 1.0:
                star.neighbours += 1
                if stars[other].flux > _BLEND_SHARE * star.flux:
                    star.flags |= _BLEND


@compiled
def refine(scene: Scene, stars: Stars, n: int, fluxes: Floats, psf: Psf) -> None:
    """Fit the stars again, each without the others, those with neighbours several times."""
    _note_neighbours(stars, n)
    for turn in range(_ROUNDS):
        for k in range(n):
            star = stars[k]
            if star.flags & SUSPECT or (turn > 0 and star.neighbours == 0):
                continue
            before, flux_before = (star.x, star.y, star.sigma, star.background), fluxes[k].copy()
            add_star(scene, star, fluxes[k], psf, 1.0)
            if not fit_star(scene, star, fluxes[k], psf, fitting(star, psf, _FINELY_PX)):
                star.x, star.y, star.sigma, star.background = before
                fluxes[k] = flux_before
            if star.neighbours > 0:  # else nobody looks at its pixels again
                add_star(scene, star, fluxes[k], psf, -1.0)
