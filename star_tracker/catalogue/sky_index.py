"""Which guide stars are near a direction: stars in cells of declination and right ascension."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled, inlined, prefetch
from star_tracker.geometry.spherical import Floats, ra_dec

_BAND_RAD = float(np.radians(4.0))
_N_BANDS = int(np.ceil(np.pi / _BAND_RAD))
#: Cells of a band: of 2.8 deg on the equator, narrower elsewhere.
_CELLS = 128
_CELL_RAD = 2 * np.pi / _CELLS


class SkyIndex(NamedTuple):
    """Guide stars sorted by band of declination, within a band by right ascension.

    Attributes:
        vectors: (n, 3) unit vectors of all guide stars, by catalogue index.
        cell_start: (bands * cells + 1,) int32, where each cell of right ascension of each band
            begins in the next two.
        star: (n,) catalogue index.
        sorted_vectors: (n, 3) unit vectors in the order of `star`.
    """

    vectors: Floats
    cell_start: NDArray[np.int32]
    star: NDArray[np.int32]
    sorted_vectors: Floats

    @classmethod
    def build(cls, vectors: Floats) -> "SkyIndex":
        """Sort stars (n, 3)."""
        ra, dec = ra_dec(vectors)
        band = np.minimum((dec + np.pi / 2) / _BAND_RAD, _N_BANDS - 1).astype(np.int64)
        cell = _CELLS * band + np.minimum(ra / _CELL_RAD, _CELLS - 1).astype(np.int64)
        order = np.lexsort((ra, cell))
        start = np.searchsorted(cell[order], np.arange(_N_BANDS * _CELLS + 1))
        return cls(
            np.ascontiguousarray(vectors), start.astype(np.int32), order.astype(np.int32),
            np.ascontiguousarray(vectors[order]),
        )


@inlined
def _prefetch_stars(index: SkyIndex, at: int) -> None:
    """Have the first stars of a run fetched, five to eight of them."""
    prefetch(index.star, at)
    for line in range(3):
        prefetch(index.sorted_vectors, 3 * at + 8 * line)


@compiled
def stars_near(
    index: SkyIndex, direction: Floats, reach_rad: float, found: NDArray[np.int64],
    vectors: Floats,
) -> int:
    """Find the stars within `reach_rad` of a unit vector (3,); return their number.

    Writes their catalogue indices to `found` and their unit vectors to `vectors`, which must have
    room for all guide stars; what stands behind those found means nothing.
    """
    x, y, z = direction[0], direction[1], direction[2]
    dec = np.arctan2(z, np.hypot(x, y))
    ra = np.arctan2(y, x) % (2 * np.pi)
    first = max(0, int((dec - reach_rad + np.pi / 2) / _BAND_RAD))
    last = min(_N_BANDS - 1, int((dec + reach_rad + np.pi / 2) / _BAND_RAD))
    west, n_cells = 0, _CELLS
    if abs(dec) + reach_rad < np.pi / 2:
        half_width = np.arcsin(np.sin(reach_rad) / np.cos(dec)) + 1e-9
        west = int(np.floor((ra - half_width) / _CELL_RAD))
        n_cells = min(int(np.floor((ra + half_width) / _CELL_RAD)) - west + 1, _CELLS)
        west %= _CELLS
    # Two runs of cells where right ascension 0 is among them.
    before_0 = min(n_cells, _CELLS - west)
    runs = (0, n_cells - before_0), (west, west + before_0)
    cell_start = index.cell_start
    for band in range(first, last + 1):
        for run in runs:
            prefetch(cell_start, _CELLS * band + run[0])
            prefetch(cell_start, _CELLS * band + run[1])
    for band in range(first, last + 1):
        for run in runs:
            if run[1] > run[0]:
                _prefetch_stars(index, cell_start[_CELLS * band + run[0]])
    cos_reach = np.cos(reach_rad)
    n = 0
    for band in range(first, last + 1):
        for run in runs:
            begin, end = cell_start[_CELLS * band + run[0]], cell_start[_CELLS * band + run[1]]
            for at in range(begin, end):
                # Written in any case: to skip a star takes longer than to write it.
                v = index.sorted_vectors[at]
                found[n] = index.star[at]
                vectors[n, 0], vectors[n, 1], vectors[n, 2] = v[0], v[1], v[2]
                n += v[0] * x + v[1] * y + v[2] * z > cos_reach
    return n
