"""The matched filter and its own noise: where the image looks like a star.

The residual is correlated with the image of a star (Turin 1960), which makes of each pixel the
flux of a star that would have its middle there. What counts is measured in the local noise of
this filtered image, not of the pixels: compression to blocks, interpolated colours and badly
removed structure make neighbouring pixels depend on each other, and then the noise of filtered
white noise is not what is there.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.planes import Plane
from star_tracker.detection.psf import REACH_SIGMAS, Psf, gaussian_profile
from star_tracker.detection.tiles import ROUNDING, Tiles, clear, copy, quantile, sample_tile
from star_tracker.geometry.spherical import Floats

#: The noise is first taken from where a Gaussian has four fifths of its absolute values: the core
#: alone says nothing where most pixels are rounded to the same number. Then from the mean square
#: below so many standard deviations, where a Gaussian has the last part of its own.
_SHARE, _SHARE_SIGMAS = 0.8, 1.2816
_CLIP, _CLIPPED_PART, _CLIP_TURNS = 2.5, 0.9546, 2
#: Nothing is told apart that is closer than this to the largest number, in single precision.
_PRECISION = 1e-6
#: A line is drawn with steps of so many widths of the Gaussian: smooth to 1 %.
_STEP_SIGMAS = 1.0
#: So many taps of the filter are taken at a time: their sum stays in registers.
_TAPS = 8


class Filtered(NamedTuple):
    """The filtered image.

    Attributes:
        flux: (h, w) flux of a star with its middle in the middle of that pixel.
        noise: (ny, nx) standard deviation of `flux` where there are no stars, for each tile.
        norm: sum of the squares of a star of flux 1: noise^2 norm is the variance of a pixel.
    """

    flux: Plane
    noise: Floats
    norm: float


def matched_filter(
    residual: Plane, tiles: Tiles, psf: Psf, step: float, flux: Plane
) -> Filtered:
    """Filter a residual (h, w) for stars that look like `psf`; `flux` (h, w) is room for it."""
    reach = math.ceil(REACH_SIGMAS * psf.sigma_px + 0.5)
    profile = gaussian_profile(psf.sigma_px, reach)
    round_norm = float(np.sum(profile**2)) ** 2
    taps = np.pad(profile, (0, -len(profile) % _TAPS)).astype(np.float32)
    _correlate(residual, taps, np.float32(1 / round_norm), flux)
    norm = round_norm
    if psf.streak_px > 0.0:
        shifts = _line(psf)
        margin = np.abs(shifts).max(axis=0)
        star = np.outer(profile, profile).astype(np.float32)
        star = _draw(np.pad(star, [(margin[0],) * 2, (margin[1],) * 2]), shifts)
        norm = float(np.sum(np.square(star, dtype=float)))
        flux = _draw(flux, shifts)
        flux *= np.float32(round_norm / norm)
    floor = max(ROUNDING * step, _PRECISION * float(np.abs(tiles.level).max()))
    noise = _noise(flux, tiles)
    # A tile that is full of stars or an edge takes its neighbours' word.
    noise = np.maximum(_median_of_nine(noise), floor / math.sqrt(norm))
    noise[~np.isfinite(tiles.noise)] = np.inf
    return Filtered(flux, noise, norm)


def _line(psf: Psf) -> NDArray[np.int64]:
    """Return whole-pixel shifts (n, 2), y and x, along the line of a PSF about its middle."""
    n = 2 * math.ceil(psf.streak_px / (2 * _STEP_SIGMAS * psf.sigma_px)) + 1
    along = (np.arange(n) - n // 2) / n
    return np.rint(along[:, None] * (psf.dy_px, psf.dx_px)).astype(np.int64)


def _draw(plane: Plane, shifts: NDArray[np.int64]) -> Plane:
    """Return the mean of a plane's copies shifted by (y, x); beyond the border is 0."""
    height, width = plane.shape
    total = np.zeros_like(plane)
    for y, x in shifts:
        rows, columns = height - abs(y), width - abs(x)
        if rows > 0 and columns > 0:
            top, left = max(y, 0), max(x, 0)
            total[top : top + rows, left : left + columns] += plane[
                max(-y, 0) : max(-y, 0) + rows, max(-x, 0) : max(-x, 0) + columns
            ]
    total /= np.float32(len(shifts))
    return total


@compiled
def _correlate(plane: Plane, taps: Plane, scale: float, out: Plane) -> None:
    """Correlate with a symmetrical profile along both axes, times a factor.

    The profile has an odd number of taps, and zeros behind that make it a multiple of `_TAPS`.
    Beyond the border the plane is 0. Rows are filtered as they are needed and kept in a ring,
    each under the tap that it has below: the taps go round, the rows stay.
    """
    height, width = plane.shape
    n = len(taps)
    reach = _reach(taps)
    ring = np.zeros((n, width), np.float32)
    padded = np.zeros(width + n, np.float32)
    turned = np.empty(n, np.float32)
    for row in range(height + reach):
        line = ring[row % n]
        clear(line)
        if row < height:
            copy(plane[row], padded[reach:])
            for k in range(0, n, _TAPS):
                _along(padded[k:], taps[k : k + _TAPS], line)
        if row < reach:
            continue
        for k in range(n):
            turned[(row - 2 * reach + k) % n] = np.float32(scale) * taps[k]
        total = out[row - reach]
        clear(total)
        for k in range(0, n, _TAPS):
            _down(ring[k : k + _TAPS], turned[k : k + _TAPS], total)


@compiled
def _reach(taps: Plane) -> int:
    """Return how far a profile with zeros behind reaches from its middle."""
    n = len(taps)
    while taps[n - 1] == 0.0:
        n -= 1
    return n // 2


@compiled
def _along(line: Plane, taps: Plane, total: Plane) -> None:
    """Add to a row what eight taps see of a line, each a pixel further on."""
    # Lines of their own, as an index that is a sum keeps the loop from being vectorised.
    p, q, r, s = line[1:], line[2:], line[3:], line[4:]
    t, u, v = line[5:], line[6:], line[7:]
    a, b, c, d, e, f, g, h = _eight(taps)
    for x in range(len(total)):
        total[x] += (
            a * line[x] + b * p[x] + c * q[x] + d * r[x]
            + (e * s[x] + f * t[x] + g * u[x] + h * v[x])
        )


@compiled
def _down(lines: Plane, taps: Plane, total: Plane) -> None:
    """Add to a row what eight taps see of eight lines."""
    o, p, q, r, s, t, u, v = _eight(lines)
    a, b, c, d, e, f, g, h = _eight(taps)
    for x in range(len(total)):
        total[x] += (
            a * o[x] + b * p[x] + c * q[x] + d * r[x]
            + (e * s[x] + f * t[x] + g * u[x] + h * v[x])
        )


@compiled
def _eight(of: Plane) -> tuple[Any, ...]:
    return of[0], of[1], of[2], of[3], of[4], of[5], of[6], of[7]


@compiled
def _noise(flux: Plane, tiles: Tiles) -> Floats:
    """Return the standard deviation (ny, nx) of the filtered image about 0 in each tile."""
    ny, nx = tiles.level.shape
    noise = np.empty((ny, nx))
    sample = np.empty((tiles.y[1] + 1) * (tiles.x[1] + 1), np.float32)
    for i in range(ny):
        for j in range(nx):
            n = sample_tile(flux, tiles.y[i : i + 2], tiles.x[j : j + 2], sample)
            largest = np.float32(0.0)
            for k in range(n):
                sample[k] = abs(sample[k])
                largest = max(largest, sample[k])
            sigma = quantile(sample, n, _SHARE, 0.0, largest) / _SHARE_SIGMAS
            for _ in range(_CLIP_TURNS):
                sigma = _clipped_sigma(sample, n, sigma)
            noise[i, j] = sigma
    return noise


@compiled
def _clipped_sigma(values: Plane, n: int, sigma: float) -> float:
    """Return the standard deviation about 0 of absolute values that are not far beyond one."""
    most, total, count = np.float32(_CLIP * sigma), np.float32(0.0), np.float32(0.0)
    for k in range(n):
        inside = np.float32(1.0) if values[k] <= most else np.float32(0.0)
        total += inside * values[k] * values[k]
        count += inside
    return math.sqrt(total / count) / _CLIPPED_PART if count > 0 else sigma


@compiled
def _median_of_nine(values: Floats) -> Floats:
    """Return the median of each value (ny, nx) and its eight neighbours, at the border its own."""
    ny, nx = values.shape
    medians, near = np.empty_like(values), np.empty(9)
    for i in range(ny):
        for j in range(nx):
            n = 0
            for y in range(i - 1, i + 2):
                for x in range(j - 1, j + 2):
                    value = values[min(max(y, 0), ny - 1), min(max(x, 0), nx - 1)]
                    at = n
                    while at > 0 and near[at - 1] > value:
                        near[at] = near[at - 1]
                        at -= 1
                    near[at] = value
                    n += 1
            medians[i, j] = near[4]
    return medians
