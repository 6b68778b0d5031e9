"""Matcher 1: match-group voting with direction (paper, 5.2; van Bezooijen 1994).

For a main star each observed pair (main, companion) selects the guide-star pairs of the same
separation within a tolerance (5-5). In the paper each of them raises a state flag on its stars
and the highest flag wins. Here a pair votes for a guide star *and* a roll, the difference of the
companion's position angles in the catalogue and in the image, so that votes by chance are spread
over 128 times as many cells and one main star is usually enough. A triangle check (5-6) then keeps
the members of a winning cell that also agree with each other. `voting="plain"` keeps the paper's
state flags for comparison.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from star_tracker.database import FeatureDatabase
from star_tracker.field import Candidate, StarField, Step
from star_tracker.pairs import AZIMUTH_UNITS, azimuth_units
from star_tracker.spherical import Floats, separation

#: 128 roll bins of 2.8 deg; a cell is two adjacent bins, so that no roll falls between bins.
_ROLL_BINS = AZIMUTH_UNITS // 2


@dataclass(frozen=True)
class MatchGroupSettings:
    """How far the search goes.

    Attributes:
        pair_tolerance_px: tolerances of a pair's separation, tried in turn.
        companions: how many of the nearest stars vote for a main star.
        cells: how many of the highest cells of a main star become candidates.
        voting: `directed`, or `plain` for the paper's state flags.
    """

    pair_tolerance_px: tuple[float, ...] = (2.0, 6.0, 12.0)
    companions: int = 20
    cells: int = 3
    voting: str = "directed"

    def __post_init__(self) -> None:
        tolerances = self.pair_tolerance_px
        if not tolerances or not all(0.01 <= t <= 100 for t in tolerances):
            raise ValueError("pair_tolerance_px needs one or more values from 0.01 to 100")
        if self.companions < 1 or self.cells < 1:
            raise ValueError("companions and cells must be at least 1")
        if self.voting not in _VOTING:
            raise ValueError(f"voting {self.voting!r} is unknown: use {' or '.join(_VOTING)}")


@dataclass(frozen=True)
class _Votes:
    """The votes for one main star: `cell[i]` was voted for by the guide-star pair `pair[i]`.

    The votes of `companion[j]` begin at `start[j]`.
    """

    main: int
    companion: NDArray[np.intp]
    start: NDArray[np.intp]
    cell: NDArray[np.int32]
    pair: NDArray[np.intp]

    def cast_by(self, vote: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the observed companions that cast some votes."""
        return self.companion[np.searchsorted(self.start, vote, "right") - 1]


def candidates(
    database: FeatureDatabase, field: StarField, settings: MatchGroupSettings
) -> Iterator[Step]:
    """Yield the candidates of one main star after the other, the most promising first.

    There is also a step for each cell that fails the triangle check and after each main star.
    """
    n_compared = 0
    for tolerance_px in settings.pair_tolerance_px:
        tolerance_rad = tolerance_px / field.camera.focal_length_px
        for main in field.from_centre:
            votes = _vote(database, field, int(main), tolerance_rad, settings.companions)
            # Each vote is a hypothesis of its own: a pair matched with a pair fixes the pose.
            n_compared += len(votes.cell)
            for star, chosen in _VOTING[settings.voting](votes, settings.cells):
                yield n_compared, _candidate(
                    database, field, votes, (star, chosen), tolerance_px
                )
            yield n_compared, None


def _vote(
    database: FeatureDatabase, field: StarField, main: int, tolerance_rad: float, count: int
) -> _Votes:
    """Let each companion vote for the cells (guide star * 128 + roll bin) of its pairs."""
    companion, separations, angle = field.neighbours(main, count)
    first, last = database.pairs.ranges(separations - tolerance_rad, separations + tolerance_rad)
    counts = last - first
    start = np.cumsum(counts) - counts
    pair = np.arange(counts.sum()) + np.repeat(first - start, counts)
    coded = database.pairs.main_azimuth[pair]
    observed = np.repeat(azimuth_units(angle), counts)
    roll = (coded - observed) & (AZIMUTH_UNITS - 1)
    cell = ((coded & -AZIMUTH_UNITS) | roll) >> 1
    voting = counts > 0
    return _Votes(main, companion[voting], start[voting], cell, pair)


def _directed(votes: _Votes, count: int) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Yield the guide star and the votes of each of the highest cells, the highest first."""
    for cell in _highest_cells(votes.cell, count).tolist():
        following = int(_turned(np.array(cell, np.int32), 1))
        yield cell // _ROLL_BINS, np.flatnonzero((votes.cell == cell) | (votes.cell == following))


def _plain(votes: _Votes, count: int) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Yield the guide stars of the highest state flag and their votes (paper, 5.2.5).

    Each companion raises the flag of a guide star once, however many of its pairs agree.
    """
    star = votes.cell // _ROLL_BINS
    raised = np.unique(votes.cast_by(np.arange(len(star))) * np.int64(2**32) + star)
    flag = np.bincount(raised & (2**32 - 1))
    for highest in np.flatnonzero(flag == flag.max(initial=2))[:count].tolist():
        yield highest, np.flatnonzero(star == highest)


_VOTING = {"directed": _directed, "plain": _plain}


def _highest_cells(cell: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Return up to `count` cells with the most votes in themselves and the next roll bin.

    A cell with fewer than two votes cannot form a triangle and is left out. Of three or more votes
    in two bins one bin has two, so only such bins and those before them are looked at, unless they
    are too few: sorting or scoring all votes takes several times as long.
    """
    if len(cell) == 0:
        return cell
    votes = np.bincount(cell, minlength=int(cell.max()) + _ROLL_BINS)
    heavy = cell[votes.take(cell) >= 2]
    pool = _distinct(np.concatenate([heavy, _turned(heavy, -1)]))
    if len(pool) < count:
        pool = _distinct(cell)
    score = votes[pool] + votes[_turned(pool, 1)]
    best = np.argsort(-score, kind="stable")[:count]
    return pool[best[score[best] >= 2]]


def _distinct(cell: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return cells in ascending order, each once: five times as fast as `numpy.unique`."""
    ordered = np.sort(cell)
    first = np.ones(len(ordered), np.bool_)
    first[1:] = ordered[1:] != ordered[:-1]
    return np.asarray(ordered[first])


def _turned(cell: NDArray[np.int32], bins: int) -> NDArray[np.int32]:
    """Return the cells of the same guide stars some roll bins farther, round the circle."""
    turned = (cell + np.int32(bins)) & (_ROLL_BINS - 1)
    return np.asarray((cell & -_ROLL_BINS) | turned)


def _candidate(
    database: FeatureDatabase,
    field: StarField,
    votes: _Votes,
    won: tuple[int, NDArray[np.intp]],
    tolerance_px: float,
) -> Candidate | None:
    """Return the main star and the companions that won and pass the triangle check, if any do."""
    star, chosen = won
    observed = votes.cast_by(chosen)
    catalog = database.pairs.companion[votes.pair[chosen]].astype(np.intp)
    agreeing = _triangle_check(
        field.vectors[observed], database.catalog.vectors[catalog],
        tolerance_px / field.camera.focal_length_px,
    )
    if len(agreeing) < 2:
        return None
    return Candidate(
        np.append(votes.main, observed[agreeing]), np.append(star, catalog[agreeing]), tolerance_px
    )


def _triangle_check(observed: Floats, catalog: Floats, tolerance_rad: float) -> NDArray[np.intp]:
    """Return the members (k, 3), (k, 3) whose mutual separations agree with the best member's.

    Two members close a triangle with the main star when their separation in the image and in the
    catalogue agree too (5-6). The member with the most partners is kept with those partners.
    A pair of equal stars has separation 0 on one side only and so never agrees, unless two
    members name the same star twice over, which the one-to-one association resolves later.
    """
    in_image = separation(observed[:, None], observed[None])
    in_catalog = separation(catalog[:, None], catalog[None])
    agrees = np.abs(in_image - in_catalog) <= tolerance_rad
    np.fill_diagonal(agrees, False)
    partners = agrees.sum(axis=1)
    hub = int(np.argmax(partners))
    if partners[hub] == 0:
        return np.empty(0, np.intp)
    return np.concatenate([[hub], np.flatnonzero(agrees[hub])])
