"""Do the stars contradict a focal length that was told as exact? Then it is fitted as well.

A camera that is taken at its word gives a wrong attitude, and a covariance that knows nothing of
it, where its focal length is wrong: the pose leans on those stars that fit by chance. The sum of
squared residuals tells: with the focal length free it falls by a factor that pure noise does not
reach (a likelihood ratio of e^10, which is 4.5 standard deviations where stars are many).

Where part of the stars are matched wrongly it does not tell: they fit by chance, and with another
focal length no better. So a pose whose stars lie far from their places has to have ten times the
evidence that is enough, and as much as what a search finds with the focal length free. And where
a focal length was fitted, the stars are matched anew with it: those that were matched before may
be a cluster in a corner, of which a wrong one draws the pose away from all others.
"""

from typing import Any

import numpy as np

from star_tracker.attitude.joint_fit import refine_scaled
from star_tracker.attitude.pose import copy_pose
from star_tracker.compiled import compiled
from star_tracker.identification.ended import Ended
from star_tracker.identification.labels import measure
from star_tracker.identification.search import doubtful, judged
from star_tracker.optics.frame import see_at_scale

#: The logarithm of the likelihood ratio that contradicts, and least deviation of the focal length
#: that is one, relative: no calibration is better for long.
_CONTRADICTS, LEAST_DEVIATION = 10.0, 1e-3
#: Steps of the fit, once it is wanted.
_STEPS = 4
#: Stars that lie farther than this from their places, root mean square, and than so many standard
#: deviations of the noise that is expected, are far: with any focal length wrong ones carry part
#: of the pose then. The eight maps had 7 to 26 px with a field of view that was 4 to 6 % off, and
#: 0.1 px with the right one.
_FAR_PX, _FAR_SIGMA = 3.0, 3.0
#: Stars that lie farther off than this beyond that noise belong to another camera whatever their
#: evidence: no search looks so far, and yet labels that are as noisy as their frame would go on
#: from there.
_FARTHEST_PX = 12.0
#: Decades beyond enough that a pose of far stars needs: where the true one is not to be found, as
#: the focal length is another, the widest gates let in the most poses by chance.
_FAR_LEAD = 1.0


@compiled
def fit_focal_length(engine: Any, k: int, sum2: float) -> bool:
    """Fit the focal length too, if the `k` identified stars contradict it; return whether they do.

    `sum2` is their sum of squared residuals, px^2, with the focal length as told. The best pose
    and its scale change where they do, and the frame is seen at that scale.
    """
    frame, matches, best, trial = engine.frame, engine.matches, engine.best, engine.matches.trial
    sky = engine.sky
    # The residuals as told stay in `matches.residual2`, which the labels are written from.
    copy_pose(best, trial)
    freed = sum2
    for step in range(_STEPS):
        refine_scaled(frame.vectors, matches.near_vectors, matches, k, trial, 0.0)
        freed = measure(sky, frame, trial, k, matches, matches.star_residual2)
        ratio = 0.5 * (2 * k - 3) * np.log(max(sum2, 1e-300) / max(freed, 1e-300))
        off = abs(np.log(trial.scale))
        if step == 0 and (ratio < 0.5 * _CONTRADICTS or off < LEAST_DEVIATION):
            return False  # nearly every frame
        see_at_scale(frame, sky.focal_px, trial.scale)
    if ratio < _CONTRADICTS or off < LEAST_DEVIATION:
        see_at_scale(frame, sky.focal_px, best.scale)
        return False
    copy_pose(trial, best)
    best.free = True
    return True


@compiled
def judge_scaled(engine: Any) -> bool:
    """Judge the best pose anew with the focal length that was fitted; return whether it holds.

    The pose becomes what its stars and that focal length make of it.
    """
    pose, best = engine.room.pose, engine.best
    copy_pose(best, pose)
    found = judged(engine, engine.doubt, pose, engine.progress[0].tolerance_px)
    copy_pose(pose, best)
    return found > engine.limits.enough


@compiled
def agreement(engine: Any, rms_px: float) -> int:
    """Return whether the stars lie near enough to their places for the camera to be as told.

    SOLVED, FAR or CONTRADICTED; `rms_px` is their root mean square residual.
    """
    known, score = engine.sky.evidence, engine.progress[0].score
    expected_px = np.sqrt(known.scale_px2 / known.freedom)
    if rms_px > _FARTHEST_PX + _FAR_SIGMA * expected_px:
        return Ended.CONTRADICTED
    if rms_px <= max(_FAR_PX, _FAR_SIGMA * expected_px):
        return Ended.SOLVED
    if engine.best.free:
        fitted_after_all = engine.sky.scale_prior.sigma == 0.0
        return Ended.CONTRADICTED if fitted_after_all else Ended.SOLVED
    if not doubtful(score, engine.frame.n):
        return Ended.SOLVED
    return Ended.FAR if score >= engine.limits.enough + _FAR_LEAD else Ended.CONTRADICTED
