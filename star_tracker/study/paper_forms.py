"""The paper's own forms of both matchers, in plain numpy, for comparison (paper, 5.2.5, 5.3.4).

Match groups raise state flags: each observed pair raises the flag of every guide star of every
pair of that separation, whatever the roll, and the stars with the highest flags are looked at.
Patterns are ranked by the printed similarity difference f_T. What follows is not the paper's: as
in this package a candidate's pose is judged against the whole frame, so that the forms differ in
the way to the candidates only.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.pairs import AZIMUTH_BITS, PairTable
from star_tracker.catalogue.patterns import Pattern, PatternLevel
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.fallback import (
    Candidate,
    RadialCyclicSettings,
    StarField,
    Steps,
    candidates,
)
from star_tracker.identification.searcher import METHODS
from star_tracker.solution import SolveSettings
from star_tracker.study.contestants import Told
from star_tracker.study.own_methods import OwnMethod
from star_tracker.tracker import StarTracker

#: The paper's tolerance of a separation. The nearest so many stars raise flags for a main star,
#: of whose guide stars those with the highest flags, of two at least, become candidates.
_TOLERANCE_PX, _COMPANIONS, _HIGHEST, _FEWEST_FLAGS = 3.0, 20, 3, 2
#: Guide stars whose flags are two first, and pairs, that are looked at for a main star.
_MOST_STARS, _MOST_PAIRS, _FEWEST_COMPANIONS = 1024, 100_000, 3
#: Members of a candidate.
_MEMBERS = 64


def flag_candidates(database: FeatureDatabase, field: StarField) -> Steps:
    """Yield the candidates of one main star after another, the highest flag first (5.2.5)."""
    sky, tolerance_rad = database.catalog.vectors, _TOLERANCE_PX / field.focal_px
    for main in field.from_centre.tolist():
        companion, separation_rad, _ = field.neighbours(main, _COMPANIONS)
        raised, stars = raise_flags(database.pairs, separation_rad, tolerance_rad)
        yield 0, None
        for star in stars:
            place, own = _members(database.pairs, separation_rad[:raised], tolerance_rad, star)
            kept = _triangle_check(field.vectors[companion[place]], sky[own], tolerance_rad)
            if len(kept):
                yield 0, Candidate(
                    np.append(companion[place[kept]], main), np.append(own[kept], star),
                    _TOLERANCE_PX,
                )


def raise_flags(
    pairs: PairTable, separation_rad: Floats, tolerance_rad: float
) -> tuple[int, list[int]]:
    """Let companions (k,) raise the flags of all guide stars of pairs of their separations.

    Returns how many companions did, since in a deep catalogue the nearest have pairs enough, and
    the guide stars with the highest flags.
    """
    first, last = (
        np.searchsorted(pairs.separation_rad, (separation_rad + sign * tolerance_rad).astype("f4"))
        for sign in (-1, 1)
    )
    crowded = np.cumsum(last - first) > _MOST_PAIRS
    crowded[:_FEWEST_COMPANIONS] = False
    raised = int(np.argmax(crowded)) if crowded.any() else len(first)
    flags = np.zeros(len(pairs.near_start) - 1, np.int64)
    seen: list[int] = []
    for begin, end in zip(first[:raised], last[:raised], strict=True):
        stars, place = np.unique(
            pairs.main_azimuth[begin:end] >> AZIMUTH_BITS, return_index=True
        )
        stars = stars[np.argsort(place)]
        flags[stars] += 1
        seen += stars[flags[stars] == _FEWEST_FLAGS].tolist()
    looked_at = np.array(seen[:_MOST_STARS], np.int64)
    highest = np.argsort(-flags[looked_at], kind="stable")[:_HIGHEST]
    return raised, looked_at[highest].tolist()


def _members(
    pairs: PairTable, separation_rad: Floats, tolerance_rad: float, star: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the matches (k,) of companions with a star's own: places and catalogue indices."""
    own = slice(pairs.near_start[star], pairs.near_start[star + 1])
    first, last = (
        np.searchsorted(
            pairs.near_separation_rad[own], (separation_rad + sign * tolerance_rad).astype("f4")
        )
        for sign in (-1, 1)
    )
    rows = [np.arange(begin, end) for begin, end in zip(first, last, strict=True)]
    place = np.repeat(np.arange(len(rows)), last - first)[:_MEMBERS]
    return place, pairs.near_companion[own][np.concatenate(rows)[:_MEMBERS]].astype(np.int64)


def _triangle_check(observed: Floats, catalog: Floats, tolerance_rad: float) -> NDArray[np.intp]:
    """Return the places of the matches (k, 3), (k, 3) that agree with the best one (5-6).

    That is the one with which most others agree in their separation; none where no two do.
    """
    chords = (
        np.linalg.norm(side[:, None] - side[None], axis=2) for side in (observed, catalog)
    )
    agree = np.abs(next(chords) - next(chords)) <= tolerance_rad
    np.fill_diagonal(agree, val=False)
    if not agree.any():
        return np.empty(0, np.intp)
    hub = int(np.argmax(agree.sum(axis=1)))
    agree[hub, hub] = True
    return np.flatnonzero(agree[hub])


def similarity_difference(level: PatternLevel, observed: list[Pattern]) -> Floats:
    """Return f_T (patterns, stars): bits that the frame does not show, squared (5-11, 5-12).

    Both sides carry compensation codes.
    """
    total = np.zeros((len(observed), len(level.radial)))
    for name in ("radial", "companion", "cyclic"):
        bits = np.array([getattr(pattern, name) for pattern in observed], np.float32)
        stars = getattr(level, name)
        total += (bits @ stars.T - stars.sum(axis=1)) ** 2
    return total


def pattern_candidates(database: FeatureDatabase, field: StarField) -> Steps:
    """Yield candidates in the order of f_T, with rings of one width (5.3.4)."""
    return candidates(
        database, field, RadialCyclicSettings(ring_factors=(1,)),
        similarity=lambda level, observed: -similarity_difference(level, observed),
        compensated=True,
    )


#: The methods that have a form of the paper's, with its way to the candidates.
_WAYS = {"match_group": flag_candidates, "radial_cyclic": pattern_candidates}


@dataclass(frozen=True)
class PaperForm(OwnMethod):
    """A method in the paper's form. Raises ValueError for a method that has none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method not in _WAYS:
            raise ValueError(f"method {self.method} has no form paper: use form own")

    @property
    def title(self) -> str:
        """What tables call it."""
        return self.name or f"{self.method}, paper"

    @property
    def settings(self) -> str:
        """How it is set up, in words."""
        return f"method {self.method} as the paper has it, in numpy, {self.told_brightness()}"

    @property
    def finds_camera(self) -> bool:
        """The paper takes the focal length as known."""
        return False

    def tracker(self, database: FeatureDatabase, told: Told) -> StarTracker:
        """Return a tracker whose candidates come from the paper's form alone."""
        settings = SolveSettings(method=METHODS[1], deadline_ms=told.deadline_ms)
        way = partial(_WAYS[self.method], database)
        return StarTracker(database, told.camera, settings, candidates=way)
