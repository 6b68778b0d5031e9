"""Triangles of guide stars by shape: what a star's near companions look like at any scale.

Around each guide star its nearest companions form a fan. Two of them, the first and the second,
make a triangle with it: the logarithm of the ratio of their separations and the angle between them
do not depend on the scale of an image nor on its roll. Triangles are kept in cells of that shape,
within a cell by the separation of the second companion, so that those of a range of scales lie
side by side, and each row votes for (guide star, roll) as a row of the pair table does. It tells,
too, which of the three stars are the brighter ones: where a frame's brightness is known a third of
the rows have its order.
"""

from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.catalogue.pairs import AZIMUTH_BITS, azimuth_units, piecewise
from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats, position_angle, separation

#: Companions of each guide star that make its triangles.
COMPANIONS = 20
#: More triangles than this are not made (some 50 MB): the companions are fewer then.
MOST_TRIANGLES = 17_000_000
_FEWEST_COMPANIONS = 6
#: The order of brightness of a triangle's stars, in a row above the position angle: a bit each
#: for the main star brighter than the first companion, than the second, and the first brighter
#: than the second. The guide star stands above it: more than the 2^20 that there is room for have
#: too many pairs (`pairs.MAX_DIRECTED_PAIRS`).
ORDER_BITS = 3
MAIN_BITS = AZIMUTH_BITS + ORDER_BITS
#: Least log ratio of the separations, and log separation of the second companion over the mean
#: spacing of the stars, that are kept, and the ranges of both.
RATIO_LOW, RATIO_RANGE = -0.21, 1.95
SIZE_LOW, SIZE_RANGE = -1.4, 3.12


class Grid(NamedTuple):
    """Cells of a shape.

    Attributes:
        ratios: cells of the log ratio of the separations.
        angles: cells of the angle from the first to the second companion.
        sizes: cells of the log separation of the second companion.
    """

    ratios: int
    angles: int
    sizes: int

    @property
    def n_cells(self) -> int:
        """How many they are in all."""
        return self.ratios * self.angles * self.sizes


#: Where the scale is known a triangle meets one or two cells of ratio and of angle at the usual
#: tolerances, each another place in memory, and few sizes. Where it is not, the triangles of all
#: sizes vote, hundreds from one place: there narrow cells of shape are worth their number.
KNOWN_SCALE, ANY_SCALE = Grid(39, 64, 104), Grid(98, 256, 13)


class TriangleTable(NamedTuple):
    """Triangles of a guide star and two of its nearest companions.

    Attributes:
        grid: the cells.
        cell_start: (cells + 1,) int32, the first row of each cell of ratio, angle and size.
        log_spacing: log of the mean spacing of the stars, rad.
        rows: (t,) int32, index of the guide star * 2048 + order of brightness * 256 + position
            angle of the second companion in units.
        fan_log_separation: (n, c) float32, of each star's nearest companions, ascending.
        fan_azimuth: (n, c) float32, their position angles, rad.
        fan_star: (n, c) int32, their catalogue indices.
    """

    grid: Grid
    cell_start: NDArray[np.int32]
    log_spacing: float
    rows: NDArray[np.int32]
    fan_log_separation: NDArray[np.float32]
    fan_azimuth: NDArray[np.float32]
    fan_star: NDArray[np.int32]

    @classmethod
    def empty(cls) -> "TriangleTable":
        """Return a table without triangles, for a camera whose scale is known."""
        none = np.zeros((0, 0), np.float32)
        rows = np.zeros(0, np.int32)
        return cls(
            KNOWN_SCALE, np.zeros(1, np.int32), 0.0, rows, none, none.copy(),
            np.zeros((0, 0), np.int32),
        )

    @classmethod
    def build(
        cls, vectors: Floats, v_mag: Floats, n_companions: int = 0, grid: Grid = KNOWN_SCALE
    ) -> "TriangleTable":
        """Make the triangles of stars (n, 3), magnitudes (n,), with `n_companions` nearest each.

        0 is automatic: 20, and fewer for more than 42,000 stars.
        """
        n, v_mag = len(vectors), np.ascontiguousarray(v_mag, float)
        n_companions = n_companions or int(
            np.clip(np.sqrt(MOST_TRIANGLES / max(n, 1)), _FEWEST_COMPANIONS, COMPANIONS)
        )
        nearest = np.arange(1, min(n_companions + 1, n) + 1)  # a list gives two dimensions for one
        _, near = scipy.spatial.cKDTree(vectors).query(vectors, k=nearest)
        own = near == np.arange(n)[:, None]
        own[~own.any(axis=1), -1] = True
        near = near[~own].reshape(n, -1)
        main = np.repeat(np.arange(n), near.shape[1])
        apart = piecewise(separation, vectors, main, near.ravel()).reshape(near.shape)
        order = np.argsort(apart, axis=1, kind="stable")
        near, apart = np.take_along_axis(near, order, 1), np.take_along_axis(apart, order, 1)
        angle = piecewise(position_angle, vectors, main, near.ravel()).reshape(near.shape)
        with np.errstate(divide="ignore"):  # two stars at one place have no shape
            log_apart = np.log(apart)
        log_spacing = 0.5 * float(np.log(4.0 / n))
        count = np.zeros(grid.n_cells + 1, np.int32)
        stars = _Neighbours(
            log_apart - log_spacing, angle, azimuth_units(angle), v_mag, v_mag[near]
        )
        _sort_by_shape(stars, grid, (count[1:], np.empty(0, np.int32)))
        start = np.cumsum(count, dtype=np.int32)
        rows = np.empty(start[-1], np.int32)
        _sort_by_shape(stars, grid, (start[:-1].copy(), rows))
        return cls(
            grid, start, log_spacing, rows,
            log_apart.astype(np.float32), angle.astype(np.float32), near.astype(np.int32),
        )


@inlined
def _brightness_order(main: float, first: float, second: float) -> int:
    """Return the order of three magnitudes, as `ORDER_BITS` of a row."""
    return (main < first) | ((main < second) << 1) | ((first < second) << 2)


class _Neighbours(NamedTuple):
    """The guide stars (n,) and the nearest companions of each (n, c).

    Attributes:
        log_size: log separation of each companion over the mean spacing, ascending.
        angle: its position angle, rad.
        units: the same in units.
        own_mag: (n,) magnitude of the guide star.
        mag: that of each companion.
    """

    log_size: Floats
    angle: Floats
    units: NDArray[np.int32]
    own_mag: Floats
    mag: Floats


@compiled
def _sort_by_shape(
    stars: _Neighbours, grid: Grid, sorted_rows: tuple[NDArray[np.int32], NDArray[np.int32]]
) -> None:
    """Count the triangles of each cell, or sort them into their cells.

    `sorted_rows` are the counts and nothing, or the place where each cell begins and the rows.
    The sizes of each star ascend, so that the ratios of a second companion descend.
    """
    at, rows = sorted_rows
    counts_only = len(rows) == 0
    ratio_step, size_step = RATIO_RANGE / grid.ratios, SIZE_RANGE / grid.sizes
    n, n_companions = stars.log_size.shape
    for main in range(n):
        own, own_angle, mag = stars.log_size[main], stars.angle[main], stars.mag[main]
        for second in range(n_companions):
            size = np.floor((own[second] - SIZE_LOW) / size_step)
            if not 0 <= size < grid.sizes:
                continue
            row = (main << MAIN_BITS) | stars.units[main, second]
            for first in range(n_companions):
                ratio = (own[second] - own[first] - RATIO_LOW) / ratio_step
                if ratio < 0:
                    break
                if first == second or ratio >= grid.ratios:
                    continue
                turn = own_angle[second] - own_angle[first]
                if turn < 0:  # a third of the time of the remainder
                    turn += 2 * np.pi
                around = min(int(turn * (grid.angles / (2 * np.pi))), grid.angles - 1)
                cell = (int(ratio) * grid.angles + around) * grid.sizes + int(size)
                if not counts_only:
                    order = _brightness_order(stars.own_mag[main], mag[first], mag[second])
                    rows[at[cell]] = np.int32(row | (order << AZIMUTH_BITS))
                at[cell] += 1
