"""Matcher 2, the fallback: radial-companion-cyclic patterns (paper, 5.3.4).

Every main star's pattern is compared with the patterns of all guide stars at once. As printed, the
similarity f_T (5-11, 5-12) counts against a guide star each of its neighbours that the frame does
not show, so that the edge of the field and missing stars ruin it. Here only what is observed
counts: observed bits, raw, against catalogue bits, compensated, as a likelihood ratio. A cyclic
alignment then looks for the roll that brings most neighbours of similar separation together. The
shared judge judges the result. `study/paper_forms.py` has the printed rule for comparison.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.patterns import Pattern, PatternLevel, PatternSettings, star_pattern
from star_tracker.geometry.spherical import Floats, position_angle, separation

#: Position angles in the camera are counted from the image's up direction, -y of the frame.
CAMERA_POLE = (0.0, -1.0, 0.0)
#: An observed star's nearest neighbours up to this number make its pattern. Only a frame full of
#: false stars has more; their pairs would set every bit, and take time that grows with the square.
_MAX_NEIGHBOURS = 60
#: Neighbours belong together when their rolls differ less than this.
_ALIGNED_RAD = float(np.radians(5.6))


@dataclass(frozen=True)
class Candidate:
    """A hypothesis: observed stars `observed[i]` are guide stars `catalog[i]`.

    Attributes:
        observed: (k,) indices into the field's stars.
        catalog: (k,) catalogue indices.
        tolerance_px: position tolerance with which the match was found.
    """

    observed: NDArray[np.intp]
    catalog: NDArray[np.intp]
    tolerance_px: float


#: What the matcher yields: how many hypotheses it has compared so far, and a candidate if this
#: step brought one. Steps without a candidate let the caller look at the clock.
Step = tuple[int, Candidate | None]
Steps = Iterator[Step]
#: How similar observed patterns are to those of all guide stars: (patterns, stars).
Similarity = Callable[[PatternLevel, list[Pattern]], Floats]


@dataclass(frozen=True)
class StarField:
    """A frame's usable stars: unit vectors (n, 3) in the optical frame, and the focal length."""

    vectors: Floats
    focal_px: float

    @cached_property
    def from_centre(self) -> NDArray[np.intp]:
        """Star indices in order of distance from the boresight, nearest first."""
        return np.argsort(-self.vectors[:, 2], kind="stable")

    def neighbours(self, star: int, count: int) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return the `count` nearest other stars: index, separation and position angle, rad."""
        separations = np.asarray(separation(self.vectors, self.vectors[star]))
        nearest = np.argsort(separations, kind="stable")
        nearest = nearest[nearest != star][:count]
        angle = position_angle(self.vectors[star], self.vectors[nearest], CAMERA_POLE)
        return nearest, separations[nearest], angle


@dataclass(frozen=True)
class RadialCyclicSettings:
    """How far the search goes.

    Attributes:
        ring_factors: the patterns' rings are widened by these factors, in turn.
        mains: how many of the stars nearest to the image's centre are compared.
        matches: how many guide stars are considered for each main star.
    """

    ring_factors: tuple[int, ...] = (1, 2, 4)
    mains: int = 15
    matches: int = 20

    def __post_init__(self) -> None:
        if not self.ring_factors or min(*self.ring_factors, self.mains, self.matches) < 1:
            raise ValueError("ring_factors, mains and matches must be at least 1")


def candidates(
    database: FeatureDatabase, field: StarField, settings: RadialCyclicSettings, *,
    similarity: Similarity | None = None, compensated: bool = False,
) -> Steps:
    """Yield candidates, the most similar pairs of main star and guide star first.

    There are also steps for each main star looked at and each pair that the alignment refuses.
    Studies give another similarity than the likelihood ratio, and the observed patterns
    compensation codes.
    """
    n_compared = 0
    radius_rad = database.pattern_settings.radius_rad
    mains: list[_Main] = []
    for star in field.from_centre[: settings.mains].tolist():
        yield n_compared, None
        mains.append(_Main.of(field, star, radius_rad))
    for factor in settings.ring_factors if mains else ():
        level = database.patterns.level(factor)
        ring_rad, similar = level.settings.ring_rad, list[tuple[float, int, int]]()
        for row, main in enumerate(mains):
            yield n_compared, None
            pattern = star_pattern(
                field.vectors[main.star], field.vectors[main.neighbour], level.settings,
                pole=CAMERA_POLE, compensated=compensated,
            )
            yield n_compared, None
            values = (similarity or _likelihood)(level, [pattern])[0]
            yield n_compared, None
            similar += [(-values[star], row, star) for star in _highest(values, settings.matches)]
            n_compared += _n_compared(database, main, ring_rad)
        yield n_compared, None
        for _, row, star in sorted(similar):
            members = _align(database, mains[row], star, level.settings)
            tolerance_px = ring_rad * field.focal_px
            yield n_compared, members and Candidate(*members, tolerance_px)


@dataclass(frozen=True)
class _Main:
    """A main star with its neighbours (k,): indices, separations and position angles, rad."""

    star: int
    neighbour: NDArray[np.intp]
    separation_rad: Floats
    angle_rad: Floats

    @classmethod
    def of(cls, field: StarField, star: int, radius_rad: float) -> "_Main":
        neighbour, apart, angle = field.neighbours(star, _MAX_NEIGHBOURS)
        near = apart < radius_rad
        return cls(star, neighbour[near], apart[near], angle[near])


def _n_compared(database: FeatureDatabase, main: _Main, ring_rad: float) -> int:
    """Return how many hypotheses the comparison of a main star with all guide stars stands for.

    As with the primary matcher each guide-star pair whose separation agrees with an observed pair
    is one: together they fix a pose. The patterns compare all of them at once.
    """
    apart = main.separation_rad
    first, last = database.pattern_pairs.ranges(apart - ring_rad, apart + ring_rad)
    return int((last - first).sum())


def _likelihood(level: PatternLevel, observed: list[Pattern]) -> Floats:
    """Return the log likelihood ratio (mains, stars) of "this guide star" against "any other".

    An observed bit is a true neighbour's with probability 1/2 and then matches; otherwise it
    matches by chance, with the fraction of the guide star's bits that are set.
    """
    total = np.zeros((len(observed), len(level.radial)))
    for name, (hit, missed) in level.log_likelihoods.items():
        bits = np.array([getattr(pattern, name) for pattern in observed], np.float32)
        matching = bits @ getattr(level, name).T
        total += matching * hit + (bits.sum(axis=1)[:, None] - matching) * missed
    return total


def _highest(values: Floats, count: int) -> list[int]:
    """Return where the `count` highest of values (n,) stand, in no order."""
    count = min(count, len(values))
    return np.argpartition(-values, count - 1)[:count].tolist()


def _align(
    database: FeatureDatabase, main: _Main, star: int, settings: PatternSettings
) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Return the largest set of neighbours that one roll brings together, with the main star.

    They come as indices into the field and into the catalogue, each (k,); None below k = 3.
    """
    vectors = database.catalog.vectors
    near = np.flatnonzero(vectors @ vectors[star] > np.cos(settings.radius_rad))
    near = near[near != star]
    apart = np.asarray(separation(vectors[near], vectors[star]))
    i, j = np.nonzero(np.abs(main.separation_rad[:, None] - apart[None]) < settings.ring_rad)
    if len(i) < 2:
        return None
    roll = (position_angle(vectors[star], vectors[near[j]]) - main.angle_rad[i]) % (2 * np.pi)
    order = np.argsort(roll)
    turned = np.concatenate([roll[order], roll[order] + 2 * np.pi])
    end = np.searchsorted(turned, roll[order] + _ALIGNED_RAD)
    start = int(np.argmax(end - np.arange(len(order))))
    together = order[np.arange(start, end[start]) % len(order)]
    if len(together) < 2:
        return None
    return (
        np.concatenate([[main.star], main.neighbour[i[together]]]),
        np.concatenate([[star], near[j[together]]]),
    )
