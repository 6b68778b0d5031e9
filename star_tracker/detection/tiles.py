"""The image cut in tiles, and each one's level and noise.

A tile's level is the mean of what lies within three noises of its median, so that stars do not
count. Medians are found by counting, several times as fast as sorting.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.planes import Plane

#: A tile is so many pixels wide: a star covers little of it, a glow does not change much over it.
TILE_PX = 32
#: Widths of a star that a tile must have at least: less than a tenth of it is then star.
TILE_PSFS = 12.0
#: Median absolute deviation of a Gaussian of standard deviation 1, inverted.
MAD_TO_SIGMA = 1.4826
#: Standard deviation of the rounding to whole numbers.
ROUNDING = 0.2887
_CLIP = 3.0
#: A quantile is at its end after so many halvings, or where one in so many values is in question.
_HALVINGS, _ALIKE = 16, 64


class Tiles(NamedTuple):
    """The tiles' borders and what was measured in each.

    Attributes:
        y, x: (ny + 1,) and (nx + 1,) first row and column of each tile, and the end.
        level: (ny, nx) background.
        noise: (ny, nx) standard deviation of a pixel, infinity where no pixel is usable.
    """

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    level: Plane
    noise: Plane


def tile_size_px(psf_sigma_px: float) -> int:
    """Return how large tiles must be for stars of a width."""
    return max(TILE_PX, int(np.ceil(TILE_PSFS * psf_sigma_px)))


def cut(shape: tuple[int, ...], size_px: int) -> Tiles:
    """Return the tiles of an image (h, w), about this large, with nothing measured."""
    ny, nx = (max(1, round(n / size_px)) for n in shape)
    return Tiles(
        np.linspace(0, shape[0], ny + 1).astype(np.int64),
        np.linspace(0, shape[1], nx + 1).astype(np.int64),
        np.empty((ny, nx), np.float32), np.empty((ny, nx), np.float32),
    )


@compiled
def copy(line: Plane, to: Plane) -> None:
    """Copy a row to the beginning of another; several times as fast as an assigned slice."""
    for x in range(len(line)):
        to[x] = line[x]


@compiled
def clear(line: Plane) -> None:
    """Set a row to 0."""
    for x in range(len(line)):
        line[x] = np.float32(0.0)


@compiled
def quantile(values: Plane, n: int, share: float, low: float, high: float) -> float:
    """Return the value below which a share of values[:n] lies, by halving [low, high].

    Exact to 1/65536 of that interval, or to a sixty-fourth of the values. Counting is several
    times as fast as sorting.
    """
    wanted = share * n
    low, high = np.float32(low), np.float32(high)
    below_low, below_high = 0, n
    for _ in range(_HALVINGS):
        middle = np.float32(0.5) * (low + high)
        below = 0
        for i in range(n):
            below += values[i] < middle
        if below > wanted:
            high, below_high = middle, below
        else:
            low, below_low = middle, below
        if _ALIKE * (below_high - below_low) <= n:
            break
    return 0.5 * (low + high)


@compiled
def sample_tile(plane: Plane, y: NDArray[np.int64], x: NDArray[np.int64], sample: Plane) -> int:
    """Copy an eighth of the pixels from y[0], x[0] to y[1], x[1]; return their number.

    Every fourth row gives every second pixel. NaN is left out.
    """
    n = 0
    for row in range(y[0] + (y[1] - y[0] > 1), y[1], 4):
        for column in range(x[0], x[1], 2):
            value = plane[row, column]
            sample[n] = value
            n += value == value  # noqa: PLR0124  not NaN
    return n


@compiled
def measure_tiles(pixels: Plane, tiles: Tiles, step: float) -> None:
    """Fill in level and noise of each tile."""
    sample = np.empty((tiles.y[1] + 1) * (tiles.x[1] + 1), np.float32)
    centre, most = np.empty(pixels.shape[1], np.float32), np.empty(pixels.shape[1], np.float32)
    sums, off = np.empty((3, pixels.shape[1]), np.float32), np.empty(pixels.shape[1], np.float32)
    for i in range(len(tiles.y) - 1):
        y = tiles.y[i : i + 2]
        for j in range(len(tiles.x) - 1):
            x = tiles.x[j : j + 2]
            n = sample_tile(pixels, y, x, sample)
            middle, noise = _roughly(sample, n)
            tiles.level[i, j], tiles.noise[i, j] = middle, noise if n > 0 else np.inf
            widest = max(_CLIP * noise, step)
            for column in range(x[0], x[1]):
                centre[column], most[column] = middle, widest
        sums[:] = 0.0
        for row in range(y[0], y[1]):
            _offsets(pixels[row], centre, most, off)
            _add_offsets(off, sums[0], sums[1], sums[2])
        for j in range(len(tiles.x) - 1):
            if tiles.noise[i, j] < np.inf:
                mean, noise = _mean_and_noise(sums[:, tiles.x[j] : tiles.x[j + 1]])
                tiles.level[i, j] += mean
                tiles.noise[i, j] = max(noise, ROUNDING * step)


@compiled
def _roughly(sample: Plane, n: int) -> tuple[float, float]:
    """Return the median of sample[:n] and its noise by the median deviation, which it overwrites.

    Both are 0 where there is no sample.
    """
    if n == 0:
        return 0.0, 0.0
    low = high = sample[0]
    for k in range(n):
        low, high = min(low, sample[k]), max(high, sample[k])
    middle = np.float32(quantile(sample, n, 0.5, low, high))
    for k in range(n):
        sample[k] = abs(sample[k] - middle)
    deviation = quantile(sample, n, 0.5, 0.0, max(high - middle, middle - low))
    return float(middle), MAD_TO_SIGMA * deviation


@compiled
def _offsets(line: Plane, centre: Plane, most: Plane, off: Plane) -> None:
    """Write how far a row's pixels are off the centre, NaN for those beyond the most."""
    for x in range(len(line)):
        value = line[x] - centre[x]
        off[x] = value if abs(value) <= most[x] else np.float32(np.nan)


@compiled
def _add_offsets(off: Plane, count: Plane, first: Plane, second: Plane) -> None:
    """Add to each column's number, sum and sum of squares those offsets that are not NaN.

    It is apart from `_offsets` as loops over more than five arrays are not vectorised.
    """
    for x in range(len(off)):
        inside = off[x] == off[x]
        value = off[x] if inside else np.float32(0.0)
        count[x] += np.float32(1.0) if inside else np.float32(0.0)
        first[x] += value
        second[x] += value * value


@compiled
def _mean_and_noise(sums: Plane) -> tuple[float, float]:
    """Return mean and standard deviation from the sums (3, w) of a tile's columns."""
    count, first, second = 0.0, 0.0, 0.0
    for x in range(sums.shape[1]):
        count += sums[0, x]
        first += sums[1, x]
        second += sums[2, x]
    mean = first / max(count, 1.0)
    return mean, math.sqrt(max(second / max(count, 1.0) - mean * mean, 0.0))
