"""Radial-companion-cyclic patterns with compensation codes (paper, 5.3.1 to 5.3.3).

A star's pattern describes its neighbours within a radius, whatever the roll of the camera:

- radial: one bit for each ring that holds a neighbour (5-7 to 5-9);
- companion: one bit for each ring, twice as wide, that holds a separation of two neighbours
  (5-10);
- cyclic: one bit for each of 8 sectors that holds a neighbour, counted from a side of the smallest
  angle between two neighbours.

A value near a ring's edge may fall into the next ring under noise. A compensation code sets that
bit too. One function makes the patterns of the catalogue and of the image.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats, chord, position_angle, separation

SECTORS = 8
#: Thresholds of the compensation code: fractions of a ring (5.3.3).
COMPENSATION = (0.3, 0.7)
#: Chance that an observed neighbour is a true star in its right ring.
_TRUE_BIT = 0.5
Bits = NDArray[np.bool_]


@dataclass(frozen=True)
class PatternSettings:
    """Geometry of the patterns.

    Attributes:
        radius_rad: neighbours up to this separation count (R_r).
        ring_rad: width of a ring (e); a pattern has radius / ring bits (5-7).
    """

    radius_rad: float = float(np.radians(6.0))
    ring_rad: float = float(np.radians(0.05))

    def __post_init__(self) -> None:
        if not 0 < self.ring_rad < self.radius_rad < np.pi / 4:
            raise ValueError("pattern rings must be narrower than the radius, that below 45 deg")
        if abs(self.radius_rad / self.ring_rad - self.n_rings) > 1e-6:
            raise ValueError("the pattern radius must be a whole number of rings")

    @property
    def n_rings(self) -> int:
        """Number of rings, and of bits of the radial and of the companion vector."""
        return round(self.radius_rad / self.ring_rad)

    @property
    def n_bytes(self) -> int:
        """Number of bytes of a star's packed pattern."""
        return 2 * -(-self.n_rings // 8) + 1


@dataclass(frozen=True)
class Pattern:
    """One star's bit vectors: radial (n_rings,), companion (n_rings,), cyclic (8,)."""

    radial: Bits
    companion: Bits
    cyclic: Bits


def star_pattern(
    star: Floats,
    neighbours: Floats,
    settings: PatternSettings,
    *,
    pole: tuple[float, float, float] = (0.0, 0.0, 1.0),
    compensated: bool,
) -> Pattern:
    """Return the pattern of a star (3,) with neighbours (k, 3), unit vectors of one frame.

    Position angles are counted about `pole`, which must not lie at the star. The frame must not be
    mirrored: an image goes through its parity first.
    """
    n = settings.n_rings
    radial = np.asarray(separation(neighbours, star)) / settings.ring_rad
    first, second = np.triu_indices(len(neighbours), 1)
    mutual = np.asarray(separation(neighbours[first], neighbours[second]))
    sectors = _from_smallest_angle(position_angle(star, neighbours, pole))
    return Pattern(
        _bits(radial, n, compensated=compensated),
        _bits(mutual / (2 * settings.ring_rad), n, compensated=compensated),
        _bits(sectors, SECTORS, compensated=compensated, cyclic=True),
    )


def _from_smallest_angle(angles_rad: Floats) -> Floats:
    """Return position angles as sectors [0, 8) from the first side of the smallest gap."""
    if len(angles_rad) == 0:
        return angles_rad
    ordered = np.sort(angles_rad)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    # With one neighbour the only gap is the full circle, and that neighbour its first side.
    start = ordered[int(np.argmin(gaps))]
    return np.asarray((angles_rad - start) % (2 * np.pi) * (SECTORS / (2 * np.pi)))


def _bits(values: Floats, n: int, *, compensated: bool, cyclic: bool = False) -> Bits:
    """Set the bit that each value falls into (5-9) and its compensation codes.

    Bits are counted from 0, in the paper from 1.
    """
    ring = np.floor(values).astype(np.intp)
    if compensated:
        low, high = COMPENSATION
        fraction = values - ring
        ring = np.concatenate([ring, ring[fraction < low] - 1, ring[fraction > high] + 1])
    bits = np.zeros(n, np.bool_)
    if cyclic:
        bits[ring % n] = True
    else:
        bits[ring[(ring >= 0) & (ring < n)]] = True
    return bits


@dataclass(frozen=True, eq=False)
class PatternLevel:
    """All guide stars' patterns at one width of ring, ready for matrix products.

    Attributes:
        settings: the geometry, with the widened rings.
        radial, companion: (n, n_rings) float32, 0 or 1, compensated.
        cyclic: (n, 8) float32, 0 or 1, compensated.
    """

    settings: PatternSettings
    radial: NDArray[np.float32]
    companion: NDArray[np.float32]
    cyclic: NDArray[np.float32]

    @cached_property
    def log_likelihoods(self) -> dict[str, tuple[Floats, Floats]]:
        """What an observed bit that matches, and one that does not, says for each star.

        That is the log likelihood ratio of "it is this star", in which case a bit is a true
        neighbour's with probability 1/2, against "it is any other", in which case a bit matches
        with the fraction of the star's bits that are set; two arrays (n,) for the radial and for
        the companion bits.
        """
        result = {}
        for name in ("radial", "companion"):
            stars = getattr(self, name)
            margin = 0.5 / stars.shape[1]
            fill = np.clip(stars.mean(axis=1), margin, 1 - margin)
            hit = _TRUE_BIT + (1 - _TRUE_BIT) * fill
            result[name] = (np.log(hit / fill), np.log((1 - hit) / (1 - fill)))
        return result


class PatternTable:
    """The compensated patterns of all guide stars, packed to bits.

    Attributes:
        settings: the geometry that built them.
        packed: (n, bytes) uint8: radial, companion and cyclic bits, each filled up to whole bytes.
    """

    def __init__(self, settings: PatternSettings, packed: NDArray[np.uint8]) -> None:
        self.settings = settings
        self.packed = packed
        self._levels: dict[int, PatternLevel] = {}

    @classmethod
    def build(cls, vectors: Floats, settings: PatternSettings) -> "PatternTable":
        """Make the patterns of all stars (n, 3): 0.4 s for 4908 stars."""
        tree = scipy.spatial.cKDTree(vectors)
        radius = float(chord(settings.radius_rad))
        near = tree.query_ball_point(vectors, radius, return_sorted=True)
        rows = []
        for star, members in enumerate(near):
            index = np.array(members)
            pattern = star_pattern(
                vectors[star], vectors[index[index != star]], settings, compensated=True
            )
            rows.append(np.concatenate([
                np.packbits(pattern.radial), np.packbits(pattern.companion),
                np.packbits(pattern.cyclic),
            ]))
        return cls(settings, np.array(rows))

    def level(self, factor: int) -> PatternLevel:
        """Return the patterns with rings `factor` times as wide; built at first use.

        A wide ring's bit is set where one of its narrow rings' is: exactly the pattern of the wide
        rings, with the narrow rings' compensation codes.
        """
        if factor not in self._levels:
            n, ring_bytes = self.settings.n_rings, -(-self.settings.n_rings // 8)
            if n % factor:
                raise ValueError(
                    f"{n} rings cannot be joined by {factor}: use a factor that divides {n}"
                )
            parts = np.split(self.packed, [ring_bytes, 2 * ring_bytes], axis=1)
            radial, companion = (
                np.unpackbits(part, axis=1, count=n).reshape(len(part), -1, factor)
                for part in parts[:2]
            )
            self._levels[factor] = PatternLevel(
                replace(self.settings, ring_rad=self.settings.ring_rad * factor),
                radial.max(axis=2, initial=0).astype(np.float32),
                companion.max(axis=2, initial=0).astype(np.float32),
                np.unpackbits(parts[2], axis=1).astype(np.float32),
            )
        return self._levels[factor]
