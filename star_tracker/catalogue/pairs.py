"""Guide-star pairs, sorted by separation (paper, 5.2.4.1), each stored in both directions.

The paper keeps undirected pairs in bins of 0.01 deg. Here a pair (main, companion) also carries
the companion's position angle about the main star, so that a match votes for a roll as well as
for a star. The same pairs are kept a second time by main star, to find the companions of one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.compiled import compiled, first_not_below
from star_tracker.geometry.spherical import Floats, chord, position_angle, separation

#: Position angles are stored in 8 bits: one unit is 360 / 256 deg.
AZIMUTH_UNITS = 256
AZIMUTH_BITS = 8
#: More directed pairs than this (about 140 MB) is a catalogue too deep for the separation.
MAX_DIRECTED_PAIRS = 8_000_000
#: Bins of separation that shorten a search, 0.01 deg as in the paper.
_BIN_RAD = float(np.radians(0.01))
#: Pairs that are computed at once.
_PIECE = 65_536


def azimuth_units(angle_rad: Floats) -> NDArray[np.int32]:
    """Return position angles in [0, 2 pi) as whole units in [0, 256), rounded down."""
    units = np.floor(angle_rad * (AZIMUTH_UNITS / (2 * np.pi))).astype(np.int32)
    return units & (AZIMUTH_UNITS - 1)


class PairTable(NamedTuple):
    """Directed guide-star pairs, all sorted by separation, and sorted by main star.

    Attributes:
        separation_rad: (p,) float32, ascending.
        main_azimuth: (p,) int32, index of the main star * 256 + position angle in units.
        bin_start: (bins + 1,) the first row of each bin of 0.01 deg.
        near_start: (n + 1,) where the companions of each star begin in the next three.
        near_separation_rad: (p,) float32, ascending for each star.
        near_azimuth: (p,) uint8, position angle in units.
        near_companion: (p,) int32, catalogue index.
        max_separation_rad: pairs up to this separation were taken.
    """

    separation_rad: NDArray[np.float32]
    main_azimuth: NDArray[np.int32]
    bin_start: NDArray[np.int64]
    near_start: NDArray[np.int64]
    near_separation_rad: NDArray[np.float32]
    near_azimuth: NDArray[np.uint8]
    near_companion: NDArray[np.int32]
    max_separation_rad: float

    @classmethod
    def build(cls, catalog: StarCatalog, max_separation_rad: float) -> "PairTable":
        """Find all pairs up to `max_separation_rad`.

        Raises ValueError where the catalogue is too deep for that separation.
        """
        tree = checked_tree(catalog, max_separation_rad)
        radius = float(chord(max_separation_rad))
        pairs = tree.query_pairs(radius, output_type="ndarray")
        # Sorted by star first: ties in separation are then in the same order on every machine.
        # Each pair is followed by its reverse, so that half of the sorting is enough.
        key = np.sort(pairs.min(axis=1) * len(catalog) + pairs.max(axis=1))
        first, second = (part.astype(np.int32) for part in np.divmod(key, len(catalog)))
        half = piecewise(_separations, catalog.vectors, first, second)
        order = np.argsort(half, kind="stable")
        first, second = first[order], second[order]
        distance = np.repeat(half[order], 2)
        main = np.column_stack([first, second]).ravel()
        companion = np.column_stack([second, first]).ravel()
        azimuth = piecewise(_azimuths, catalog.vectors, main, companion)
        # numpy sorts 16 bits three times as fast.
        narrow = main.astype(np.uint16) if len(catalog) <= 1 << 16 else main
        near = np.argsort(narrow, kind="stable")
        n_bins = int(max_separation_rad / _BIN_RAD) + 2
        edges = (np.arange(n_bins + 1) * _BIN_RAD).astype(np.float32)
        return cls(
            distance,
            (main << AZIMUTH_BITS) | azimuth,
            np.searchsorted(distance, edges).astype(np.int64),
            np.searchsorted(main[near], np.arange(len(catalog) + 1)).astype(np.int64),
            distance[near],
            azimuth[near].astype(np.uint8),
            companion[near],
            float(max_separation_rad),
        )

    @property
    def n_pairs(self) -> int:
        """Number of undirected pairs."""
        return len(self.near_companion) // 2

    @property
    def nbytes(self) -> int:
        """Size of the table in memory, bytes."""
        return sum(array.nbytes for array in self if isinstance(array, np.ndarray))

    def ranges(self, low_rad: Floats, high_rad: Floats) -> tuple[NDArray[np.intp], ...]:
        """Return the first and one-past-last row of the pairs between two separations."""
        first = np.searchsorted(self.separation_rad, low_rad.astype(np.float32), "left")
        last = np.searchsorted(self.separation_rad, high_rad.astype(np.float32), "right")
        return first, np.maximum(last, first)


def checked_tree(catalog: StarCatalog, max_separation_rad: float) -> Any:
    """Return the tree of the stars that finds their pairs, counted in some 0.1 s.

    Raises ValueError where the catalogue is too deep for that separation.
    """
    tree = scipy.spatial.cKDTree(catalog.vectors)
    radius = float(chord(max_separation_rad))
    directed = tree.count_neighbors(tree, radius) - len(catalog)
    if directed > MAX_DIRECTED_PAIRS:
        # Their number goes with the area, but for the Milky Way: 2 % less are enough.
        enough = np.degrees(max_separation_rad) * np.sqrt(0.98 * MAX_DIRECTED_PAIRS / directed)
        raise ValueError(
            f"{len(catalog)} stars make {directed} directed pairs up to "
            f"{np.degrees(max_separation_rad):.3g} deg, more than {MAX_DIRECTED_PAIRS}: set "
            f"max_separation_deg to {np.floor(10 * enough) / 10:g} or less (0 = automatic), "
            "or lower limiting_magnitude"
        )
    return tree


def _separations(main: Floats, companion: Floats) -> NDArray[np.float32]:
    return np.asarray(separation(main, companion), np.float32)


def _azimuths(main: Floats, companion: Floats) -> NDArray[np.int32]:
    return azimuth_units(position_angle(main, companion))


def piecewise(
    of_pairs: Callable[[Floats, Floats], NDArray[Any]], vectors: Floats,
    main: NDArray[np.integer[Any]], companion: NDArray[np.integer[Any]],
) -> NDArray[Any]:
    """Return a function of two stars for all pairs, in pieces that stay in the cache.

    Twice as fast as all at once for millions of pairs, and without their vectors in memory.
    """
    pieces = [slice(at, at + _PIECE) for at in range(0, max(len(main), 1), _PIECE)]
    return np.concatenate([
        of_pairs(vectors[main[piece]], vectors[companion[piece]]) for piece in pieces
    ])


@compiled
def first_row(pairs: PairTable, separation_rad: float) -> int:
    """Return the first row whose pair is at least so far apart."""
    bins = len(pairs.bin_start) - 1
    at = min(max(int(separation_rad / _BIN_RAD), 0), bins)
    # One bin of slack on either side for what float32 has rounded.
    begin, end = pairs.bin_start[max(at - 1, 0)], pairs.bin_start[min(at + 2, bins)]
    return first_not_below(pairs.separation_rad, begin, end, np.float32(separation_rad))


@compiled
def first_near(pairs: PairTable, star: int, separation_rad: float) -> int:
    """Return the first row of a star's own companions that are at least so far away."""
    return first_not_below(
        pairs.near_separation_rad, pairs.near_start[star], pairs.near_start[star + 1],
        np.float32(separation_rad),
    )
