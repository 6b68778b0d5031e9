"""Is a candidate true? The shared judge of all matchers.

A candidate's pose predicts where the catalogue's stars are; centroids and predictions are matched
one to one, the evidence of the matches is weighed (`evidence.py`), the pose
is fitted to those that carry most of it, and so on until nothing improves.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.wahba import refine, solve_wahba
from star_tracker.catalogue.sky_index import SkyIndex, stars_near
from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.evidence import Evidence, brightness, strongest
from star_tracker.identification.field import Candidate, Frame, StarField
from star_tracker.optics.camera import outside_px

#: Rounds of projecting, associating and fitting.
_ROUNDS = 5
#: The gate, in tolerances of the candidate, within which a star may be associated.
GATE_TOLERANCES = 2.0
#: The camera sees nothing at 90 deg from its boresight.
_FARTHEST_RAD = 1.55


@dataclass(frozen=True)
class Verified:
    """A judged hypothesis: the rotation (3, 3) camera to ICRS and its log10 false alarms."""

    rotation: Floats
    log10_false_alarms: float
    tolerance_px: float


class Sky(NamedTuple):
    """Guide stars and the camera that looks at them.

    Attributes:
        guides: the guide stars.
        v_mag: (n,) their V magnitudes, by catalogue index.
        optics: the camera.
        radius_rad: largest angle between the boresight and the image's border.
        evidence: factorials and the noise.
    """

    guides: SkyIndex
    v_mag: Floats
    optics: Floats
    radius_rad: float
    evidence: Evidence


class Matches(NamedTuple):
    """Room for one hypothesis: what it predicts and what is matched.

    Attributes:
        near: (g,) catalogue indices of the guide stars in and around the image.
        place: (g, 3) where a pose puts them: undistorted image coordinates, px, and how far
            outside of the image that is.
        guide_star: (g,) the nearest centroid of each, -1 = none within the gate.
        star_guide: (n,) the nearest guide star of each centroid, as a place in `near`, -1 = none.
        star_residual2: (n,) its squared distance, px^2.
        observed, catalog: (n,) the matches, indices into the frame and the catalogue.
        residual2: (n,) their squared distances, px^2, ascending.
        settled: (4,) of the pose judged last: how many matches carry its evidence; and if it was
            fitted to the very matches listed, how many of them carry most evidence, how many
            there are, how many guide stars are near, else 0.
    """

    near: NDArray[np.int64]
    place: Floats
    guide_star: NDArray[np.int64]
    star_guide: NDArray[np.int64]
    star_residual2: Floats
    observed: NDArray[np.int64]
    catalog: NDArray[np.int64]
    residual2: Floats
    settled: NDArray[np.int64]


@compiled
def empty_matches(
    near: NDArray[np.int64], place: Floats, guide_star: NDArray[np.int64], n: int
) -> Matches:
    """Return room for a frame of `n` centroids; the others have room for all guide stars."""
    return Matches(
        near, place, guide_star, np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64),
        np.empty(n, np.int64), np.empty(n), np.zeros(4, np.int64),
    )


@compiled
def look_up(sky: Sky, rotation: Floats, margin_px: float, matches: Matches) -> int:
    """Find the guide stars in and around the image of a pose; return their number."""
    margin_rad = margin_px / np.sqrt(sky.optics[2] * sky.optics[3])
    reach = min(sky.radius_rad + margin_rad, _FARTHEST_RAD)
    return stars_near(sky.guides, rotation[:, 2], reach, matches.near)


@compiled
def associate(
    sky: Sky, frame: Frame, rotation: Floats, gate_px: float, n_near: int, matches: Matches
) -> tuple[int, int]:
    """Match each guide star with its nearest centroid within `gate_px`, one to one.

    Of several guide stars with the same nearest centroid the nearest has it. Returns the number
    of matches, sorted by residual, and of guide stars in the image.
    """
    project(sky, rotation, n_near, matches)
    n, n_inside = len(frame.vectors), 0
    for star in range(n):
        matches.star_guide[star] = -1
        matches.star_residual2[star] = gate_px * gate_px
    for g in range(n_near):
        matches.guide_star[g] = -1
        outside = matches.place[g, 2]
        if outside > gate_px:
            continue
        n_inside += outside <= 0.0
        star, residual2 = _nearest(frame, matches.place[g, 0], matches.place[g, 1], gate_px)
        matches.guide_star[g] = star
        if star >= 0 and residual2 <= matches.star_residual2[star]:
            matches.star_residual2[star] = residual2
            matches.star_guide[star] = g
    return _mutual(n, matches), n_inside


@compiled
def project(sky: Sky, rotation: Floats, n_near: int, matches: Matches) -> None:
    """Write the places of the guide stars near the image of a pose."""
    r, place, vectors = rotation, matches.place, sky.guides.vectors
    focal_px = np.sqrt(sky.optics[2] * sky.optics[3])
    for g in range(n_near):
        v = vectors[matches.near[g]]
        z = r[0, 2] * v[0] + r[1, 2] * v[1] + r[2, 2] * v[2]
        place[g, 0] = (r[0, 0] * v[0] + r[1, 0] * v[1] + r[2, 0] * v[2]) / z
        place[g, 1] = (r[0, 1] * v[0] + r[1, 1] * v[1] + r[2, 1] * v[2]) / z
    outside_px(sky.optics, place, n_near)
    for g in range(n_near):
        place[g, 0] *= focal_px
        place[g, 1] *= focal_px


@inlined
def _nearest(frame: Frame, x: float, y: float, gate_px: float) -> tuple[int, float]:
    """Return the centroid nearest to a place of the image plane within a gate, -1 for none."""
    plane, n = frame.plane_px, len(frame.plane_px)
    at, high = 0, n
    while at < high:
        middle = (at + high) >> 1
        if plane[middle, 0] < x - gate_px:
            at = middle + 1
        else:
            high = middle
    nearest, best = -1, gate_px * gate_px
    while at < n and plane[at, 0] <= x + gate_px:
        dx, dy = plane[at, 0] - x, plane[at, 1] - y
        d2 = dx * dx + dy * dy
        if d2 <= best:
            nearest, best = at, d2
        at += 1
    return nearest, best


@compiled
def _mutual(n: int, matches: Matches) -> int:
    """List the pairs that are each other's nearest, by residual; return their number."""
    k = 0
    for star in range(n):
        guide = matches.star_guide[star]
        if guide < 0 or matches.guide_star[guide] != star:
            continue
        residual2, at = matches.star_residual2[star], k
        while at > 0 and matches.residual2[at - 1] > residual2:
            matches.observed[at] = matches.observed[at - 1]
            matches.catalog[at] = matches.catalog[at - 1]
            matches.residual2[at] = matches.residual2[at - 1]
            at -= 1
        matches.observed[at], matches.residual2[at] = star, residual2
        matches.catalog[at] = matches.near[guide]
        k += 1
    return k


@compiled
def judge(
    sky: Sky, frame: Frame, tolerance_px: float, rotation: Floats, matches: Matches
) -> float:
    """Improve a pose as far as the frame supports it; return log10 of its evidence.

    `rotation` (3, 3) is that of the candidate and becomes the best one; minus infinity is
    returned, and nothing changed, where fewer than three stars fall in place.
    """
    gate = GATE_TOLERANCES * tolerance_px
    n_near = look_up(sky, rotation, 2 * gate, matches)
    best, trial = -np.inf, np.empty((3, 3))
    copy_rotation(rotation, trial)
    before, k_before = 0, 0
    matches.settled[0] = matches.settled[1] = 0
    for _ in range(_ROUNDS):
        n_matched, n_inside = associate(sky, frame, trial, gate, n_near, matches)
        if n_matched < 3:
            break
        k, score = strongest(
            sky.evidence, frame.vectors, matches.observed, matches.residual2, n_matched, n_inside,
            sky.optics,
        )
        if len(frame.magnitude) > 0:
            score += brightness(
                frame.magnitude, sky.v_mag, matches.observed, matches.catalog, k
            )
        if not score > best:
            break
        best, matches.settled[0] = score, k
        copy_rotation(trial, rotation)
        # The pose was fitted to these very matches already: they will not change any more.
        names = 0
        for i in range(k):
            names += (matches.observed[i] + 1) * (matches.catalog[i] + 1)
        if k == k_before and names == before:
            matches.settled[1], matches.settled[2], matches.settled[3] = k, n_matched, n_near
            break
        before, k_before = names, k
        refine(frame.vectors, matches.observed, sky.guides.vectors, matches.catalog, k, trial)
    return best


@inlined
def copy_rotation(source: Floats, target: Floats) -> None:
    """Copy a matrix (3, 3). Written out: an assignment of slices compiles to much more."""
    for i in range(3):
        for j in range(3):
            target[i, j] = source[i, j]


def verify(sky: Sky, field: StarField, candidate: Candidate) -> Verified | None:
    """Judge a candidate against the whole frame; None where fewer than three stars fall in place.

    Also None where the matched stars lie on one line of sight: that is no hypothesis.
    """
    rotation = np.empty((3, 3))
    observed = np.ascontiguousarray(candidate.observed, np.int64)
    catalog = np.ascontiguousarray(candidate.catalog, np.int64)
    vectors = field.vectors, sky.guides.vectors
    if not solve_wahba(vectors[0], observed, vectors[1], catalog, len(observed), rotation):
        return None
    matches = matches_for(sky, field)
    score = judge(sky, field.frame, candidate.tolerance_px, rotation, matches)
    if score == -np.inf:
        return None
    return Verified(rotation, -score, candidate.tolerance_px)


def matches_for(sky: Sky, field: StarField) -> Matches:
    """Return room for the hypotheses of a field."""
    n = len(sky.guides.star)
    return empty_matches(
        np.empty(n, np.int64), np.empty((n, 3)), np.empty(n, np.int64), len(field)
    )
