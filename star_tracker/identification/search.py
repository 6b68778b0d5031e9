"""The primary search, compiled: candidates in order, each judged, until one is certain."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.wahba import solve_wahba
from star_tracker.catalogue.pairs import PairTable
from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.cells import MEMBERS, best_cells, members, triangle_check
from star_tracker.identification.field import Frame
from star_tracker.identification.judge import Matches, Sky, copy_rotation, judge
from star_tracker.identification.votes import (
    ROLL_BITS,
    Votes,
    cast,
    choose_rows,
    clear,
    empty_votes,
    look_around,
    threshold_for,
)

#: Two poses are the same where their axes differ by less than this, rad.
_SAME_POSE_RAD = 0.02
MORE, EXHAUSTED, CERTAIN = 0, 1, 2
#: A pose with evidence between these is judged again with this tolerance. Beyond the second the
#: search ends in any case.
_PROMISING, _BEYOND_DOUBT, _LOOK_FARTHER_PX = -1.0, 16.0, 6.0
#: Cells judged for each main star, and for all of them together.
_FEWEST_CELLS, _CELLS_OF_A_LEVEL = 6, 480
#: Decades of evidence a centroid without which the search does not end at once.
_NEEDED_A_STAR = 0.7
#: The work of judging a cell, in votes.
_WORK_OF_A_CELL = 1000.0


class Progress(NamedTuple):
    """How far a search has come, and the best that it has found.

    Attributes:
        counts: (6,) int64: level, place of the next main star, hypotheses compared, candidates
            judged, candidates judged since the best was found, matches that carry the best.
        score: (3,) log10 evidence of the best pose and of the best other pose, and the best one's
            tolerance, px.
        rotation: (3, 3) the best pose.
    """

    counts: NDArray[np.int64]
    score: Floats
    rotation: Floats

    @classmethod
    def blank(cls) -> "Progress":
        """Return room for the progress of a search; see `begin`."""
        return cls(np.zeros(6, np.int64), np.zeros(3), np.eye(3))


class Room(NamedTuple):
    """Room for the highest cells (c,) with their votes, the members of one, and its pose."""

    cells: NDArray[np.int64]
    scores: NDArray[np.int64]
    observed: NDArray[np.int64]
    catalog: NDArray[np.int64]
    rotation: Floats


@compiled
def empty_room(n_cells: int) -> Room:
    """Return room for so many cells."""
    return Room(
        np.empty(n_cells, np.int64), np.empty(n_cells, np.int64),
        np.empty(MEMBERS + 1, np.int64), np.empty(MEMBERS + 1, np.int64), np.empty((3, 3)),
    )


@compiled
def begin(progress: Progress) -> None:
    """Forget what a search has found."""
    for i in range(len(progress.counts)):
        progress.counts[i] = 0
    progress.score[0] = progress.score[1] = -np.inf
    progress.score[2] = 0.0


@compiled
def search(
    sky: Sky,
    pairs: PairTable,
    frame: Frame,
    low: NDArray[np.uint64],
    high: NDArray[np.uint64],
    matches: Matches,
    levels: Floats,
    limits: Floats,
    plain: bool,
    progress: Progress,
) -> int:
    """Go on searching until something is certain, nothing is left or the budget is spent.

    Args:
        sky, pairs: the database.
        frame: the centroids.
        low, high: cells of votes, all 0; see `Votes`.
        matches: room for a hypothesis.
        levels: (levels, 4) tolerance px, companions, main stars, batch of companions; see
            `MatchGroupSettings.levels`.
        limits: (5,) log10 evidence that is certain; that is enough; how many more candidates have
            to be worse than one that is enough; cells a main star; budget in votes.
        plain: whether the paper's plain flags vote.
        progress: where to go on, updated.
    """
    spent, at = 0.0, progress.counts
    if len(levels) == 0:
        return EXHAUSTED
    votes = empty_votes(low, high, int(np.max(levels[:, 1])))
    room = empty_room(int(limits[3]))
    while at[0] < len(levels):
        level = at[0]
        if at[1] >= min(len(frame.vectors), levels[level, 2]):
            at[0], at[1] = level + 1, 0
            continue
        if spent >= limits[4]:
            return MORE
        main = frame.mains[at[1]]
        at[1] += 1
        if level > 0 and _tried(levels[level - 1], levels[level], at[1], len(frame.vectors)):
            continue
        spent += _try_main(
            sky, pairs, frame, votes, main, levels[level], limits, plain, room, matches, progress
        )
        clear(votes)
        if certain(progress, limits, len(frame.vectors)):
            return CERTAIN
    return EXHAUSTED


@inlined
def _tried(before: Floats, now: Floats, place: int, n: int) -> bool:
    """Return whether all companions of a main star have voted at the level before already."""
    return (before[0] == now[0]) & (place <= before[2]) & (n - 1 <= before[1])


@compiled
def certain(progress: Progress, limits: Floats, n: int) -> bool:
    """Return whether the best pose is certain, or enough and better than the next many."""
    # A true pose of many stars has much evidence: one with little may rest on a part of them only,
    # a cluster in a corner above all, and be off. Such a one has to outlast the whole search.
    score, matched = progress.score[0], progress.counts[5]
    needed = max(limits[0], _NEEDED_A_STAR * n)
    if score > max(_BEYOND_DOUBT, needed) or (score > needed and 2 * matched >= n):
        return True
    enough = max(limits[1], 0.5 * _NEEDED_A_STAR * n)
    return score > enough and progress.counts[4] > limits[2]


@compiled
def _try_main(
    sky: Sky,
    pairs: PairTable,
    frame: Frame,
    votes: Votes,
    main: int,
    level: Floats,
    limits: Floats,
    plain: bool,
    room: Room,
    matches: Matches,
    progress: Progress,
) -> float:
    """Judge the candidates of one main star, best first, until one is certain; return the work."""
    tolerance = level[0] / np.sqrt(sky.optics[2] * sky.optics[3])
    n_near = look_around(frame, main, int(level[1]), votes)
    batch, quick = int(level[3]), level[3] < level[1]
    # The more main stars there are, the fewer chances each of them needs.
    most = min(len(room.cells), max(_FEWEST_CELLS, _CELLS_OF_A_LEVEL // len(frame.vectors)))
    work, n_judged, n_reached = 0.0, 0, 0
    for begin in range(0, n_near, batch):
        end, total = choose_rows(pairs, votes, begin, min(begin + batch, n_near), tolerance)
        progress.counts[2] += total
        work += total
        # By chance hardly any cell gets all three votes of a batch of three.
        threshold = batch if quick else threshold_for(total, len(votes.low))
        n_reached = cast(pairs, votes, begin, end, threshold, plain, n_reached)
        n_cells = best_cells(
            votes, n_judged, n_reached, room.cells[:most], room.scores[:most]
        )
        n_judged = n_reached
        for i in range(n_cells):
            work += _WORK_OF_A_CELL
            _try_cell(
                sky, pairs, frame, votes, end, main, room.cells[i], level[0], limits, plain,
                room, matches, progress,
            )
            if certain(progress, limits, len(frame.vectors)):
                return work
    return work


@compiled
def _try_cell(
    sky: Sky,
    pairs: PairTable,
    frame: Frame,
    votes: Votes,
    n_companions: int,
    main: int,
    cell: int,
    tolerance_px: float,
    limits: Floats,
    plain: bool,
    room: Room,
    matches: Matches,
    progress: Progress,
) -> None:
    """Make a candidate of a cell's members that pass the triangle check, and judge it."""
    vectors = sky.guides.vectors
    tolerance = tolerance_px / np.sqrt(sky.optics[2] * sky.optics[3])
    k = members(
        pairs, votes, n_companions, cell, tolerance, plain, room.observed, room.catalog
    )
    k = triangle_check(frame, vectors, room.observed, room.catalog, k, tolerance)
    if k < 2:
        return
    room.observed[k], room.catalog[k] = main, cell >> ROLL_BITS
    if solve_wahba(frame.vectors, room.observed, vectors, room.catalog, k + 1, room.rotation):
        score = judge(sky, frame, tolerance_px, room.rotation, matches)
        progress.counts[3] += 1
        keep(progress, score, matches.settled[0], tolerance_px, room.rotation)
        # Noise larger than the tolerance leaves part of the true stars out: look farther.
        doubtful = score < max(_BEYOND_DOUBT, _NEEDED_A_STAR * len(frame.vectors))
        if score > _PROMISING and doubtful and tolerance_px < _LOOK_FARTHER_PX:
            score = judge(sky, frame, _LOOK_FARTHER_PX, room.rotation, matches)
            keep(progress, score, matches.settled[0], _LOOK_FARTHER_PX, room.rotation)


@compiled
def keep(
    progress: Progress, score: float, matched: int, tolerance_px: float, rotation: Floats
) -> None:
    """Keep a judged pose if it is the best, or the best of the others."""
    progress.counts[4] += 1
    best = progress.rotation
    # Trace of best^T rotation: 1 + 2 cos(angle between the two poses).
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += best[i, j] * rotation[i, j]
    same = trace > 1 + 2 * np.cos(_SAME_POSE_RAD)
    if score > progress.score[0]:
        if not same:
            progress.score[1] = progress.score[0]
        progress.score[0], progress.score[2] = score, tolerance_px
        copy_rotation(rotation, progress.rotation)
        progress.counts[4], progress.counts[5] = 0, matched
    elif not same and score > progress.score[1]:
        progress.score[1] = score
