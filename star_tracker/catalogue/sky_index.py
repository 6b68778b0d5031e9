"""Which guide stars are near a direction: stars in bands of declination, by right ascension."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled, first_not_below
from star_tracker.geometry.spherical import Floats, ra_dec

_BAND_RAD = float(np.radians(4.0))


class SkyIndex(NamedTuple):
    """Guide stars sorted by band of declination, within a band by right ascension.

    Attributes:
        vectors: (n, 3) unit vectors of all guide stars, by catalogue index.
        band_start: (bands + 1,) where each band begins in the next two.
        star: (n,) catalogue index.
        sorted_vectors: (n, 3) unit vectors in the order of `star`.
        ra_rad: (n,) right ascension in [0, 2 pi).
    """

    vectors: Floats
    band_start: NDArray[np.int64]
    star: NDArray[np.int32]
    sorted_vectors: Floats
    ra_rad: Floats

    @classmethod
    def build(cls, vectors: Floats) -> "SkyIndex":
        """Sort stars (n, 3)."""
        ra, dec = ra_dec(vectors)
        n_bands = int(np.ceil(np.pi / _BAND_RAD))
        band = np.minimum((dec + np.pi / 2) / _BAND_RAD, n_bands - 1).astype(np.int64)
        order = np.lexsort((ra, band))
        start = np.searchsorted(band[order], np.arange(n_bands + 1))
        return cls(
            np.ascontiguousarray(vectors), start.astype(np.int64), order.astype(np.int32),
            np.ascontiguousarray(vectors[order]), np.ascontiguousarray(ra[order]),
        )


@compiled
def stars_near(
    index: SkyIndex, direction: Floats, reach_rad: float, found: NDArray[np.int64],
    vectors: Floats,
) -> int:
    """Find the stars within `reach_rad` of a unit vector (3,); return their number.

    Writes their catalogue indices to `found` and their unit vectors to `vectors`, which must have
    room for all guide stars.
    """
    x, y, z = direction[0], direction[1], direction[2]
    dec = np.arctan2(z, np.hypot(x, y))
    ra = np.arctan2(y, x) % (2 * np.pi)
    cos_reach = np.cos(reach_rad)
    n_bands = len(index.band_start) - 1
    first = max(0, int((dec - reach_rad + np.pi / 2) / _BAND_RAD))
    last = min(n_bands - 1, int((dec + reach_rad + np.pi / 2) / _BAND_RAD))
    half_width = np.pi
    if abs(dec) + reach_rad < np.pi / 2:
        half_width = np.arcsin(np.sin(reach_rad) / np.cos(dec)) + 1e-9
    n = 0
    for band in range(first, last + 1):
        begin, end = index.band_start[band], index.band_start[band + 1]
        # One run of right ascensions, or two where it crosses 0.
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):
            low, high = ra - half_width + turn, ra + half_width + turn
            if high < 0.0 or low >= 2 * np.pi:
                continue
            if half_width >= np.pi and turn != 0.0:
                continue
            at = begin
            if half_width < np.pi:
                at = first_not_below(index.ra_rad, begin, end, low)
            while at < end and (half_width >= np.pi or index.ra_rad[at] <= high):
                v = index.sorted_vectors[at]
                if v[0] * x + v[1] * y + v[2] * z > cos_reach:
                    found[n] = index.star[at]
                    vectors[n, 0], vectors[n, 1], vectors[n, 2] = v[0], v[1], v[2]
                    n += 1
                at += 1
    return n
