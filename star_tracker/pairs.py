"""Guide-star pairs, sorted by separation (paper, 5.2.4.1), each stored in both directions.

The paper keeps undirected pairs. Here a pair (main, companion) also carries the companion's
position angle about the main star, so that a match votes for a roll as well as for a star.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from star_tracker.catalog import StarCatalog
from star_tracker.spherical import Floats, chord, position_angle, separation

#: Position angles are stored in 8 bits: one unit is 360 / 256 deg.
AZIMUTH_UNITS = 256
_AZIMUTH_BITS = 8
#: More directed pairs than this (about 110 MB) is a catalogue too deep for the separation.
MAX_DIRECTED_PAIRS = 8_000_000


def azimuth_units(angle_rad: Floats) -> NDArray[np.int32]:
    """Return position angles in [0, 2 pi) as whole units in [0, 256), rounded down."""
    units = np.floor(angle_rad * (AZIMUTH_UNITS / (2 * np.pi))).astype(np.int32)
    return units & (AZIMUTH_UNITS - 1)


@dataclass(frozen=True)
class PairTable:
    """Directed guide-star pairs in ascending order of separation.

    Attributes:
        separation_rad: (p,) float32.
        main_azimuth: (p,) int32, index of the main star * 256 + position angle in units.
        companion: (p,) int32, catalogue index of the companion.
        max_separation_rad: pairs up to this separation were taken.
    """

    separation_rad: NDArray[np.float32]
    main_azimuth: NDArray[np.int32]
    companion: NDArray[np.int32]
    max_separation_rad: float

    @classmethod
    def build(cls, catalog: StarCatalog, max_separation_rad: float) -> "PairTable":
        """Find all pairs up to `max_separation_rad`.

        Raises ValueError where the catalogue is too deep for that separation.
        """
        tree = cKDTree(catalog.vectors)
        radius = float(chord(max_separation_rad))
        directed = tree.count_neighbors(tree, radius) - len(catalog)
        if directed > MAX_DIRECTED_PAIRS:
            raise ValueError(
                f"{len(catalog)} stars make {directed} directed pairs up to "
                f"{np.degrees(max_separation_rad):.3g} deg, more than {MAX_DIRECTED_PAIRS}: "
                "lower the limiting magnitude or the largest pair separation"
            )
        pairs = tree.query_pairs(radius, output_type="ndarray")
        main = np.concatenate([pairs[:, 0], pairs[:, 1]])
        companion = np.concatenate([pairs[:, 1], pairs[:, 0]])
        half = separation(catalog.vectors[pairs[:, 0]], catalog.vectors[pairs[:, 1]])
        distance = np.concatenate([half, half]).astype(np.float32)
        azimuth = azimuth_units(position_angle(catalog.vectors[main], catalog.vectors[companion]))
        # Ties in separation are broken by star so that the table is the same on every machine.
        order = np.lexsort((companion, main, distance))
        return cls(
            distance[order],
            ((main.astype(np.int32) << _AZIMUTH_BITS) | azimuth)[order],
            companion[order].astype(np.int32),
            float(max_separation_rad),
        )

    @property
    def n_pairs(self) -> int:
        """Number of undirected pairs."""
        return len(self.companion) // 2

    @property
    def nbytes(self) -> int:
        """Size of the table in memory, bytes."""
        return self.separation_rad.nbytes + self.main_azimuth.nbytes + self.companion.nbytes

    def ranges(self, low_rad: Floats, high_rad: Floats) -> tuple[NDArray[np.intp], ...]:
        """Return the first and one-past-last row of the pairs between two separations."""
        first = np.searchsorted(self.separation_rad, low_rad.astype(np.float32), "left")
        last = np.searchsorted(self.separation_rad, high_rad.astype(np.float32), "right")
        return first, np.maximum(last, first)
