"""Triangles of guide stars by shape: what a star's near companions look like at any scale.

Around each guide star its nearest companions form a fan. Two of them, the first and the second,
make a triangle with it: the logarithm of the ratio of their separations and the angle between them
do not depend on the scale of an image nor on its roll. Triangles are kept in cells of that shape,
within a cell by the separation of the second companion, so that a known scale selects a few of
them, and each row votes for (guide star, roll) as a row of the pair table does.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from star_tracker.catalogue.pairs import AZIMUTH_BITS, azimuth_units
from star_tracker.geometry.spherical import Floats, position_angle, separation

#: Companions of each guide star that make its triangles.
COMPANIONS = 20
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
    def build(cls, vectors: Floats, n_companions: int = COMPANIONS) -> "TriangleTable":
        """Make the triangles of stars (n, 3) with the nearest `n_companions` of each."""
        n = len(vectors)
        _, near = cKDTree(vectors).query(vectors, k=min(n_companions + 1, n))
        own = near == np.arange(n)[:, None]
        own[~own.any(axis=1), -1] = True
        near = near[~own].reshape(n, -1)
        main = np.repeat(np.arange(n), near.shape[1])
        apart = separation(vectors[main], vectors[near.ravel()]).reshape(near.shape)
        order = np.argsort(apart, axis=1, kind="stable")
        near, apart = np.take_along_axis(near, order, 1), np.take_along_axis(apart, order, 1)
        angle = position_angle(vectors[main], vectors[near.ravel()]).reshape(near.shape)
        log_apart = np.log(apart)
        first, second = np.triu_indices(near.shape[1], 1)
        log_spacing = 0.5 * float(np.log(4.0 / n))
        cells, rows = [], []
        for a, b in ((first, second), (second, first)):
            ratio = log_apart[:, b] - log_apart[:, a]
            turn = (angle[:, b] - angle[:, a]) % (2 * np.pi)
            at = np.floor((ratio - RATIO_LOW) / RATIO_STEP).astype(np.int64)
            size = np.floor((log_apart[:, b] - log_spacing - SIZE_LOW) / SIZE_STEP)
            size = size.astype(np.int64)
            around = np.minimum(turn * (ANGLE_CELLS / (2 * np.pi)), ANGLE_CELLS - 1)
            keep = (at >= 0) & (at < RATIO_CELLS) & (size >= 0) & (size < SIZE_CELLS)
            cells.append(((at * SIZE_CELLS + size) * ANGLE_CELLS + around.astype(np.int64))[keep])
            code = (np.arange(n)[:, None] << AZIMUTH_BITS) | azimuth_units(angle)[:, b]
            rows.append(code[keep].astype(np.int32))
        cell, row = np.concatenate(cells), np.concatenate(rows)
        order = np.argsort(cell, kind="stable")
        n_cells = RATIO_CELLS * SIZE_CELLS * ANGLE_CELLS
        start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=n_cells))])
        return cls(
            start.astype(np.int32), log_spacing, row[order],
            log_apart.astype(np.float32), angle.astype(np.float32), near.astype(np.int32),
        )
