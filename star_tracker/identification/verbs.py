"""What an engine does with a frame: the compiled way, in a few verbs.

`begin` takes the centroids in, `go_on` searches, `judge_match` and `judge_pose` try what others
propose, and `label` names the stars and fits the attitude. `follow` and `track` are these in a
row, one call from Python for nearly every frame.

Python calls `act` alone. All machine code is behind that one door, so that it is compiled once and
not with each verb again, and a process that has called it has nothing left to load or to compile
while a frame waits.
"""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.joint_fit import write_covariance
from star_tracker.attitude.wahba import solve_wahba
from star_tracker.compiled import compiled
from star_tracker.geometry.rotation import (
    boresight_of,
    copy_rotation,
    is_rotation,
    write_quaternion,
)
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.contradiction import agreement, fit_focal_length, judge_scaled
from star_tracker.identification.ended import MIN_STARS, Ended
from star_tracker.identification.evidence import variance
from star_tracker.identification.judge import GATE_TOLERANCES
from star_tracker.identification.labels import blank, identify, write_labels
from star_tracker.identification.progress import forget, wrong_probability
from star_tracker.identification.search import certain, judge_and_keep, search
from star_tracker.identification.symmetry import fits_in_mirror
from star_tracker.optics.frame import fill_frame, see_at_scale

#: A predicted pose may be off by this many pixels, as the tolerance of a candidate.
_TRACKING_PX = 12.0
#: A star's mirror image is looked for within so many root mean square residuals: its noise, its
#: partner's and that of the two stars that fix the mirror add up.
_MIRROR_GATE = 5.0
#: The part of the matches that carried the evidence of a pose which has to be identified with it.
#: Where the camera is as told 0.88 and more of them are; where it is not, a third of the image may
#: draw the pose away from the rest of it, and then it is not the pose that had the evidence.
_LEAST_LEFT = 0.5


class Verb(IntEnum):
    """What an engine is to do; see the functions of these names."""

    FOLLOW = 0
    BEGIN = 1
    GO_ON = 2
    TRACK = 3
    JUDGE_MATCH = 4
    LABEL_BEST = 5


@compiled
def act(
    engine: Any, verb: int, given: tuple[Floats, Floats], labels: NDArray[np.void]
) -> int:
    """Do what a `Verb` says with a frame; return how that ended.

    Args:
        engine: made for the camera.
        verb: its value.
        given: centroids (m, 2) and intensities (m,) or (0,); those that begin a frame read them.
        labels: (m,) of `labels.LABEL`; those that solve it write them.
    """
    if verb == Verb.FOLLOW:
        return follow(engine, given[0], given[1], labels)
    if verb == Verb.BEGIN:
        return begin(engine, given[0], given[1])
    if verb == Verb.GO_ON:
        return go_on(engine, labels)
    if verb == Verb.TRACK:
        return track(engine, given[0], given[1], labels)
    if verb == Verb.JUDGE_MATCH:
        return judge_match(engine)
    return label_best(engine, labels)


@compiled
def begin(engine: Any, xy_px: Floats, intensity: Floats) -> int:
    """Take in centroids (m, 2) and intensities (m,) or (0,); MORE or TOO_FEW."""
    frame = engine.frame
    fill_frame(frame, engine.sky.optics, xy_px, intensity)
    engine.outcome[0].n_usable = frame.n
    forget(engine.progress[0])
    engine.crowd.known = False
    return Ended.TOO_FEW if frame.n < MIN_STARS else Ended.MORE


@compiled
def go_on(engine: Any, labels: NDArray[np.void]) -> int:
    """Search on, within the budget of work; label the frame where that makes a pose certain.

    Returns MORE, EXHAUSTED, CERTAIN (of a pose that has to face its rivals yet: it is no more than
    enough, or fits in a mirror as well), SOLVED or CONTRADICTED.
    """
    engine.matches.n_settled = 0  # engines share the matches: another one may have judged since
    return _labelled(engine, labels, search(engine))


@compiled
def judge_match(engine: Any) -> int:
    """Judge the pose of the proposed matches of centroids and guide stars; CERTAIN or MORE.

    Matches that lie on one line of sight are no hypothesis and are passed over. A figure that
    tells no parity is not certain where that is asked for.
    """
    pose, vectors, progress = engine.room.pose, engine.frame.vectors, engine.progress[0]
    observed, catalog, k = engine.proposed[0], engine.proposed[1], progress.n_proposed
    see_at_scale(engine.frame, engine.sky.focal_px, 1.0)
    pose.scale, pose.free = 1.0, False
    sky_vectors = engine.sky.guides.vectors
    if not solve_wahba(vectors, observed, sky_vectors, catalog, k, pose.rotation):
        return Ended.MORE
    score = judge_and_keep(engine, pose, progress.proposed_tolerance_px)
    if score <= engine.limits.certain or _tells_no_parity(engine, engine.matches.n_best, 0.0):
        return Ended.MORE
    return Ended.CERTAIN


@compiled
def judge_pose(engine: Any) -> int:
    """Judge the predicted pose, whose rotation stands in `best`; CERTAIN, MORE or NO_ROTATION.

    The focal length is fitted from the predicted one on where it is not told as exact.
    """
    progress, pose, prior = engine.progress[0], engine.room.pose, engine.sky.scale_prior
    if not is_rotation(engine.best.rotation):
        return Ended.NO_ROTATION
    copy_rotation(engine.best.rotation, pose.rotation)
    pose.free = prior.log_range > 0.0
    low, high = np.exp(prior.low), np.exp(prior.high)
    pose.scale = min(max(progress.predicted_scale, low), high) if pose.free else 1.0
    judge_and_keep(engine, pose, _TRACKING_PX)
    found = certain(progress, engine.limits, engine.frame.n)
    return Ended.CERTAIN if found else Ended.MORE


@compiled
def label(engine: Any, labels: NDArray[np.void]) -> int:
    """Write a row of `labels` for each centroid, and the attitude of the best pose.

    Where too few stars are left to the pose it writes none. Returns SOLVED, CERTAIN where
    the stars' mirror image fits as well and may be the true one, FAR or CONTRADICTED.
    """
    rotation, outcome, frame = engine.best.rotation, engine.outcome[0], engine.frame
    k, sum2 = identify(engine, engine.sky)
    least = _LEAST_LEFT * engine.progress[0].n_matched
    if k >= least and not engine.best.free and fit_focal_length(engine, k, sum2):
        k = 0  # the stars were matched with another one
        if judge_scaled(engine):
            k, sum2 = identify(engine, engine.doubt)
    outcome.scale = engine.best.scale
    if k < least:
        return Ended.CONTRADICTED
    write_labels(engine, k, labels)
    outcome.rms_px = np.sqrt(sum2 / k)
    write_quaternion(rotation, engine.quaternion)
    outcome.ra_rad, outcome.dec_rad, outcome.roll_rad = boresight_of(rotation)
    outcome.variance_px2 = variance(engine.sky.evidence, sum2, k, engine.best.free)
    focal_px, known = engine.sky.focal_px * engine.best.scale, engine.sky.scale_prior.sigma
    of_direction, of_scale = outcome.variance_px2 / (focal_px * focal_px), np.inf
    if engine.best.free:
        of_scale = of_direction / (known * known) if known > 0.0 else 0.0
    outcome.scale_variance = write_covariance(
        frame.vectors, engine.matches.observed, k, (of_direction, of_scale), engine.covariance
    )
    progress = engine.progress[0]
    outcome.wrong_probability, outcome.score = wrong_probability(progress), progress.score
    outcome.n_hypotheses = progress.n_hypotheses
    agreed = agreement(engine, outcome.rms_px)
    if agreed != Ended.CONTRADICTED and _tells_no_parity(engine, k, outcome.rms_px):
        return Ended.CERTAIN if agreed == Ended.SOLVED else Ended.CONTRADICTED  # two doubts
    return agreed


@compiled
def _tells_no_parity(engine: Any, k: int, rms_px: float) -> bool:
    """Return whether the first `k` matches fit in a mirror too, and the parity is asked for."""
    if not engine.limits.both_parities:
        return False
    gate_px = max(GATE_TOLERANCES * engine.progress[0].tolerance_px, _MIRROR_GATE * rms_px)
    focal_px = engine.sky.focal_px * engine.best.scale
    return fits_in_mirror(engine.frame, engine.matches, k, gate_px, focal_px)


@compiled
def label_best(engine: Any, labels: NDArray[np.void]) -> int:
    """Label a frame whose best pose need not be the one judged last; see `label`."""
    engine.matches.n_settled = 0
    return label(engine, labels)


@compiled
def follow(engine: Any, xy_px: Floats, intensity: Floats, labels: NDArray[np.void]) -> int:
    """Begin a frame and go on with it; return how that ended."""
    blank(labels)
    ended = begin(engine, xy_px, intensity)
    return go_on(engine, labels) if ended == Ended.MORE else ended


@compiled
def track(engine: Any, xy_px: Floats, intensity: Floats, labels: NDArray[np.void]) -> int:
    """Begin a frame, judge the pose that stands in `best` and label it where that is certain."""
    blank(labels)
    ended = begin(engine, xy_px, intensity)
    if ended == Ended.MORE:
        ended = judge_pose(engine)
    elif not is_rotation(engine.best.rotation):
        ended = Ended.NO_ROTATION
    return _labelled(engine, labels, ended)


@compiled
def _labelled(engine: Any, labels: NDArray[np.void], ended: int) -> int:
    """Label a frame whose search has ended with a pose that needs no second look."""
    progress = engine.progress[0]
    if ended not in (Ended.EXHAUSTED, Ended.CERTAIN):
        return ended
    limits = engine.limits
    if progress.score <= max(limits.certain, progress.rival_score + limits.enough):
        return ended
    if progress.n_since_best > 0:  # the pose judged last is not the best one
        engine.matches.n_settled = 0
    ended = label(engine, labels)
    if ended != Ended.SOLVED:
        blank(labels)
    return ended
