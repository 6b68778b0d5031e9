"""Where stars may be: the peaks of the filtered image that stand out of its noise."""

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.filter import Filtered
from star_tracker.detection.planes import Plane
from star_tracker.detection.tiles import Tiles, quantile
from star_tracker.geometry.spherical import Floats

#: A peak may lie between pixels, and its star is held against the threshold only when fitted.
_PEAK_PART = 0.9


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
