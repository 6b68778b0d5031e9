"""What is not stars: a smooth background, the offsets of rows and columns, the noise.

Between the middles of the tiles (`tiles.py`) the level is bilinear. What is left of a row over
the whole width is its offset (read-out banding), then the same for columns, both estimated with
Huber's bounded influence (Huber 1964, Ann. Math. Stat. 35, 73), so that neither stars nor an
object that covers part of the row count. Order matters: a horizon or a tree changes the median of
a row, but not that of a row's difference from its surroundings.
"""

from typing import NamedTuple

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.detection.image import Frame
from star_tracker.detection.planes import Plane
from star_tracker.detection.tiles import Tiles, clear, cut, measure_tiles

#: Bound of the influence of a pixel on the offset of its row or column, in noises, and the share
#: of Gaussian noise within: the slope of the mean influence at 0.
_HUBER, _HUBER_SLOPE = 2.0, 0.9545
#: The first estimates of a row's offset take one stretch of pixels in so many, the last all.
_LANES, _STRETCHES = 64, (4, 4, 1)
#: The columns' offsets are first estimated from every so many rows, at last from all.
_ROW_STRIDES = (4, 4, 1)
#: A row or column with fewer pixels is left alone: a star would have a say in its offset.
_SHORTEST_LINE = 100


def subtract_background(frame: Frame, size_px: int, residual: Plane) -> Tiles:
    """Write what a frame's stars add to the background (h, w), 0 where unusable; return the tiles.

    The colours of a Bayer pattern have backgrounds of their own; the tiles returned are those of
    all together.
    """
    if not frame.channel.any():
        return _subtract_plane(frame.pixels, frame.step, size_px, residual)
    for y in range(2):
        for x in range(2):
            colour = np.ascontiguousarray(frame.pixels[y::2, x::2])
            left = np.empty_like(colour)
            _subtract_plane(colour, frame.step, size_px // 2, left)
            residual[y::2, x::2] = left
    tiles = cut(frame.pixels.shape, size_px)
    measure_tiles(frame.pixels, tiles, frame.step)
    return tiles


def _subtract_plane(pixels: Plane, step: float, size_px: int, residual: Plane) -> Tiles:
    tiles = cut(pixels.shape, size_px)
    measure_tiles(pixels, tiles, step)
    usable = np.isfinite(tiles.noise)
    if not usable.any():
        residual[:] = 0.0
        return tiles
    tiles.level[~usable] = np.median(tiles.level[usable])
    height, width = pixels.shape
    _subtract_tiles(pixels, tiles, residual, width >= _SHORTEST_LINE)
    if np.isnan(np.min(pixels)):
        residual[np.isnan(pixels)] = 0.0
    if height >= _SHORTEST_LINE:
        _subtract_columns(residual, tiles)
    return tiles


class Weights(NamedTuple):
    """How the pixels of a row of tiles count: (w,) bound of the influence, and 1 / variance."""

    bound: Plane
    unit: Plane


@compiled
def _weigh(tiles: Tiles, tile_row: int, weights: Weights) -> float:
    """Write how the pixels of a row of tiles count; return the sum of their weights.

    Those of a tile without noise do not count.
    """
    total = 0.0
    for k in range(len(tiles.x) - 1):
        begin, end = tiles.x[k], tiles.x[k + 1]
        noise = float(tiles.noise[tile_row, k])
        known = 0.0 < noise < np.inf
        weights.bound[begin:end] = np.float32(_HUBER * noise if known else 0.0)
        weights.unit[begin:end] = np.float32(1.0 / (noise * noise) if known else 0.0)
        total += (end - begin) / (noise * noise) if known else 0.0
    return total


@compiled
def _subtract_tiles(pixels: Plane, tiles: Tiles, residual: Plane, rows_too: bool) -> None:
    """Subtract the bilinear background and, if asked for, the offset of each row.

    What is left of unusable pixels is 0.
    """
    height, width = pixels.shape
    ny = len(tiles.level)
    centres_y = 0.5 * (tiles.y[1:] + tiles.y[:-1])
    weights = Weights(np.empty(width, np.float32), np.empty(width, np.float32))
    lanes = np.empty(_LANES, np.float32)
    above, below = np.empty(width, np.float32), np.empty(width, np.float32)
    between, tile_row, total = -1, -1, 0.0
    for row in range(height):
        while between < 0 or (between < ny - 2 and row + 0.5 > centres_y[between + 1]):
            between += 1
            _interpolate(tiles, between, above)
            _interpolate(tiles, min(between + 1, ny - 1), below)
        part = 0.0
        if ny > 1:
            part = (row + 0.5 - centres_y[between]) / (
                centres_y[between + 1] - centres_y[between]
            )
        _subtract_line(pixels[row], above, below, part, residual[row])
        if rows_too:
            if row >= tiles.y[tile_row + 1]:
                tile_row += 1
                total = _weigh(tiles, tile_row, weights)
            _shift(residual[row], np.float32(_row_offset(residual[row], weights, total, lanes)))


@compiled
def _interpolate(tiles: Tiles, tile_row: int, level: Plane) -> None:
    """Write the level (w,) in the middle of a row of tiles, linear between the tiles' middles."""
    nx = len(tiles.x) - 1
    at = 0
    for column in range(len(level)):
        while at < nx - 2 and 2 * column + 1 > tiles.x[at + 1] + tiles.x[at + 2]:
            at += 1
        value = float(tiles.level[tile_row, at])
        if nx > 1:
            first = 0.5 * (tiles.x[at] + tiles.x[at + 1])
            second = 0.5 * (tiles.x[at + 1] + tiles.x[at + 2])
            rise = float(tiles.level[tile_row, at + 1]) - value
            value += rise * (column + 0.5 - first) / (second - first)
        level[column] = value


@compiled
def _subtract_line(
    line: Plane, above: Plane, below: Plane, part: float, residual: Plane
) -> None:
    """Subtract from a row what lies a part of the way from one level to another."""
    share = np.float32(part)
    for x in range(len(line)):
        value = line[x] - (above[x] + share * (below[x] - above[x]))
        residual[x] = np.float32(0.0) if np.isnan(value) else value


@compiled
def _shift(line: Plane, offset: float) -> None:
    for x in range(len(line)):
        line[x] -= offset


@compiled
def _row_offset(line: Plane, weights: Weights, weight: float, lanes: Plane) -> float:
    """Return the offset of a row of the residual, given the sum of its pixels' weights.

    The sums run in lanes side by side, which do not wait for each other.
    """
    n = len(lanes)
    if weight == 0.0:
        return 0.0
    offset = 0.0
    for skip in _STRETCHES:
        clear(lanes)
        taken, at = 0, np.float32(offset)
        for begin in range(0, len(line), skip * n):
            part = line[begin : begin + n]
            bound, unit = weights.bound[begin : begin + n], weights.unit[begin : begin + n]
            for x in range(len(part)):
                lanes[x] += unit[x] * min(max(part[x] - at, -bound[x]), bound[x])
            taken += len(part)
        total = 0.0
        for x in range(n):
            total += lanes[x]
        offset += len(line) / taken * total / (_HUBER_SLOPE * weight)
    return float(offset)


@compiled
def _subtract_columns(residual: Plane, tiles: Tiles) -> None:
    """Subtract the offset of each column of the residual."""
    height, width = residual.shape
    offset, step = np.zeros(width, np.float32), np.empty(width, np.float32)
    weight = np.empty(width, np.float32)
    weights = Weights(np.empty(width, np.float32), np.empty(width, np.float32))
    for stride in _ROW_STRIDES:
        step[:], weight[:] = 0.0, 1e-30
        for i in range(len(tiles.y) - 1):
            _weigh(tiles, i, weights)
            for row in range(tiles.y[i], tiles.y[i + 1], stride):
                _gather(residual[row], offset, weights, step)
                _sum_up(weights.unit, weight)
        for x in range(width):
            offset[x] += step[x] / (np.float32(_HUBER_SLOPE) * weight[x])
    for row in range(height):
        _subtract(residual[row], offset)


@compiled
def _sum_up(line: Plane, total: Plane) -> None:
    for x in range(len(line)):
        total[x] += line[x]


@compiled
def _subtract(line: Plane, offset: Plane) -> None:
    for x in range(len(line)):
        line[x] -= offset[x]


@compiled
def _gather(line: Plane, offset: Plane, weights: Weights, total: Plane) -> None:
    """Add the influence of a row's pixels to the totals of their columns."""
    bound, unit = weights.bound, weights.unit
    for x in range(len(line)):
        total[x] += unit[x] * min(max(line[x] - offset[x], -bound[x]), bound[x])
