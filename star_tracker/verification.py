"""Is a candidate true? The shared judge of all matchers, and the labels of an accepted frame.

The test is a-contrario (Desolneux, Moisan and Morel 2008; Moisan and Stival 2004, "AC-RANSAC"):
how many hypotheses as good as this one would a frame of unrelated points produce? It needs no
noise parameter, for it looks at every number of matched stars and takes the least likely one.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import betainc, gammaln

from star_tracker.attitude import wahba
from star_tracker.catalog import StarCatalog
from star_tracker.field import Candidate, StarField
from star_tracker.spherical import Floats

#: Rounds of projecting, associating and fitting.
_ROUNDS = 4
#: Errors that no residual shows: rounding of centroids and catalogue, pixels.
_FLOOR_PX = 0.15
#: The gate, in tolerances of the candidate, within which a star may be associated.
_GATE_TOLERANCES = 2.0
#: Labelling: widest gate; final gate in standard deviations (0.1 % of true stars lie beyond).
_LABEL_GATE_PX = 10.0
_LABEL_GATE_SIGMA = 3.7
_LABEL_GATE_FLOOR_PX = 0.3
#: A displaced star's second nearest guide star must be this many times farther.
_DISPLACED_AMBIGUITY = 3.0
#: A displaced star is labelled where fewer chance pairs than this are expected so close.
_DISPLACED_CHANCE = 0.05


class StarState(IntEnum):
    """What became of a centroid."""

    UNIDENTIFIED = 0
    IDENTIFIED = 1
    DISPLACED = 2


@dataclass(frozen=True)
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


@dataclass(frozen=True)
class Association:
    """Observed stars matched one-to-one with guide stars, nearest match first.

    Attributes:
        observed: (k,) indices into the field.
        catalog: (k,) catalogue indices.
        residual_px: (k,) ascending.
        n_predicted: how many guide stars the field should show.
    """

    observed: NDArray[np.intp]
    catalog: NDArray[np.intp]
    residual_px: Floats
    n_predicted: int


@dataclass(frozen=True)
class Verified:
    """A judged hypothesis: the rotation (3, 3) camera to ICRS and its log10 false alarms."""

    rotation: Floats
    log10_false_alarms: float
    tolerance_px: float


@dataclass(frozen=True)
class _Surroundings:
    """The guide stars in and around a field: what a pose's small corrections can bring in."""

    index: NDArray[np.intp]
    vectors: Floats

    @classmethod
    def of(
        cls, catalog: StarCatalog, field: StarField, rotation: Floats, margin_px: float
    ) -> "_Surroundings":
        margin_rad = margin_px / field.camera.focal_length_px
        # The cosine is kept above 0: the camera sees nothing at 90 deg from its boresight.
        reach = np.cos(min(field.camera.radius_rad + margin_rad, 1.55))
        index = np.flatnonzero(catalog.vectors @ rotation[:, 2] > reach)
        return cls(index, catalog.vectors[index])


def verify(catalog: StarCatalog, field: StarField, candidate: Candidate) -> Verified | None:
    """Judge a candidate against the whole frame; None where fewer than three stars fall in place.

    The number of hypotheses examined is not charged here, as only the caller knows it.
    """
    gate = _GATE_TOLERANCES * candidate.tolerance_px
    observed, matched = candidate.observed, candidate.catalog
    best: Verified | None = None
    surroundings: _Surroundings | None = None
    for _ in range(_ROUNDS):
        try:
            rotation = wahba(field.vectors[observed], catalog.vectors[matched])
        except ValueError:  # the matched stars lie on one line of sight: not a hypothesis
            break
        surroundings = surroundings or _Surroundings.of(catalog, field, rotation, 2 * gate)
        found = _associate(surroundings, field, rotation, gate)
        if len(found.observed) < 3:
            break
        k, score = _most_meaningful(found, field)
        if best is not None and score >= best.log10_false_alarms:
            break
        best = Verified(rotation, score, candidate.tolerance_px)
        if set(found.observed[:k]) == set(observed):
            break
        observed, matched = found.observed[:k], found.catalog[:k]
    return best


def _most_meaningful(found: Association, field: StarField) -> tuple[int, float]:
    """Return how many of the best matches are least likely by chance, and their log10 score."""
    scores = log10_false_alarms(
        found.residual_px, len(field), found.n_predicted, field.camera.area_px2
    )
    best = int(np.argmin(scores))
    return best + 3, float(scores[best])


def _associate(
    surroundings: _Surroundings, field: StarField, rotation: Floats, gate_px: float
) -> Association:
    """Match stars and guide stars that are each other's nearest within `gate_px`."""
    index, place = _predict(surroundings, field, rotation, gate_px)
    if len(index) == 0 or len(field) == 0:
        none = np.empty(0, np.intp)
        return Association(none, none, np.empty(0), len(index))
    offset = field.plane_px[:, None] - place[None]
    distance2 = np.einsum("ijk,ijk->ij", offset, offset)
    nearest_star = distance2.argmin(axis=0)
    nearest_guide = distance2.argmin(axis=1)
    star = np.flatnonzero(nearest_star[nearest_guide] == np.arange(len(field)))
    guide = nearest_guide[star]
    residual = np.sqrt(distance2[star, guide])
    order = np.argsort(residual, kind="stable")
    order = order[: np.searchsorted(residual[order], gate_px, "right")]
    return Association(star[order], index[guide[order]], residual[order], len(index))


def _predict(
    surroundings: _Surroundings, field: StarField, rotation: Floats, margin_px: float
) -> tuple[NDArray[np.intp], Floats]:
    """Return the guide stars (m,) in the image and their places (m, 2), as `field.plane_px`."""
    camera = field.camera
    local = surroundings.vectors @ rotation
    plane = local[:, :2] / local[:, 2:]
    inside = camera.contains(camera.pixels_of_plane(plane), margin_px)
    return surroundings.index[inside], plane[inside] * camera.focal_length_px


def log10_false_alarms(
    residual_px: Floats, n_observed: int, n_predicted: int, area_px2: float
) -> Floats:
    """Return log10 of the expected false alarms for the best 3, 4, ... matches of a frame.

    `residual_px` (k,) ascends. The best j matches lie within r_j, the residual made larger for
    the three parameters of the pose that were fitted to 2 j coordinates. A point without relation
    falls that near to one of the guide stars with p = n_predicted pi r_j^2 / area; two stars
    define the pose, so j - 2 or more of the other n - 2 have to. The number of values of j that
    were looked at multiplies the result.
    """
    j = np.arange(3, len(residual_px) + 1)
    radius = residual_px[2:] * np.sqrt(2 * j / (2 * j - 3)) + _FLOOR_PX
    p = np.minimum(n_predicted * np.pi * radius**2 / area_px2, 1.0)
    return np.asarray(log10_binomial_tail(j - 2, n_observed - 2, p) + np.log10(n_observed))


def log10_binomial_tail(successes: NDArray[np.intp], trials: int, p: Floats) -> Floats:
    """Return log10 of the chance of `successes` (1..trials) or more in `trials`.

    Where the incomplete beta function underflows, the union bound C(n, k) p^k stands in: it is
    never smaller than the tail.
    """
    exact = betainc(successes, trials - successes + 1, p)
    bound = (
        gammaln(trials + 1) - gammaln(successes + 1) - gammaln(trials - successes + 1)
    ) / np.log(10) + successes * np.log10(p)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(exact > 1e-290, np.log10(exact), bound))


def label(
    catalog: StarCatalog, field: StarField, verified: Verified, displaced_gate_px: float
) -> tuple[Identification, Floats]:
    """Label every star of an accepted frame; return the labels and the final rotation (3, 3).

    The noise is estimated from the frame itself, from the matches that are least likely by chance,
    so that a precise frame gets a narrow gate.
    """
    rotation = verified.rotation
    gate = max(_LABEL_GATE_PX, verified.tolerance_px)
    surroundings = _Surroundings.of(catalog, field, rotation, 2 * gate)
    found = _associate(surroundings, field, rotation, gate)
    k = _most_meaningful(found, field)[0]
    for _ in range(_ROUNDS):
        rotation = wahba(field.vectors[found.observed[:k]], catalog.vectors[found.catalog[:k]])
        # Three of the 2 k coordinates went into the rotation.
        sigma = np.sqrt(np.sum(found.residual_px[:k] ** 2) / (2 * k - 3))
        gate = max(_LABEL_GATE_SIGMA * float(sigma), _LABEL_GATE_FLOOR_PX)
        again = _associate(surroundings, field, rotation, gate)
        if len(again.observed) < 3:
            break
        found = again
        if len(found.observed) == k:
            break
        k = len(found.observed)
    result = Identification.empty(len(field))
    result.catalog_index[found.observed] = found.catalog
    result.state[found.observed] = StarState.IDENTIFIED
    result.residual_px[found.observed] = found.residual_px
    _label_displaced(surroundings, field, rotation, result, displaced_gate_px)
    return result, rotation


def _label_displaced(
    surroundings: _Surroundings,
    field: StarField,
    rotation: Floats,
    result: Identification,
    gate_px: float,
) -> None:
    """Assign stars that are left over to predicted guide stars that are left over, in place.

    A pair counts only where the next nearest guide star is three times farther and where chance
    would not put two unrelated points so close: with a unmatched stars and b unmatched guide
    stars, a b pi d^2 / area pairs are expected within d by chance.
    """
    star = np.flatnonzero(result.state == StarState.UNIDENTIFIED)
    if gate_px <= 0 or len(star) == 0:
        return
    index, place = _predict(surroundings, field, rotation, 0.0)
    free = ~np.isin(index, result.catalog_index)
    index, place = index[free], place[free]
    if len(index) == 0:
        return
    distance = np.linalg.norm(field.plane_px[star][:, None] - place[None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance, 2 * gate_px))
    n_star, n_guide = len(star), len(index)
    for row, column in sorted(zip(rows, columns, strict=True), key=lambda rc: distance[rc]):
        d = distance[row, column]
        others = np.delete(distance[row], column)
        chance = n_star * n_guide * np.pi * d**2 / field.camera.area_px2
        if d > gate_px or chance > _DISPLACED_CHANCE:
            break
        if len(others) and others.min() < _DISPLACED_AMBIGUITY * d:
            continue
        result.catalog_index[star[row]] = index[column]
        result.state[star[row]] = StarState.DISPLACED
        result.residual_px[star[row]] = d
        n_star, n_guide = n_star - 1, n_guide - 1
