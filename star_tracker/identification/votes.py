"""Votes for guide stars and rolls: the counting of the primary matcher (paper, 5.2.5).

A cell is a guide star and one of 64 roll bins. Each vote counts in its bin and the next one, so
that no roll falls between two. The counts of one guide star's 64 bins stand side by side in the
bits of a few words, the first word holding the lowest digit of each, so that the whole sky's votes
fit into the fastest memory.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.pairs import AZIMUTH_BITS, AZIMUTH_UNITS, PairTable, first_row
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.field import Frame

#: 64 roll bins of 5.6 deg for each guide star.
ROLL_BITS = 6
ROLL_BINS = 1 << ROLL_BITS
#: Position angles have 8 bits, roll bins 6.
ROLL_SHIFT = 2
#: Words of a count: two that every vote looks at, four that few do. Counts begin anew at 64, which
#: no cell of a catalogue has come near to.
_LOW_WORDS, _HIGH_WORDS = 2, 4
_ONE = np.uint64(1)
_LAST_BIN = np.uint64(ROLL_BINS - 1)
_BITS = np.uint64(ROLL_BINS)
_TWO_BINS = np.uint64(3)
#: So many cells that reach the threshold are remembered; so many are expected to by chance.
_REMEMBERED = 1024
_BY_CHANCE = 150.0
#: Votes of one main star are bounded, but so many companions vote in any case.
_MOST_VOTES, _FEWEST_COMPANIONS = 100_000, 3


class Votes(NamedTuple):
    """The votes for one main star; made once and used again for each.

    Attributes:
        low, high: (n, 2) and (n, 4) uint64, the digits of each guide star's 64 counts; all 0
            between main stars.
        carried, n_carried: (r,) and (1,) the stars that have digits in `high`, and how many; not
            all are remembered.
        reached: (r,) cells that reached the threshold, in that order.
        companion: (c,) the main star's nearest companions in the frame.
        separation: (c,) their separation from it, rad.
        azimuth: (c,) their position angle about it, in units.
        first, last: (c,) first and one-past-last row of the guide-star pairs of that separation.
    """

    low: NDArray[np.uint64]
    high: NDArray[np.uint64]
    carried: NDArray[np.int64]
    n_carried: NDArray[np.int64]
    reached: NDArray[np.int64]
    companion: NDArray[np.int64]
    separation: Floats
    azimuth: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]


def vote_counts(n_stars: int) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return `low` and `high` of a catalogue without any votes."""
    return (
        np.zeros((n_stars, _LOW_WORDS), np.uint64), np.zeros((n_stars, _HIGH_WORDS), np.uint64)
    )


@compiled
def empty_votes(
    low: NDArray[np.uint64], high: NDArray[np.uint64], n_companions: int
) -> Votes:
    """Return what `look_around` and `cast` fill."""
    return Votes(
        low, high, np.empty(_REMEMBERED, np.int64), np.zeros(1, np.int64),
        np.empty(_REMEMBERED, np.int64),
        np.empty(n_companions, np.int64), np.empty(n_companions),
        np.empty(n_companions, np.int64), np.empty(n_companions, np.int64),
        np.empty(n_companions, np.int64),
    )


@compiled
def look_around(frame: Frame, main: int, most: int, votes: Votes) -> int:
    """Find the nearest companions of a main star, at most `most`; return their number."""
    vectors, chord2 = frame.vectors, votes.separation
    v, n = vectors[main], 0
    for star in range(len(vectors)):
        if star == main:
            continue
        u = vectors[star]
        dx, dy, dz = u[0] - v[0], u[1] - v[1], u[2] - v[2]
        d2 = dx * dx + dy * dy + dz * dz
        if n == most and d2 >= chord2[n - 1]:
            continue
        at = n if n < most else most - 1
        while at > 0 and chord2[at - 1] > d2:
            chord2[at], votes.companion[at] = chord2[at - 1], votes.companion[at - 1]
            at -= 1
        chord2[at], votes.companion[at] = d2, star
        n = min(n + 1, most)
    for i in range(n):
        u = vectors[votes.companion[i]]
        votes.separation[i] = 2 * np.arcsin(min(1.0, 0.5 * np.sqrt(chord2[i])))
        # From the image's up direction, -y, towards celestial east's side; see position_angle.
        east = u[2] * v[0] - u[0] * v[2]
        north = -u[1] + v[1] * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
        angle = np.arctan2(east, north)
        votes.azimuth[i] = int(np.floor(angle * (AZIMUTH_UNITS / (2 * np.pi)))) & (
            AZIMUTH_UNITS - 1
        )
    return n


@compiled
def choose_rows(
    pairs: PairTable, votes: Votes, begin: int, end: int, tolerance_rad: float
) -> tuple[int, int]:
    """Find the pairs that agree with the separations of the companions begin to end.

    Returns the end of those that are to vote and the number of their votes: in a deep catalogue
    the nearest few have votes enough.
    """
    total = 0
    for i in range(begin, end):
        first = first_row(pairs, votes.separation[i] - tolerance_rad)
        last = max(first, first_row(pairs, votes.separation[i] + tolerance_rad))
        if total + last - first > _MOST_VOTES and i >= begin + _FEWEST_COMPANIONS:
            return i, total
        total += last - first
        votes.first[i], votes.last[i] = first, last
    return end, total


@compiled
def cast(
    pairs: PairTable, votes: Votes, begin: int, end: int, threshold: int, plain: bool, n: int
) -> int:
    """Let the companions begin to end vote.

    Cells that reach the threshold are added to the `n` of `reached`; returns how many there are.
    """
    for i in range(begin, end):
        n = _raise_flags(pairs, votes, i, n) if plain else _vote(pairs, votes, i, threshold, n)
    return n


@compiled
def _vote(pairs: PairTable, votes: Votes, i: int, threshold: int, n: int) -> int:
    """Let one companion vote for the cells of its pairs."""
    none = np.uint64(0)
    for row in range(votes.first[i], votes.last[i]):
        coded = pairs.main_azimuth[row]
        star = np.uint64(coded >> AZIMUTH_BITS)
        roll = np.uint64(((coded - votes.azimuth[i]) & (AZIMUTH_UNITS - 1)) >> ROLL_SHIFT)
        bins = (_TWO_BINS << roll) | (_TWO_BINS >> ((_BITS - roll) & _LAST_BIN))  # rotated
        ones, twos = votes.low[star, 0], votes.low[star, 1]
        carry = ones & bins
        ones, fours, twos = ones ^ bins, twos & carry, twos ^ carry
        votes.low[star, 0], votes.low[star, 1] = ones, twos
        if fours != none:
            _carry_on(votes, star, fours)
        # Only where the count can be the threshold it is looked at closely: rare.
        if threshold == 2:
            hit = bins & twos & ~ones
        elif threshold == 3:
            hit = bins & twos & ones
        else:
            hit = bins & (
                votes.high[star, 0] | votes.high[star, 1]
                | votes.high[star, 2] | votes.high[star, 3]
            )
        if hit != none:
            n = _note(votes, np.int64(star), np.int64(roll), threshold, n)
    return n


@compiled
def _carry_on(votes: Votes, star: int, carry: np.uint64) -> None:
    """Add to the higher digits, and remember for which stars."""
    n = votes.n_carried[0]
    if n < _REMEMBERED:
        votes.carried[n] = star
    votes.n_carried[0] = n + 1
    for digit in range(_HIGH_WORDS):
        before = votes.high[star, digit]
        votes.high[star, digit] = before ^ carry
        carry &= before


@compiled
def _note(votes: Votes, star: int, roll: int, threshold: int, n: int) -> int:
    """Remember the two cells of a vote where they have just reached the threshold."""
    for turned in (roll, (roll + 1) & (ROLL_BINS - 1)):
        cell = (star << ROLL_BITS) | turned
        if n < _REMEMBERED and count_of(votes, cell) == threshold:
            votes.reached[n] = cell
            n += 1
    return n


@compiled
def count_of(votes: Votes, cell: int) -> int:
    """Return the votes of a cell."""
    star, at = cell >> ROLL_BITS, np.uint64(cell & (ROLL_BINS - 1))
    count = np.int64(0)
    for digit in range(_LOW_WORDS):
        count += np.int64((votes.low[star, digit] >> at) & _ONE) << digit
    for digit in range(_HIGH_WORDS):
        count += np.int64((votes.high[star, digit] >> at) & _ONE) << (digit + _LOW_WORDS)
    return count


@compiled
def _raise_flags(pairs: PairTable, votes: Votes, i: int, n: int) -> int:
    """Let one companion raise the flag of each guide star of its pairs once (paper, 5.2.5).

    A star's flag stands in its first cell; its last bin notes that this companion has raised it.
    """
    raised, none = _ONE << _LAST_BIN, np.uint64(0)
    for row in range(votes.first[i], votes.last[i]):
        star = np.uint64(pairs.main_azimuth[row] >> AZIMUTH_BITS)
        ones, twos = votes.low[star, 0], votes.low[star, 1]
        if (ones & raised) != none:
            continue
        carry = ones & _ONE
        votes.low[star, 0], votes.low[star, 1] = (ones ^ _ONE) | raised, twos ^ carry
        if (twos & carry) != none:
            _carry_on(votes, star, twos & carry)
        cell = np.int64(star) << ROLL_BITS
        if n < _REMEMBERED and count_of(votes, cell) == 2:
            votes.reached[n] = cell
            n += 1
    for row in range(votes.first[i], votes.last[i]):
        votes.low[np.uint64(pairs.main_azimuth[row] >> AZIMUTH_BITS), 0] &= ~raised
    return n


@compiled
def clear(votes: Votes) -> None:
    """Take back all votes."""
    votes.low[:] = np.uint64(0)
    n = votes.n_carried[0]
    if n > _REMEMBERED:
        votes.high[:] = np.uint64(0)
    else:
        for i in range(n):
            for digit in range(_HIGH_WORDS):
                votes.high[votes.carried[i], digit] = np.uint64(0)
    votes.n_carried[0] = 0


@compiled
def threshold_for(total: int, n_stars: int) -> int:
    """Return the number of votes that few cells reach by chance."""
    # `total` votes, two cells each: the expected number of cells with j or more.
    n_cells = 1.0 * n_stars * ROLL_BINS
    mean = 2.0 * total / n_cells
    expected, j = n_cells, 0
    while j < 2 or expected > _BY_CHANCE:
        j += 1
        expected *= mean / j
    return j
