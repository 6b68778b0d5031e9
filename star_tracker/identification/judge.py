"""Is a pose true? The shared judge of all matchers.

A pose predicts where the catalogue's stars are; centroids and predictions are matched one to one,
the evidence of the matches is weighed (`evidence.py`), the pose is fitted to those that carry most
of it, and so on until nothing improves.
"""

from typing import Any, NamedTuple

import numpy as np

from star_tracker.attitude.joint_fit import refine_scaled
from star_tracker.attitude.pose import copy_pose, identity_pose
from star_tracker.attitude.wahba import refine
from star_tracker.catalogue.sky_index import SkyIndex, stars_near
from star_tracker.compiled import compiled, inlined, struct
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.brightness import with_brightness
from star_tracker.identification.evidence import Evidence, ScalePrior, strongest
from star_tracker.optics.camera import outside_px
from star_tracker.optics.frame import first_right_of, see_at_scale

#: Rounds of projecting, associating and fitting, and more of them where the scale is fitted too.
_ROUNDS, _MORE_ROUNDS = 5, 2
#: A pose of a fitted scale with less evidence at first sight is not improved: there are many of
#: them, and a true one hardly ever begins so low (false ones stand at -6 to -10).
_HOPELESS = -4.0
#: Decades of evidence that rounding can take.
_ROUNDING = 1e-9
#: The gate, in tolerances of the candidate, within which a star may be associated.
GATE_TOLERANCES = 2.0
#: The camera sees nothing at 90 deg from its boresight.
_FARTHEST_RAD = 1.55


class View(NamedTuple):
    """Guide stars and the camera that looks at them, from which a `Sky` is made.

    Attributes:
        guides: the guide stars.
        v_mag: (n,) their V magnitudes, by catalogue index.
        optics: the camera.
        focal_px: its mean focal length.
        radius_rad: largest angle between the boresight and the image's border.
        evidence: factorials and the noise.
        scale_prior: what is known of the focal length.
    """

    guides: SkyIndex
    v_mag: Floats
    optics: Floats
    focal_px: float
    radius_rad: float
    evidence: Evidence
    scale_prior: ScalePrior


#: What `View` holds, for compiled code.
SkyType, Sky = struct("Sky", __name__, View._fields)

#: Room for one hypothesis, what it predicts and what is matched:
#:
#: - near, near_vectors: (g,) and (g, 3) catalogue indices and unit vectors of the guide stars in
#:   and around the image, side by side in memory, where the catalogue's own lie far apart;
#: - place: (g, 3) where a pose puts them: undistorted image coordinates, px, and how far outside
#:   of the image that is;
#: - guide_star: (g,) the nearest centroid of each, -1 = none within the gate;
#: - star_guide: (n,) the nearest guide star of each centroid, as a place in `near`, -1 = none;
#: - star_residual2: (n,) its squared distance, px^2;
#: - observed, catalog: (n,) the matches, indices into the frame and the catalogue, and listed: the
#:   guide stars' places in `near`;
#: - residual2: (n,) their squared distances, px^2, ascending;
#: - weighed, weighed_catalog: (n,) those matches that carry most evidence of places so far, of
#:   which brightness is weighed in the end;
#: - trial: a pose;
#: - n_best: how many matches carry the evidence of the pose judged last, and n_in_view: of so many
#:   guide stars in the image;
#: - n_settled: the same if that pose was fitted to the very matches listed, else 0;
#: - n_matched: then, how many matches are listed;
#: - n_near: then, and once it is labelled, how many guide stars are near.
MatchesType, Matches = struct("Matches", __name__, (
    "near", "near_vectors", "place", "guide_star", "star_guide", "star_residual2", "observed",
    "catalog", "listed", "residual2", "weighed", "weighed_catalog", "trial", "n_best", "n_in_view",
    "n_settled", "n_matched", "n_near",
))


@compiled
def empty_matches(n_guides: int, n_centroids: int) -> Any:
    """Return room for a hypothesis about so many guide stars and centroids."""
    return Matches(
        np.empty(n_guides, np.int64), np.empty((n_guides, 3)), np.empty((n_guides, 3)),
        np.empty(n_guides, np.int64), np.empty(n_centroids, np.int64), np.empty(n_centroids),
        np.empty(n_centroids, np.int64), np.empty(n_centroids, np.int64),
        np.empty(n_centroids, np.int64), np.empty(n_centroids),
        np.empty(n_centroids, np.int64), np.empty(n_centroids, np.int64),
        identity_pose(), 0, 0, 0, 0, 0,
    )


@compiled
def look_up(sky: Any, pose: Any, margin_px: float, matches: Any) -> int:
    """Find the guide stars in and around the image of a pose; return their number."""
    radius = sky.radius_rad
    if pose.scale != 1.0:
        radius = np.arctan(np.tan(radius) / pose.scale)
    reach = min(radius + margin_px / (sky.focal_px * pose.scale), _FARTHEST_RAD)
    return stars_near(
        sky.guides, pose.rotation[:, 2], reach, matches.near, matches.near_vectors
    )


@compiled
def associate(
    sky: Any, frame: Any, pose: Any, gate_px: float, n_near: int, matches: Any
) -> tuple[int, int]:
    """Match each guide star with its nearest centroid within `gate_px`, one to one.

    Of several guide stars with the same nearest centroid the nearest has it. Returns the number
    of matches, sorted by residual, and of guide stars in the image.
    """
    project(sky, pose, n_near, matches)
    n, n_inside, place = frame.n, 0, matches.place
    guide_star, star_guide = matches.guide_star, matches.star_guide
    star_residual2 = matches.star_residual2
    for star in range(n):
        star_guide[star] = -1
        star_residual2[star] = gate_px * gate_px
    for g in range(n_near):
        guide_star[g] = -1
        outside = place[g, 2]
        if outside > gate_px:
            continue
        n_inside += outside <= 0.0
        star, residual2 = nearest_centroid(frame, place[g, 0], place[g, 1], gate_px)
        guide_star[g] = star
        if star >= 0 and residual2 <= star_residual2[star]:
            star_residual2[star] = residual2
            star_guide[star] = g
    return _mutual(n, matches), n_inside


@compiled
def project(sky: Any, pose: Any, n_near: int, matches: Any) -> None:
    """Write the places of the guide stars near the image of a pose."""
    r, place, vectors = pose.rotation, matches.place, matches.near_vectors
    focal_px, scale = sky.focal_px, pose.scale
    for g in range(n_near):
        v = vectors[g]
        z = r[0, 2] * v[0] + r[1, 2] * v[1] + r[2, 2] * v[2]
        place[g, 0] = (r[0, 0] * v[0] + r[1, 0] * v[1] + r[2, 0] * v[2]) / z * scale
        place[g, 1] = (r[0, 1] * v[0] + r[1, 1] * v[1] + r[2, 1] * v[2]) / z * scale
    outside_px(sky.optics, place, n_near)
    for g in range(n_near):
        place[g, 0] *= focal_px
        place[g, 1] *= focal_px


@inlined
def nearest_centroid(frame: Any, x: float, y: float, gate_px: float) -> tuple[int, float]:
    """Return which centroid is nearest to a place within a gate, -1 for none."""
    n, plane_px, at = frame.n, frame.plane_px, first_right_of(frame, x - gate_px)
    nearest, best = -1, gate_px * gate_px
    while at < n and plane_px[at, 0] <= x + gate_px:
        dx, dy = plane_px[at, 0] - x, plane_px[at, 1] - y
        d2 = dx * dx + dy * dy
        if d2 <= best:
            nearest, best = at, d2
        at += 1
    return nearest, best


@compiled
def _mutual(n: int, matches: Any) -> int:
    """List the pairs that are each other's nearest, by residual; return their number."""
    guide_star, star_guide = matches.guide_star, matches.star_guide
    observed, listed, listed2 = matches.observed, matches.listed, matches.residual2
    k = 0
    for star in range(n):
        guide = star_guide[star]
        if guide < 0 or guide_star[guide] != star:
            continue
        residual2, at = matches.star_residual2[star], k
        while at > 0 and listed2[at - 1] > residual2:
            observed[at], listed[at] = observed[at - 1], listed[at - 1]
            listed2[at] = listed2[at - 1]
            at -= 1
        observed[at], listed[at], listed2[at] = star, guide, residual2
        k += 1
    for at in range(k):
        matches.catalog[at] = matches.near[listed[at]]
    return k


@compiled
def judge(sky: Any, frame: Any, tolerance_px: float, pose: Any, matches: Any) -> float:
    """Improve a pose as far as the frame supports it; return log10 of its evidence.

    `pose` is the candidate's and becomes the best one; minus infinity is returned, and nothing
    changed, where fewer than three stars fall in place.
    """
    gate = GATE_TOLERANCES * tolerance_px
    n_near = look_up(sky, pose, 2 * gate, matches)
    best, trial, seen_at = -np.inf, matches.trial, pose.scale
    copy_pose(pose, trial)
    before, k_before = 0, 0
    matches.n_best = matches.n_settled = 0
    for _ in range(_ROUNDS + (_MORE_ROUNDS if pose.free else 0)):
        see_at_scale(frame, sky.focal_px, trial.scale)
        if abs(trial.scale / seen_at - 1.0) * sky.focal_px * np.tan(sky.radius_rad) > gate:
            n_near, seen_at = look_up(sky, trial, 2 * gate, matches), trial.scale
        n_matched, n_inside = associate(sky, frame, trial, gate, n_near, matches)
        if n_matched < 3:
            break
        k, score = strongest(sky, frame, trial, matches, (n_matched, n_inside))
        names = _names(matches, k)
        settled = k == k_before and names == before
        # Perfect centroids have no more evidence after the fit than before it.
        if not score > (best - _ROUNDING if settled else best):
            break
        if pose.free and score < _HOPELESS:
            break
        best, matches.n_best, matches.n_in_view = max(score, best), k, n_inside
        copy_pose(trial, pose)
        if frame.has_brightness:
            _keep_for_weighing(matches, k)
        # The pose was fitted to these very matches already: they will not change any more.
        if settled:
            matches.n_settled, matches.n_matched, matches.n_near = k, n_matched, n_near
            break
        before, k_before = names, k
        refine_pose(sky, frame, matches, k, trial)
        if trial.free:  # no farther than the search goes
            low, high = np.exp(sky.scale_prior.low), np.exp(sky.scale_prior.high)
            trial.scale = min(max(trial.scale, low), high)
    if not frame.has_brightness or best == -np.inf:
        return best
    seen = matches.weighed, matches.weighed_catalog
    return with_brightness(best, frame, sky.v_mag, seen, matches.n_best)


@inlined
def _keep_for_weighing(matches: Any, k: int) -> None:
    """Keep the first `k` matches, whose brightness is weighed if no other ones are better."""
    for i in range(k):
        matches.weighed[i] = matches.observed[i]
        matches.weighed_catalog[i] = matches.catalog[i]


@inlined
def _names(matches: Any, k: int) -> int:
    """Return a number that changes when one of the first `k` matches does."""
    names = 0
    for i in range(k):
        names += (matches.observed[i] + 1) * (matches.catalog[i] + 1)
    return names


@compiled
def refine_pose(sky: Any, frame: Any, matches: Any, k: int, pose: Any) -> None:
    """Fit a pose to the first `k` matches, by one step of least squares.

    The frame's directions must be those of the pose's scale.
    """
    if pose.free:
        e, sigma = sky.evidence, sky.focal_px * sky.scale_prior.sigma
        prior = e.scale_px2 / e.freedom / (sigma * sigma)
        refine_scaled(frame.vectors, matches.near_vectors, matches, k, pose, prior)
        return
    refine(
        frame.vectors, matches.observed, matches.near_vectors, matches.listed, k, pose.rotation
    )
