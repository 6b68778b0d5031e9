"""Votes for guide stars and rolls: the counting of the primary matcher (paper, 5.2.5).

A cell is a guide star and one of 64 roll bins. Each vote counts in its bin and the next one, so
that no roll falls between two. The counts of one guide star's 64 bins stand side by side in the
bits of a few words, the first word holding the lowest digit of each, so that the whole sky's votes
fit into the fastest memory.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.pairs import AZIMUTH_BITS, AZIMUTH_UNITS, first_row
from star_tracker.catalogue.triangles import ORDER_BITS
from star_tracker.compiled import compiled, inlined, prefetch, struct
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.progress import late

#: 64 roll bins of 5.6 deg for each guide star.
ROLL_BITS = 6
ROLL_BINS = 1 << ROLL_BITS
#: Position angles have 8 bits, roll bins 6.
ROLL_SHIFT = 2
#: Words of a count: two that every vote looks at, six that few do. Counts begin again at 256: the
#: pairs of twenty companions are 190.
_LOW_WORDS, _HIGH_WORDS = 2, 6
_NONE, _ONE = np.uint64(0), np.uint64(1)
_LAST_BIN = np.uint64(ROLL_BINS - 1)
_BITS = np.uint64(ROLL_BINS)
_TWO_BINS = np.uint64(3)
#: So many cells that reach the threshold are remembered; so many are expected to by chance.
_REMEMBERED = 1024
_BY_CHANCE = 150.0
#: Votes are counted so many at a time. Places in arrays are unsigned here: whether a signed one is
#: negative, and counts from the end as in Python, takes a fifth of a vote's time to find out.
_WAITING = 256
_STAR_BITS = np.uint64(ROLL_BITS)
#: Rows of any order of brightness vote (`triangles.ORDER_BITS`); pairs have none.
_LAST_ORDER = (1 << ORDER_BITS) - 1
ANY_ORDER = (1 << _LAST_ORDER + 1) - 1
#: Votes of one main star are bounded, but so many companions vote in any case.
_MOST_VOTES, _FEWEST_COMPANIONS = 100_000, 3


#: The votes for one main star; made once and used again for each:
#:
#: - waiting, n_waiting: (w,) uint64 cells of votes that are not counted yet, and how many;
#: - low, high: (n, 2) and (n, 6) uint64, the digits of each guide star's 64 counts; all 0 between
#:   main stars;
#: - touched, n_touched: (r,) the stars that have votes, and how many; not all are remembered where
#:   `n_touched` is larger;
#: - carried, n_carried: the same of those that have digits in `high`;
#: - reached, n_reached: (r,) cells that reached the threshold, in that order, and how many;
#: - companion: (c,) the main star's nearest companions in the frame;
#: - separation: (c,) their separation from it, rad;
#: - azimuth: (c,) their position angle about it, in units;
#: - first, last: (c,) first and one-past-last row of the guide-star pairs of that separation.
VotesType, Votes = struct("Votes", __name__, (
    "waiting", "n_waiting", "low", "high", "touched", "n_touched", "carried", "n_carried",
    "reached", "n_reached", "companion", "separation", "azimuth", "first", "last",
))


@compiled
def empty_votes(n_stars: int, n_companions: int) -> Any:
    """Return what `look_around` and `cast` fill, for a catalogue of so many guide stars."""
    return Votes(
        np.empty(_WAITING, np.uint64), 0,
        np.zeros((n_stars, _LOW_WORDS), np.uint64), np.zeros((n_stars, _HIGH_WORDS), np.uint64),
        np.empty(_REMEMBERED, np.int64), 0, np.empty(_REMEMBERED, np.int64), 0,
        np.empty(_REMEMBERED, np.int64), 0,
        np.empty(n_companions, np.int64), np.empty(n_companions),
        np.empty(n_companions, np.int64), np.empty(n_companions, np.int64),
        np.empty(n_companions, np.int64),
    )


@compiled
def nearest(frame: Any, main: int, most: int, companion: Any, chord2: Any) -> int:
    """Find the nearest companions of a main star, at most `most`; return their number.

    Writes them to `companion`, and the squares of the chords to them to `chord2`.
    """
    vectors = frame.vectors
    v, n = vectors[main], 0
    for star in range(frame.n):
        if star == main:
            continue
        u = vectors[star]
        dx, dy, dz = u[0] - v[0], u[1] - v[1], u[2] - v[2]
        d2 = dx * dx + dy * dy + dz * dz
        if n == most and d2 >= chord2[n - 1]:
            continue
        at = n if n < most else most - 1
        while at > 0 and chord2[at - 1] > d2:
            chord2[at], companion[at] = chord2[at - 1], companion[at - 1]
            at -= 1
        chord2[at], companion[at] = d2, star
        n = min(n + 1, most)
    return n


@compiled
def look_around(frame: Any, main: int, most: int, votes: Any) -> int:
    """Find the nearest companions of a main star, where they are; return their number."""
    vectors, companion, separation = frame.vectors, votes.companion, votes.separation
    n = nearest(frame, main, most, companion, separation)
    v = vectors[main]
    azimuth = votes.azimuth
    for i in range(n):
        u = vectors[companion[i]]
        separation[i] = 2 * np.arcsin(min(1.0, 0.5 * np.sqrt(separation[i])))
        angle = angle_in_image(v, u)
        azimuth[i] = int(np.floor(angle * (AZIMUTH_UNITS / (2 * np.pi)))) & (
            AZIMUTH_UNITS - 1
        )
    return n


@inlined
def angle_in_image(main: Floats, companion: Floats) -> float:
    """Return the position angle of a companion about a main star, unit vectors in the camera.

    From the image's up direction, -y, towards celestial east's side; see `position_angle`.
    """
    u, v = companion, main
    east = u[2] * v[0] - u[0] * v[2]
    north = -u[1] + v[1] * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
    return float(np.arctan2(east, north))


@compiled
def choose_rows(
    pairs: Any, votes: Any, n_companions: int, tolerance_rad: float
) -> tuple[int, int]:
    """Find the pairs that agree with the separations of the nearest companions.

    Returns the end of those that are to vote and the number of their votes: in a deep catalogue
    the nearest few have votes enough.
    """
    total = 0
    for i in range(n_companions):
        first = first_row(pairs, votes.separation[i] - tolerance_rad)
        last = max(first, first_row(pairs, votes.separation[i] + tolerance_rad))
        if total + last - first > _MOST_VOTES and i >= _FEWEST_COMPANIONS:
            return i, total
        total += last - first
        votes.first[i], votes.last[i] = first, last
    return n_companions, total


class Reading(NamedTuple):
    """How a row's vote is read.

    Attributes:
        azimuth: position angle of the companion in the frame, in units.
        main_bits: the guide star stands above so many bits of a row.
        orders: bit i is set where rows with the number i above their position angle vote.
    """

    azimuth: int
    main_bits: int
    orders: int


@compiled
def cast(pairs: Any, votes: Any, n_companions: int, threshold: int, progress: Any) -> None:
    """Let the nearest companions vote; cells that reach the threshold join `reached`.

    When the time is up those that have not voted do not any more.
    """
    main_azimuth = pairs.main_azimuth
    for i in range(n_companions):
        if late(progress):
            break
        rows = votes.first[i], votes.last[i]
        reading = Reading(votes.azimuth[i], AZIMUTH_BITS, ANY_ORDER)
        vote_rows(main_azimuth, votes, rows, reading, threshold)
    count_waiting(votes, threshold)


@compiled
def vote_rows(
    table: NDArray[np.int32], votes: Any, rows: tuple[int, int], reading: Reading, threshold: int
) -> None:
    """Let rows first to last vote for their guide star at the roll that takes the azimuth there.

    `table` is that of pairs or of triangles. The votes wait until many are there, or
    `count_waiting` is called: rows lie far apart in memory, and so many are on their way at once.
    """
    waiting, n, low = votes.waiting, np.uint64(votes.n_waiting), votes.low
    azimuth, every = reading.azimuth, reading.orders == ANY_ORDER
    for row in range(np.uint64(rows[0]), np.uint64(rows[1])):
        if n == _WAITING:
            votes.n_waiting = _WAITING
            count_waiting(votes, threshold)
            n = _NONE
        coded = np.int64(table[row])
        star, roll = coded >> reading.main_bits, (coded - azimuth) & (AZIMUTH_UNITS - 1)
        waiting[n] = np.uint64((star << ROLL_BITS) | (roll >> ROLL_SHIFT))
        if every:
            prefetch(low, _LOW_WORDS * star)
            n += _ONE
            continue
        # Without a branch, which could not be foreseen: what does not vote is overwritten.
        voting = (reading.orders >> ((coded >> AZIMUTH_BITS) & _LAST_ORDER)) & 1
        prefetch(low, _LOW_WORDS * star * voting)
        n += np.uint64(voting)
    votes.n_waiting = np.int64(n)


@compiled
def count_waiting(votes: Any, threshold: int) -> None:
    """Count the votes that wait; cells that reach the threshold join `reached`."""
    low, high, touched, waiting = votes.low, votes.high, votes.touched, votes.waiting
    n_touched, n_waiting = np.uint64(votes.n_touched), np.uint64(votes.n_waiting)
    votes.n_waiting = 0
    if n_touched + n_waiting > _REMEMBERED:  # too many to remember: see `clear`
        n_touched = np.uint64(_REMEMBERED + 1)
    for i in range(n_waiting):
        star, roll = waiting[i] >> _STAR_BITS, waiting[i] & _LAST_BIN
        bins = (_TWO_BINS << roll) | (_TWO_BINS >> ((_BITS - roll) & _LAST_BIN))  # rotated
        ones, twos = low[star, 0], low[star, 1]
        if n_touched <= _REMEMBERED and ones | twos == _NONE:
            touched[n_touched] = star
            n_touched += _ONE
        carry = ones & bins
        ones, fours, twos = ones ^ bins, twos & carry, twos ^ carry
        low[star, 0], low[star, 1] = ones, twos
        if fours != _NONE:
            _carry_on(votes, star, fours)
        # Only where the count can be the threshold it is looked at closely: rare.
        if threshold == 2:
            hit = bins & twos & ~ones
        elif threshold == 3:
            hit = bins & twos & ones
        else:
            hit = bins & (
                high[star, 0] | high[star, 1] | high[star, 2] | high[star, 3]
                | high[star, 4] | high[star, 5]
            )
        if hit != _NONE:
            _note(votes, np.int64(star), np.int64(roll), threshold)
    votes.n_touched = np.int64(n_touched)


@compiled
def _carry_on(votes: Any, star: np.uint64, carry: np.uint64) -> None:
    """Add to the higher digits, and remember for which stars."""
    n, high = votes.n_carried, votes.high
    if n < _REMEMBERED:
        votes.carried[n] = star
    votes.n_carried = n + 1
    for digit in range(_HIGH_WORDS):
        before = high[star, digit]
        high[star, digit] = before ^ carry
        carry &= before


@compiled
def _note(votes: Any, star: int, roll: int, threshold: int) -> None:
    """Remember the two cells of a vote where they have just reached the threshold."""
    for turned in (roll, (roll + 1) & (ROLL_BINS - 1)):
        cell = (star << ROLL_BITS) | turned
        n = votes.n_reached
        if n < _REMEMBERED and count_of(votes, cell) == threshold:
            votes.reached[n] = cell
            votes.n_reached = n + 1


@compiled
def count_of(votes: Any, cell: int) -> int:
    """Return the votes of a cell."""
    star, at = cell >> ROLL_BITS, np.uint64(cell & (ROLL_BINS - 1))
    count = np.int64(0)
    for digit in range(_LOW_WORDS):
        count += np.int64((votes.low[star, digit] >> at) & _ONE) << digit
    for digit in range(_HIGH_WORDS):
        count += np.int64((votes.high[star, digit] >> at) & _ONE) << (digit + _LOW_WORDS)
    return count


@compiled
def clear(votes: Any) -> None:
    """Take back all votes: of a few, which is nearly always, star by star."""
    low, high = votes.low, votes.high
    if votes.n_touched > _REMEMBERED:
        low[:] = _NONE
    else:
        touched = votes.touched
        for i in range(votes.n_touched):
            low[touched[i], 0] = low[touched[i], 1] = _NONE
    if votes.n_carried > _REMEMBERED:
        high[:] = _NONE
    else:
        carried = votes.carried
        for i in range(votes.n_carried):
            for digit in range(_HIGH_WORDS):
                high[carried[i], digit] = _NONE
    votes.n_touched = votes.n_carried = votes.n_reached = 0


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
