"""The labels of an accepted frame: which star is which, which one is displaced."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.pose import copy_pose
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.evidence import strongest
from star_tracker.identification.judge import (
    GATE_TOLERANCES,
    associate,
    look_up,
    project,
    refine_pose,
)
from star_tracker.optics.frame import see_at_scale

_ROUNDS = 5
#: Widest gate; final gate in standard deviations (0.1 % of true stars lie beyond).
_GATE_PX = 10.0
_GATE_SIGMA = 3.7
_GATE_FLOOR_PX = 0.3
#: Residuals beyond so many standard deviations do not count for the noise; the standard deviation
#: of fewer residuals than this is not judged by their median.
_OUTLIER_SIGMA, _FEW = 4.5, 6
#: A displaced star's second nearest guide star must be this many times farther.
_DISPLACED_AMBIGUITY = 3.0
#: A displaced star is labelled where fewer chance pairs than this are expected so close.
_DISPLACED_CHANCE = 0.05


class StarState(IntEnum):
    """What became of a centroid."""

    UNIDENTIFIED = 0
    IDENTIFIED = 1
    DISPLACED = 2


@dataclass(frozen=True, eq=False)  # arrays have no one answer
class Identification:
    """One row for each centroid of the frame, in input order.

    Attributes:
        catalog_index: (n,) catalogue index, -1 = none.
        state: (n,) values of `StarState`.
        residual_px: (n,) distance from the guide star's predicted place, NaN = none.
    """

    catalog_index: NDArray[np.int64]
    state: NDArray[np.uint8]
    residual_px: Floats

    @classmethod
    def empty(cls, n: int) -> "Identification":
        """Return the identification of a frame in which nothing was identified."""
        return cls(
            np.full(n, -1, np.int64), np.zeros(n, np.uint8), np.full(n, np.nan)
        )

    @property
    def identified(self) -> NDArray[np.intp]:
        """Indices of the identified centroids, displaced ones not among them."""
        return np.flatnonzero(self.state == StarState.IDENTIFIED)


#: A row for each centroid of the input, as compiled code writes it; see `Identification`.
LABEL = np.dtype([
    ("catalog_index", np.int64), ("residual_px", np.float64), ("state", np.uint8),
], align=True)


def blank_labels(n: int) -> NDArray[np.void]:
    """Return `n` rows of `LABEL` in which nothing is identified."""
    labels = np.zeros(n, LABEL)  # UNIDENTIFIED is 0
    labels["catalog_index"], labels["residual_px"] = -1, np.nan
    return labels


@compiled
def blank(labels: NDArray[np.void]) -> None:
    """Identify nothing."""
    for i in range(len(labels)):
        row = labels[i]
        row.catalog_index, row.residual_px, row.state = -1, np.nan, StarState.UNIDENTIFIED


@compiled
def identify(engine: Any, sky: Any) -> tuple[int, float]:
    """Identify the stars of the best pose, which is one of `sky`, and fit it to them.

    The noise is estimated from the frame itself, from the matches that carry most evidence, so
    that a precise frame gets a narrow gate. Returns the number of identified stars, which are the
    first of the matches, and the sum of their squared residuals.
    """
    frame, matches, best = engine.frame, engine.matches, engine.best
    gate, k = GATE_TOLERANCES * engine.progress[0].tolerance_px, 0
    free = sky.scale_prior.sigma > 0.0
    if matches.n_settled > 0 and best.free == free:
        k = _settled(matches, gate)
    best.free = free
    see_at_scale(frame, sky.focal_px, best.scale)
    if k == 0:
        k = _settle(sky, frame, max(_GATE_PX, gate), best, matches)
    # One step from a pose that is a few pixels off is not quite there yet.
    for _ in range(2):
        refine_pose(sky, frame, matches, k, best)
        see_at_scale(frame, sky.focal_px, best.scale)
    return k, measure(sky, frame, best, k, matches, matches.residual2)


@compiled
def write_labels(engine: Any, k: int, labels: NDArray[np.void]) -> None:
    """Label the centroids: the first `k` matches are identified, and of the rest some displaced.

    Writes all rows of `labels`, one for each centroid of the input.
    """
    frame, matches = engine.frame, engine.matches
    blank(labels)  # engines share them: another one may have labelled the frame since
    for i in range(k):
        row = labels[frame.row[matches.observed[i]]]
        row.catalog_index, row.state = matches.catalog[i], StarState.IDENTIFIED
        row.residual_px = np.sqrt(matches.residual2[i])
    if engine.limits.displaced_gate_px > 0 and k < frame.n:
        _label_displaced(engine, k, labels)


@compiled
def _settled(matches: Any, gate_px: float) -> int:
    """Return how many stars the judge's matches identify; 0 where that has to be looked into.

    It has not where the judge's gate was wide enough for the noise that it found, and where the
    final gate keeps just the matches that the pose was fitted to.
    """
    k, n_matched = matches.n_settled, matches.n_matched
    gate = max(_GATE_SIGMA * _sigma(matches.residual2, k), _GATE_FLOOR_PX)
    last_in = matches.residual2[k - 1] <= gate * gate
    next_out = k == n_matched or matches.residual2[k] > gate * gate
    return k if gate <= gate_px and last_in and next_out else 0


@compiled
def _settle(sky: Any, frame: Any, gate_px: float, pose: Any, matches: Any) -> int:
    """Associate, measure the noise and fit in turn until the matches stay the same.

    Returns the number of matches.
    """
    gate, trial = gate_px, matches.trial
    n_near = matches.n_near = look_up(sky, pose, 2 * gate, matches)
    found, n_inside = associate(sky, frame, pose, gate, n_near, matches)
    k = strongest(sky, frame, pose, matches, (found, n_inside))[0]
    for _ in range(_ROUNDS):
        copy_pose(pose, trial)
        refine_pose(sky, frame, matches, k, trial)
        see_at_scale(frame, sky.focal_px, trial.scale)
        narrow = max(_GATE_SIGMA * _sigma(matches.residual2, k), _GATE_FLOOR_PX)
        again = associate(sky, frame, trial, narrow, n_near, matches)[0]
        if again < 3:  # the matches before it stay
            see_at_scale(frame, sky.focal_px, pose.scale)
            k = min(k, associate(sky, frame, pose, gate, n_near, matches)[0])
            break
        copy_pose(trial, pose)
        gate, before, k = narrow, k, again
        if k == before:
            break
    return k


@compiled
def measure(
    sky: Any, frame: Any, pose: Any, k: int, matches: Any, residual2: Floats
) -> float:
    """Write the squared residuals of the first `k` matches for a pose; return their sum."""
    sum2 = 0.0
    r, vectors, focal_px = pose.rotation, matches.near_vectors, sky.focal_px * pose.scale
    for i in range(k):
        v = vectors[matches.listed[i]]
        place = frame.plane_px[matches.observed[i]]
        scale = focal_px / (r[0, 2] * v[0] + r[1, 2] * v[1] + r[2, 2] * v[2])
        dx = (r[0, 0] * v[0] + r[1, 0] * v[1] + r[2, 0] * v[2]) * scale - place[0]
        dy = (r[0, 1] * v[0] + r[1, 1] * v[1] + r[2, 1] * v[2]) * scale - place[1]
        residual2[i] = dx * dx + dy * dy
        sum2 += residual2[i]
    return sum2


@compiled
def _sigma(residual2: Floats, k: int) -> float:
    """Return the noise that k squared residuals show, which ascend.

    Three of the 2 k coordinates went into the pose. The mean of those that the median says are no
    outliers: a star out of place must not hide itself. Half of the squared residuals lie below
    2 ln(2) sigma^2. Of few stars, whose median says little, the mean of all.
    """
    limit = np.inf
    if k >= _FEW:
        median = 0.5 * (residual2[(k - 1) // 2] + residual2[k // 2])
        limit = _OUTLIER_SIGMA**2 * median / (2 * np.log(2)) * (2 * k / (2 * k - 3))
    sum2, n = 0.0, 0
    while n < k and residual2[n] <= limit:
        sum2 += residual2[n]
        n += 1
    return np.sqrt(sum2 / (2 * n - 3))


@compiled
def _label_displaced(engine: Any, k: int, labels: NDArray[np.void]) -> None:
    """Label stars that are left over with guide stars of the image that are left over.

    The first `k` matches are not left over. The nearest pair goes first. A pair counts only where
    the star's next nearest guide star is three times farther and where chance would not put two
    unrelated points so close: with a unmatched stars and b unmatched guide stars, a b pi d^2 /
    area pairs are expected within d.
    """
    frame, matches, sky = engine.frame, engine.matches, engine.sky
    gate_px = engine.limits.displaced_gate_px
    star = np.empty(frame.n, np.int64)
    a = 0
    for i in range(frame.n):
        if labels[frame.row[i]].state == StarState.UNIDENTIFIED:
            star[a] = i
            a += 1
    b = _left_over(sky, engine.best, matches, k)
    guide, place, plane_px = matches.guide_star, matches.place, frame.plane_px
    by_chance = _DISPLACED_CHANCE * sky.optics[0] * sky.optics[1] / np.pi
    while a > 0 and b > 0:
        at, nearest = 0, np.inf
        for i in range(a):
            d2 = _two_nearest(plane_px, star[i], place, b)[1]
            if d2 < nearest:
                at, nearest = i, d2
        if nearest > gate_px * gate_px or a * b * nearest > by_chance:
            return
        g, _, next_nearest = _two_nearest(plane_px, star[at], place, b)
        row = labels[frame.row[star[at]]]
        a -= 1
        star[at] = star[a]
        if next_nearest >= _DISPLACED_AMBIGUITY**2 * nearest:
            row.catalog_index, row.state = guide[g], StarState.DISPLACED
            row.residual_px = np.sqrt(nearest)
            b -= 1
            guide[g], place[g, 0], place[g, 1] = guide[b], place[b, 0], place[b, 1]


@compiled
def _left_over(sky: Any, pose: Any, matches: Any, k: int) -> int:
    """List the guide stars of the image that are not among the first `k` matches; return how many.

    They are listed in `guide_star`, their places at the beginning of `place`.
    """
    project(sky, pose, matches.n_near, matches)
    place, near, n = matches.place, matches.near, 0
    for g in range(matches.n_near):
        taken = False
        for at in range(k):
            taken |= matches.catalog[at] == near[g]
        if place[g, 2] <= 0.0 and not taken:
            matches.guide_star[n] = near[g]
            place[n, 0], place[n, 1] = place[g, 0], place[g, 1]
            n += 1
    return n


@compiled
def _two_nearest(
    plane_px: Floats, star: int, place: Floats, n: int
) -> tuple[int, float, float]:
    """Return a centroid's nearest of `n` places, and squared distances to it and to the next."""
    nearest, best, next_best = -1, np.inf, np.inf
    for g in range(n):
        dx, dy = plane_px[star, 0] - place[g, 0], plane_px[star, 1] - place[g, 1]
        d2 = dx * dx + dy * dy
        if d2 < best:
            nearest, best, next_best = g, d2, best
        elif d2 < next_best:
            next_best = d2
    return nearest, best, next_best
