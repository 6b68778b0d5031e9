"""Triangles of guide stars by shape: what a star's near companions look like at any scale.

Around each guide star its nearest companions form a fan. Two of them, the first and the second,
make a triangle with it: the logarithm of the ratio of their separations and the angle between them
do not depend on the scale of an image nor on its roll. Triangles are kept in cells of that shape,
within a cell by the separation of the second companion, so that a known scale selects a few of
them, and each row votes for (guide star, roll) as a row of the pair table does.
"""

from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.catalogue.pairs import AZIMUTH_BITS, azimuth_units, piecewise
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats, position_angle, separation

#: Companions of each guide star that make its triangles.
COMPANIONS = 20
#: More triangles than this are not made (some 50 MB): the companions are fewer then.
MOST_TRIANGLES = 17_000_000
_FEWEST_COMPANIONS = 6
#: Cells of a shape: log ratio of the separations, log separation of the second companion over the
#: mean spacing of the stars, and angle from the first to the second companion.
RATIO_STEP, RATIO_LOW, RATIO_CELLS = 0.035, -0.21, 56
SIZE_STEP, SIZE_LOW, SIZE_CELLS = 0.06, -1.4, 52
ANGLE_CELLS = 128


class TriangleTable(NamedTuple):
    """Triangles of a guide star and two of its nearest companions.

    Attributes:
        cell_start: (cells + 1,) int32, the first row of each cell of ratio, size and angle.
        log_spacing: log of the mean spacing of the stars, rad.
        main_azimuth: (t,) int32, index of the guide star * 256 + position angle of the second.
        fan_log_separation: (n, c) float32, of each star's nearest companions, ascending.
        fan_azimuth: (n, c) float32, their position angles, rad.
        fan_star: (n, c) int32, their catalogue indices.
    """

    cell_start: NDArray[np.int32]
    log_spacing: float
    main_azimuth: NDArray[np.int32]
    fan_log_separation: NDArray[np.float32]
    fan_azimuth: NDArray[np.float32]
    fan_star: NDArray[np.int32]

    @classmethod
    def empty(cls) -> "TriangleTable":
        """Return a table without triangles, for a camera whose scale is known."""
        none = np.zeros((0, 0), np.float32)
        rows = np.zeros(0, np.int32)
        return cls(np.zeros(1, np.int32), 0.0, rows, none, none.copy(), np.zeros((0, 0), np.int32))

    @classmethod
    def build(cls, vectors: Floats, n_companions: int = 0) -> "TriangleTable":
        """Make the triangles of stars (n, 3) with the nearest `n_companions` of each.

        0 is automatic: 20, and fewer for more than 42,000 stars.
        """
        n = len(vectors)
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
        count = np.zeros(RATIO_CELLS * SIZE_CELLS * ANGLE_CELLS + 1, np.int32)
        units, none = azimuth_units(angle), np.empty(0, np.int32)
        _sort_by_shape(log_apart - log_spacing, angle, units, count[1:], none)
        start = np.cumsum(count, dtype=np.int32)
        rows = np.empty(start[-1], np.int32)
        _sort_by_shape(log_apart - log_spacing, angle, units, start[:-1].copy(), rows)
        return cls(
            start, log_spacing, rows,
            log_apart.astype(np.float32), angle.astype(np.float32), near.astype(np.int32),
        )


@compiled
def _sort_by_shape(
    log_size: Floats, angle: Floats, units: NDArray[np.int32], at: NDArray[np.int32],
    rows: NDArray[np.int32],
) -> None:
    """Count the triangles of each cell in `at`; with rows, write them from there on instead.

    The sizes of each star ascend, so that the ratios of a second companion descend.
    """
    counts_only = len(rows) == 0
    n, n_companions = log_size.shape
    for main in range(n):
        own, own_angle = log_size[main], angle[main]
        for second in range(n_companions):
            size = np.floor((own[second] - SIZE_LOW) / SIZE_STEP)
            if not 0 <= size < SIZE_CELLS:
                continue
            row = np.int32((main << AZIMUTH_BITS) | units[main, second])
            for first in range(n_companions):
                ratio = (own[second] - own[first] - RATIO_LOW) / RATIO_STEP
                if ratio < 0:
                    break
                if first == second or ratio >= RATIO_CELLS:
                    continue
                turn = own_angle[second] - own_angle[first]
                if turn < 0:  # a third of the time of the remainder
                    turn += 2 * np.pi
                around = min(int(turn * (ANGLE_CELLS / (2 * np.pi))), ANGLE_CELLS - 1)
                cell = (int(ratio) * SIZE_CELLS + int(size)) * ANGLE_CELLS + around
                if not counts_only:
                    rows[at[cell]] = row
                at[cell] += 1
