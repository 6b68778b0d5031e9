"""The primary search, compiled: candidates in order, each judged, until one is certain."""

from typing import Any, NamedTuple

import numpy as np

from star_tracker.attitude.pose import copy_pose
from star_tracker.attitude.wahba import solve_wahba
from star_tracker.compiled import compiled, inlined
from star_tracker.identification.cells import best_cells, members, triangle_check
from star_tracker.identification.crowd import crowding
from star_tracker.identification.ended import Ended
from star_tracker.identification.judge import judge
from star_tracker.identification.plan import FULL_OF_FALSE
from star_tracker.identification.progress import late
from star_tracker.identification.shapes import (
    cast_by_shape,
    choose_runs,
    keep_agreeing,
    members_at_any_scale,
    prefetch_fan,
    spread,
)
from star_tracker.identification.votes import (
    ROLL_BITS,
    cast,
    choose_rows,
    clear,
    look_around,
    threshold_for,
)
from star_tracker.optics.frame import see_at_scale

#: Two poses are the same where their axes differ by less than this, rad.
SAME_POSE_RAD = 0.02
#: A pose with evidence between these is judged again with this tolerance. Beyond the second it
#: has most of its stars, and is certain where not many centroids are its.
_PROMISING, _BEYOND_DOUBT, LOOK_FARTHER_PX = -1.0, 16.0, 6.0
#: Cells judged for each main star, and for all of them together.
_FEWEST_CELLS, _CELLS_OF_A_LEVEL = 6, 480
#: Decades of evidence a centroid without which the search does not end at once.
_NEEDED_A_STAR = 0.7
#: More centroids than so many times the guide stars in view are false, and owe no evidence.
_MOST_OWING = 3
#: The part of its centroids or of its guide stars that a pose shows which ends the search at once.
_MOST = 2 / 3
#: Matches that fix a pose wherever they are.
_MANY_MATCHED = 15
#: The work of judging a cell, in votes; by shape, of a run of rows, of a look at a cell's members
#: and of judging them.
_WORK_OF_A_CELL = 1000.0
_WORK_OF_A_RUN, _WORK_OF_A_LOOK, _WORK_OF_JUDGING = 10.0, 200.0, 2000.0


class Limits(NamedTuple):
    """When a search ends.

    Attributes:
        certain: log10 evidence that is certain.
        enough: log10 evidence that is enough, against chance and against any other pose.
        second_look: how many more candidates have to be worse than one that is enough.
        work: in votes, after which a search makes way; its deadline may come sooner.
        displaced_gate_px: farthest a displaced star may lie from its place; 0 labels none.
        both_parities: whether either parity may be the true one, so that a figure that is its own
            mirror image tells nothing.
    """

    certain: float
    enough: float
    second_look: float
    work: float
    displaced_gate_px: float
    both_parities: bool = False


@compiled
def search(engine: Any) -> int:
    """Go on searching until something is certain, nothing is left or the budget is spent."""
    levels, frame, limits, progress = (
        engine.levels, engine.frame, engine.limits, engine.progress[0]
    )
    spent = 0.0
    while progress.level < len(levels):
        at = progress.level
        level = levels[at]
        n_mains = min(frame.n, level.mains)
        if not level.least_n <= frame.n <= level.most_n or progress.next_main >= n_mains:
            progress.level, progress.next_main = at + 1, 0
            if level.pause and progress.level < len(levels):
                return Ended.MORE
            continue
        if spent >= limits.work:
            return Ended.MORE
        main = frame.mains[progress.next_main]
        progress.next_main += 1
        see_at_scale(frame, engine.sky.focal_px, 1.0)
        if level.by_shape:
            spent += _try_main_by_shape(engine, main, level)
        else:
            spent += _try_main(engine, main, level)
        clear(engine.votes)
        if certain(progress, limits, frame.n):
            return Ended.CERTAIN
        if late(progress):  # in the middle of it, perhaps
            progress.next_main -= 1
            return Ended.MORE
    return Ended.EXHAUSTED


@compiled
def certain(progress: Any, limits: Limits, n: int) -> bool:
    """Return whether the best pose is certain, or enough and better than the next many."""
    # A true pose of many stars has much evidence: one with little may rest on a part of them only,
    # a cluster in a corner above all, and be off. Such a one has to outlast the whole search. One
    # that has much may be such a cluster too, where it leaves out many of the centroids and of the
    # guide stars in its view: eleven Pleiades and a chance neighbour had 21 decades, and a roll
    # that was 1.5 deg off.
    score, n_matched, n_in_view = progress.score, progress.n_matched, progress.n_in_view
    n_owing = min(n, _MOST_OWING * n_in_view)
    needed = max(limits.certain, _NEEDED_A_STAR * n_owing)
    if 2 * n_matched < n:
        needed = max(needed, _BEYOND_DOUBT)
    if score > needed and n_matched >= min(_MANY_MATCHED, _MOST * min(n, n_in_view)):
        return True
    # Where four of five centroids are false less is enough for a pose that shows most of the guide
    # stars in its view, and many.
    matched = max(0.5 * n_in_view, _MANY_MATCHED)
    if n >= FULL_OF_FALSE * n_in_view and score > 2 * _BEYOND_DOUBT and n_matched >= matched:
        return True
    enough = max(limits.enough, 0.5 * _NEEDED_A_STAR * n_owing)
    return score > enough and progress.n_since_best > limits.second_look


@compiled
def _try_main(engine: Any, main: int, level: Any) -> float:
    """Judge the candidates of one main star, best first, until one is certain; return the work."""
    pairs, votes, room = engine.pairs, engine.votes, engine.room
    room.pose.scale, room.pose.free = 1.0, False
    frame, progress = engine.frame, engine.progress[0]
    tolerance = level.tolerance_px / engine.sky.focal_px
    n_near = look_around(frame, main, level.companions, votes)
    # The more main stars there are, the fewer chances each of them needs.
    most = min(level.cells, max(_FEWEST_CELLS, _CELLS_OF_A_LEVEL // frame.n))
    cells, scores = room.cells[:most], room.scores[:most]
    end, total = choose_rows(pairs, votes, n_near, tolerance)
    progress.n_hypotheses += total
    cast(pairs, votes, end, threshold_for(total, len(votes.low)), progress)
    work = float(total)
    for i in range(best_cells(votes, 0, votes.n_reached, cells, scores)):
        if late(progress):
            break
        work += _WORK_OF_A_CELL
        _try_cell(engine, end, main, cells[i], level.tolerance_px)
        if certain(progress, engine.limits, frame.n):
            break
    return work


@compiled
def _try_cell(
    engine: Any, n_companions: int, main: int, cell: int, tolerance_px: float
) -> None:
    """Make a candidate of a cell's members that pass the triangle check, and judge it."""
    sky, frame, room = engine.sky, engine.frame, engine.room
    tolerance = tolerance_px / sky.focal_px
    k = members(engine.pairs, engine.votes, n_companions, cell, tolerance, room)
    k = triangle_check(frame, sky.guides, room, k, tolerance)
    if k < 2:
        return
    room.observed[k], room.catalog[k] = main, cell >> ROLL_BITS
    if solve_wahba(
        frame.vectors, room.observed, sky.guides.vectors, room.catalog, k + 1, room.pose.rotation
    ):
        _judge_candidate(engine, tolerance_px)


@compiled
def _try_main_by_shape(engine: Any, main: int, level: Any) -> float:
    """Judge the candidates of one main star by shape, batch by batch; return the work."""
    frame, votes, room, progress = engine.frame, engine.votes, engine.room, engine.progress[0]
    tolerance = level.tolerance_px / engine.sky.focal_px
    n_fan = spread(frame, main, level.companions, engine.fan, level.in_order)
    cells, scores = room.cells[: level.cells], room.scores[: level.cells]
    work, total, n_judged, done = 0.0, 0, 0, 0
    while done < n_fan:
        end = min(done + level.batch, n_fan)
        more = choose_runs(engine, done, end, tolerance)
        total += more
        progress.n_hypotheses += more
        work += more + engine.fan.n_runs * _WORK_OF_A_RUN
        cast_by_shape(engine, max(level.votes, threshold_for(total, len(votes.low))))
        n_cells = best_cells(votes, n_judged, votes.n_reached, cells, scores)
        n_judged = votes.n_reached
        if n_cells > 0:
            prefetch_fan(engine, cells[0] >> ROLL_BITS)
        for i in range(n_cells):
            if late(progress):
                return work
            if i + 1 < n_cells:
                prefetch_fan(engine, cells[i + 1] >> ROLL_BITS)
            work += _try_cell_by_shape(engine, main, cells[i], n_fan, level)
            if certain(progress, engine.limits, frame.n):
                return work
        done = end
    return work


@compiled
def _try_cell_by_shape(engine: Any, main: int, cell: int, n_fan: int, level: Any) -> float:
    """Make a candidate of a cell's members that agree in scale, and judge it; return the work."""
    sky, frame, room, star = engine.sky, engine.frame, engine.room, cell >> ROLL_BITS
    k = members_at_any_scale(engine, n_fan, cell, level.tolerance_px / sky.focal_px)
    k, log_scale, slack, worth = keep_agreeing(engine, k, n_fan, star)
    prior, pose = sky.scale_prior, room.pose
    if k < 2 or worth < level.worth:
        return _WORK_OF_A_LOOK
    if log_scale < prior.low - slack or log_scale > prior.high + slack:
        return _WORK_OF_A_LOOK
    room.observed[k], room.catalog[k] = main, star
    log_scale = min(max(log_scale, prior.low), prior.high)
    pose.scale, pose.free = np.exp(log_scale), prior.log_range > 0.0
    see_at_scale(frame, sky.focal_px, pose.scale)
    if not solve_wahba(
        frame.vectors, room.observed, sky.guides.vectors, room.catalog, k + 1, pose.rotation
    ):
        return _WORK_OF_A_LOOK
    _judge_candidate(engine, level.tolerance_px)
    return _WORK_OF_JUDGING


@compiled
def _judge_candidate(engine: Any, tolerance_px: float) -> None:
    """Judge the pose in the room, and again with a wider tolerance where that may find more."""
    score = judge_and_keep(engine, engine.room.pose, tolerance_px)
    engine.progress[0].n_judged += 1
    # Noise larger than the tolerance leaves part of the true stars out: look farther.
    is_doubtful = doubtful(score, engine.frame.n)
    if score > _PROMISING and is_doubtful and tolerance_px < LOOK_FARTHER_PX:
        judge_and_keep(engine, engine.room.pose, LOOK_FARTHER_PX)


@inlined
def doubtful(score: float, n: int) -> bool:
    """Return whether a pose has so little evidence that it may rest on a part of n centroids."""
    return score < max(_BEYOND_DOUBT, _NEEDED_A_STAR * n)


@compiled
def judged(engine: Any, sky: Any, pose: Any, tolerance_px: float) -> float:
    """Improve a pose; return its evidence less what a crowd of centroids has in it."""
    matches = engine.matches
    score = judge(sky, engine.frame, tolerance_px, pose, matches)
    if score > 0.0:
        area_px2 = sky.optics[0] * sky.optics[1]
        score -= crowding(engine.crowd, engine.frame, area_px2, matches.observed, matches.n_best)
    return score


@compiled
def judge_and_keep(engine: Any, pose: Any, tolerance_px: float) -> float:
    """Judge a pose, keep it if it is the best, or the best of the others; return its score."""
    matches, progress, best = engine.matches, engine.progress[0], engine.best
    score = judged(engine, engine.sky, pose, tolerance_px)
    progress.n_since_best += 1
    # Trace of best^T rotation: 1 + 2 cos(angle between the two poses).
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += best.rotation[i, j] * pose.rotation[i, j]
    same = trace > 1 + 2 * np.cos(SAME_POSE_RAD)
    if score > progress.score:
        if not same:
            progress.rival_score = progress.score
        progress.score, progress.tolerance_px = score, tolerance_px
        copy_pose(pose, best)
        progress.n_since_best, progress.n_matched = 0, matches.n_best
        progress.n_in_view = matches.n_in_view
    elif not same and score > progress.rival_score:
        progress.rival_score = score
    return score
