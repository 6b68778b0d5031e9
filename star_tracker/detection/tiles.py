"""The image cut in tiles, and each one's level and noise.

A tile's level is the mean of what lies within three noises of its median, so that stars do not
count. Medians are found by counting, several times as fast as sorting.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.image import Plane

#: A tile is so many pixels wide: a star covers little of it, a glow does not change much over it.
TILE_PX = 32
#: Widths of a star that a tile must have at least: less than a tenth of it is then star.
TILE_PSFS = 12.0
#: Median absolute deviation of a Gaussian of standard deviation 1, inverted.
MAD_TO_SIGMA = 1.4826
#: Standard deviation of the rounding to whole numbers.
ROUNDING = 0.2887
_CLIP = 3.0


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
def quantile(values: Plane, n: int, share: float, low: float, high: float) -> float:
    """Return the value below which a share of values[:n] lies, by halving [low, high].

    Exact to 1/65536 of that interval. Counting is several times as fast as sorting.
    """
    wanted = share * n
    low, high = np.float32(low), np.float32(high)
    for _ in range(16):
        middle = np.float32(0.5) * (low + high)
        below = 0
        for i in range(n):
            below += values[i] < middle
        if below > wanted:
            high = middle
        else:
            low = middle
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
    for i in range(len(tiles.y) - 1):
        for j in range(len(tiles.x) - 1):
            n = sample_tile(pixels, tiles.y[i : i + 2], tiles.x[j : j + 2], sample)
            if n == 0:
                tiles.level[i, j], tiles.noise[i, j] = 0.0, np.inf
                continue
            low, high = np.min(sample[:n]), np.max(sample[:n])
            middle = quantile(sample, n, 0.5, low, high)
            for k in range(n):
                sample[k] = abs(sample[k] - np.float32(middle))
            noise = MAD_TO_SIGMA * quantile(
                sample, n, 0.5, 0.0, max(high - middle, middle - low)
            )
            tiles.level[i, j], tiles.noise[i, j] = _clipped(
                pixels, tiles.y[i : i + 2], tiles.x[j : j + 2], middle, max(_CLIP * noise, step)
            )
            tiles.noise[i, j] = max(tiles.noise[i, j], ROUNDING * step)


@compiled
def _clipped(
    pixels: Plane, y: NDArray[np.int64], x: NDArray[np.int64], middle: float, width: float
) -> tuple[float, float]:
    """Return mean and standard deviation of the pixels of a tile within a width of its middle."""
    n_columns = x[1] - x[0]
    # One sum for each column: the columns do not wait for each other then.
    count, first, second = np.zeros((3, n_columns), np.float32)
    centre, most = np.float32(middle), np.float32(width)
    for row in range(y[0], y[1]):
        line = pixels[row, x[0] : x[1]]
        for k in range(n_columns):
            off = line[k] - centre
            inside = np.float32(1.0) if abs(off) <= most else np.float32(0.0)
            off = off if abs(off) <= most else np.float32(0.0)
            count[k] += inside
            first[k] += off
            second[k] += off * off
    n = max(np.sum(count), np.float32(1.0))
    mean = np.sum(first) / n
    return middle + mean, np.sqrt(max(np.sum(second) / n - mean * mean, np.float32(0.0)))


