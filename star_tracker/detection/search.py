"""Where stars may be: the matched filter, its own noise, its peaks.

The residual is correlated with the image of a star (Turin 1960), which makes of each pixel the
flux of a star that would have its middle there. What counts as a peak is measured in the local
noise of this filtered image, not of the pixels: compression to blocks, interpolated colours and
badly removed structure make neighbouring pixels depend on each other, and then the noise of
filtered white noise is not what is there.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from star_tracker.compiled import compiled
from star_tracker.detection.image import Plane
from star_tracker.detection.psf import REACH_SIGMAS, Psf, gaussian_profile
from star_tracker.detection.tiles import ROUNDING, Tiles, quantile, sample_tile
from star_tracker.geometry.spherical import Floats

#: The noise is first taken from where a Gaussian has four fifths of its absolute values: the core
#: alone says nothing where most pixels are rounded to the same number. Then from the mean square
#: below so many standard deviations, where a Gaussian has the last part of its own.
_SHARE, _SHARE_SIGMAS = 0.8, 1.2816
_CLIP, _CLIPPED_PART, _CLIP_TURNS = 2.5, 0.9546, 2
#: A peak may lie between pixels, and its star is held against the threshold only when fitted.
_PEAK_PART = 0.9
#: Nothing is told apart that is closer than this to the largest number, in single precision.
_PRECISION = 1e-6
#: A line is drawn with steps of so many widths of the Gaussian: smooth to 1 %.
_STEP_SIGMAS = 1.0


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


def matched_filter(residual: Plane, tiles: Tiles, psf: Psf, step: float) -> Filtered:
    """Filter a residual (h, w) for stars that look like `psf`."""
    reach = math.ceil(REACH_SIGMAS * psf.sigma_px + 0.5)
    profile = gaussian_profile(psf.sigma_px, reach)
    flux = np.empty_like(residual)
    _correlate(residual, profile[reach:].astype(np.float32), flux)
    star = np.outer(profile, profile).astype(np.float32)
    if psf.streak_px > 0.0:
        shifts = _line(psf)
        flux = _draw(flux, shifts)
        margin = np.abs(shifts).max(axis=0)
        star = _draw(np.pad(star, [(margin[0],) * 2, (margin[1],) * 2]), shifts)
    norm = float(np.sum(np.square(star, dtype=float)))
    flux *= np.float32(1 / norm)
    floor = max(ROUNDING * step, _PRECISION * float(np.abs(tiles.level).max()))
    noise = _noise(flux, tiles)
    # A tile that is full of stars or an edge takes its neighbours' word.
    noise = np.maximum(median_filter(noise, 3, mode="nearest"), floor / math.sqrt(norm))
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
def _correlate(plane: Plane, half: Plane, out: Plane) -> None:
    """Correlate with a symmetrical profile along both axes, given its middle and right half.

    Beyond the border the plane is 0. Rows are filtered as they are needed and kept in a ring.
    """
    height, width = plane.shape
    reach = len(half) - 1
    ring = np.zeros((2 * reach + 1, width), np.float32)
    padded = np.zeros(width + 2 * reach, np.float32)
    for row in range(height + reach):
        line = ring[row % (2 * reach + 1)]
        line[:] = 0.0
        if row < height:
            padded[reach : reach + width] = plane[row]
            _add(line, padded[reach : reach + width], padded[reach : reach + width], 0.5 * half[0])
            for k in range(1, reach + 1):
                left, right = padded[reach - k :], padded[reach + k :]
                _add(line, left[:width], right[:width], half[k])
        middle = row - reach
        if middle < 0:
            continue
        total = out[middle]
        total[:] = 0.0
        for k in range(reach + 1):
            above = ring[(middle - k) % (2 * reach + 1)]
            below = ring[(middle + k) % (2 * reach + 1)]
            _add(total, above, below, half[k] if k > 0 else 0.5 * half[0])


@compiled
def _add(total: Plane, a: Plane, b: Plane, factor: float) -> None:
    """Add a multiple of two rows."""
    factor = np.float32(factor)
    for x in range(len(total)):
        total[x] += factor * (a[x] + b[x])


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
    most, total, count = np.float32(_CLIP * sigma), 0.0, 0
    for k in range(n):
        if values[k] <= most:
            total += values[k] * values[k]
            count += 1
    return math.sqrt(total / count) / _CLIPPED_PART if count > 0 else sigma


def find_peaks(
    filtered: Filtered, tiles: Tiles, threshold: float, most: int
) -> NDArray[np.int64]:
    """Return rows and columns (n, 2) of peaks above a threshold in noises, the brightest first.

    A peak is higher than the eight pixels around it. No more than `most` are returned.
    """
    brightness, place = np.empty(2 * most, np.float32), np.empty((2 * most, 2), np.int64)
    n = _find_peaks(
        filtered.flux, _PEAK_PART * threshold * filtered.noise, tiles, brightness, place
    )
    order = np.argsort(-brightness[:n], kind="stable")[:most]
    return np.asarray(place[order])


@compiled
def _find_peaks(
    flux: Plane, least: Floats, tiles: Tiles, brightness: Plane, place: NDArray[np.int64]
) -> int:
    """Write brightness and place of the peaks; return how many there are.

    Where there is no room for more, the fainter half makes way.
    """
    n = tile_row = 0
    for row in range(len(flux)):
        while row >= tiles.y[tile_row + 1]:
            tile_row += 1
        for k in range(len(tiles.x) - 1):
            threshold = np.float32(least[tile_row, k])
            line, above = flux[row, tiles.x[k] : tiles.x[k + 1]], 0
            for x in range(len(line)):
                above += line[x] > threshold
            if above == 0:
                continue
            for column in range(tiles.x[k], tiles.x[k + 1]):
                if flux[row, column] > threshold and _is_peak(flux, row, column):
                    brightness[n] = flux[row, column]
                    place[n, 0], place[n, 1] = row, column
                    n += 1
                    if n == len(brightness):
                        n = _keep_bright_half(brightness, place)
    return n


@compiled
def _is_peak(flux: Plane, row: int, column: int) -> bool:
    """Return whether a pixel is higher than its neighbours; of equal ones the last one is."""
    value = flux[row, column]
    for y in range(max(row - 1, 0), min(row + 2, flux.shape[0])):
        for x in range(max(column - 1, 0), min(column + 2, flux.shape[1])):
            if flux[y, x] > value:
                return False
            if flux[y, x] == value and (y > row or (y == row and x > column)):
                return False
    return True


@compiled
def _keep_bright_half(brightness: Plane, place: NDArray[np.int64]) -> int:
    """Move the brighter half to the front; return its size, less where many are equal."""
    n = len(brightness)
    middle = np.float32(
        quantile(brightness, n, 0.5, np.min(brightness), np.max(brightness))
    )
    kept = 0
    for i in range(n):
        if brightness[i] > middle and kept < n // 2:
            brightness[kept] = brightness[i]
            place[kept, 0], place[kept, 1] = place[i, 0], place[i, 1]
            kept += 1
    return kept
