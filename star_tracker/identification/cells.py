"""Matcher 1: match-group voting with direction (paper, 5.2; van Bezooijen 1994).

For a main star each observed pair (main, companion) selects the guide-star pairs of the same
separation within a tolerance (5-5). In the paper each of them raises a state flag on its stars
and the highest flag wins. Here a pair votes for a guide star *and* a roll, the difference of the
companion's position angles in the catalogue and in the image, so that votes by chance are spread
over 64 times as many cells and one main star is usually enough (`votes.py`). A triangle check
(5-6) then keeps the members of a winning cell that also agree with each other. The paper's own
flags are kept in `study/` for comparison.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.pose import identity_pose
from star_tracker.catalogue.pairs import AZIMUTH_UNITS, first_near
from star_tracker.compiled import compiled, struct
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.votes import ROLL_BINS, ROLL_BITS, ROLL_SHIFT, count_of

#: Most members of a cell that are looked at.
MEMBERS = 64
MOST_COMPANIONS = 40
#: Allowed tolerances of a pair's separation, both ends included.
PAIR_TOLERANCE_RANGE_PX = (0.01, 100.0)


@dataclass(frozen=True)
class MatchGroupSettings:
    """How far the search goes.

    Attributes:
        pair_tolerance_px: tolerances of a pair's separation, tried in turn.
        companions: how many of the nearest stars vote for a main star.
        cells: how many of the highest cells of a main star become candidates, at the most.
        quick: whether a quick search by shape, enough for most frames, comes first (`plan.py`).
    """

    pair_tolerance_px: tuple[float, ...] = (2.0, 6.0, 12.0)
    companions: int = 20
    cells: int = 48
    quick: bool = True

    def __post_init__(self) -> None:
        tolerances, (low, high) = self.pair_tolerance_px, PAIR_TOLERANCE_RANGE_PX
        if not tolerances or not all(low <= t <= high for t in tolerances):
            raise ValueError(
                f"pair_tolerance_px needs one or more values from {low:g} to {high:g}"
            )
        if not 1 <= self.companions <= MOST_COMPANIONS or self.cells < 1:
            raise ValueError(
                f"companions must be from 1 to {MOST_COMPANIONS} and cells at least 1"
            )


#: Room for the highest cells (c,) with their votes, for the members of one, `observed` and
#: `catalog`, and for the pose that they make.
RoomType, Room = struct("Room", __name__, ("cells", "scores", "observed", "catalog", "pose"))


@compiled
def empty_room(n_cells: int) -> Any:
    """Return room for so many cells."""
    return Room(
        np.empty(n_cells, np.int64), np.empty(n_cells, np.int64),
        np.empty(MEMBERS + 1, np.int64), np.empty(MEMBERS + 1, np.int64), identity_pose(),
    )


@compiled
def best_cells(
    votes: Any, begin: int, end: int, cells: NDArray[np.int64], scores: NDArray[np.int64]
) -> int:
    """Write the highest of the cells begin to end of `reached`; return how many were written.

    The highest comes first; `cells` and `scores` have room for as many as are wanted.

    A vote counts in two cells: of adjacent ones only the higher is taken.
    """
    n, most = 0, len(cells)
    for i in range(begin, end):
        cell = votes.reached[i]
        score, star, roll = count_of(votes, cell), cell >> ROLL_BITS, cell & (ROLL_BINS - 1)
        beaten, j = False, 0
        while j < n and not beaten:
            apart = (roll - cells[j]) & (ROLL_BINS - 1)
            adjacent = apart == 1 or apart == ROLL_BINS - 1
            if cells[j] >> ROLL_BITS != star or not adjacent:
                j += 1
            elif score <= scores[j]:
                beaten = True
            else:  # the adjacent one goes
                n -= 1
                for m in range(j, n):
                    cells[m], scores[m] = cells[m + 1], scores[m + 1]
        at = n
        while at > 0 and scores[at - 1] < score:
            at -= 1
        if beaten or at == most:
            continue
        n = min(n + 1, most)
        for m in range(n - 1, at, -1):
            cells[m], scores[m] = cells[m - 1], scores[m - 1]
        cells[at], scores[at] = cell, score
    return n


@compiled
def members(
    pairs: Any, votes: Any, n_companions: int, cell: int, tolerance_rad: float, room: Any
) -> int:
    """Write the matches that voted for a cell to `room`, at most 64; return their number."""
    star, roll = cell >> ROLL_BITS, cell & (ROLL_BINS - 1)
    separation, azimuth, near_end = votes.separation, votes.azimuth, pairs.near_start[star + 1]
    near_separation, near_azimuth = pairs.near_separation_rad, pairs.near_azimuth
    n = 0
    for i in range(n_companions):
        row = first_near(pairs, star, separation[i] - tolerance_rad)
        farthest = np.float32(separation[i] + tolerance_rad)
        while row < near_end and near_separation[row] < farthest:
            turned = (near_azimuth[row] - azimuth[i]) & (AZIMUTH_UNITS - 1)
            before = (roll - (turned >> ROLL_SHIFT)) & (ROLL_BINS - 1)
            if before <= 1 and n < MEMBERS:
                room.observed[n], room.catalog[n] = votes.companion[i], pairs.near_companion[row]
                n += 1
            row += 1
    return n


@compiled
def triangle_check(frame: Any, guides: Any, room: Any, n: int, tolerance_rad: float) -> int:
    """Keep the members whose mutual separations agree with the best member's; return how many.

    Two members close a triangle with the main star when their separation in the image and in the
    catalogue agree too (5-6). The member with the most partners is kept with those partners; 0 is
    returned where no two agree. A star that is a member twice over does not agree with itself,
    as its separation is 0 on one side only.
    """
    observed, catalog = room.observed, room.catalog
    camera_vectors, sky_vectors = frame.vectors, guides.vectors
    hub, most = 0, 0
    for i in range(n):
        partners = 0
        for j in range(n):
            in_image = chord(camera_vectors, observed[i], observed[j])
            in_sky = chord(sky_vectors, catalog[i], catalog[j])
            partners += i != j and abs(in_image - in_sky) <= tolerance_rad
        if partners > most:
            hub, most = i, partners
    if most == 0:
        return 0
    k = 0
    hub_observed, hub_catalog = observed[hub], catalog[hub]
    for i in range(n):
        in_image = chord(camera_vectors, hub_observed, observed[i])
        agrees = abs(in_image - chord(sky_vectors, hub_catalog, catalog[i])) <= tolerance_rad
        if i == hub or agrees:
            observed[k], catalog[k] = observed[i], catalog[i]
            k += 1
    return k


@compiled
def chord(vectors: Floats, i: int, j: int) -> float:
    """Return the chord between two unit vectors: for stars of one field as good as the angle."""
    a, b = vectors[i], vectors[j]
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return np.sqrt(x * x + y * y + z * z)
