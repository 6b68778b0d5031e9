"""Our own methods as contestants."""

from dataclasses import dataclass

from star_tracker.catalogue.database import MAX_PATTERN_STARS, FeatureDatabase
from star_tracker.identification.searcher import METHODS
from star_tracker.solution import Solution, SolveSettings
from star_tracker.study.contestants import Answer, Contestant, Entrant, Told
from star_tracker.tracker import StarTracker


@dataclass(frozen=True)
class OwnMethod(Contestant):
    """A method of this package with its default settings: `match_group`, `radial_cyclic`, `auto`.

    Raises ValueError for a method that does not exist.
    """

    method: str = "auto"
    names_stars = True

    def __post_init__(self) -> None:
        if self.method not in {*METHODS, "auto"}:
            raise ValueError(f"method {self.method!r} is unknown: use auto, {', '.join(METHODS)}")

    @property
    def title(self) -> str:
        """What tables call it."""
        return self.name or self.method

    @property
    def settings(self) -> str:
        """How it is set up, in words."""
        return f"method {self.method}, default settings, {self.told_brightness()}"

    def set_up(self, told: Told) -> Entrant:
        """Make it ready for a camera."""
        database = told.sky.database()
        tracker = self.tracker(database, told)
        return Entrant(
            lambda scene: (scene.xy_px, scene.intensity if self.brightness else None),
            lambda given: tracker.solve(*given), _answer, self._storage_bytes(database),
        )

    def tracker(self, database: FeatureDatabase, told: Told) -> StarTracker:
        """Return the tracker that is measured."""
        # The other method cannot take so many stars.
        dense = self.method == "auto" and len(database.catalog) > MAX_PATTERN_STARS
        settings = SolveSettings(
            method=METHODS[0] if dense else self.method, deadline_ms=told.deadline_ms
        )
        return StarTracker(database, told.camera, settings)

    def _storage_bytes(self, database: FeatureDatabase) -> int:
        size = 0 if self.method == METHODS[1] else database.pairs.nbytes
        if self.method == METHODS[0] or len(database.catalog) > MAX_PATTERN_STARS:
            return size
        return size + database.patterns.packed.nbytes


def _answer(solution: Solution) -> Answer:
    attitude = solution.attitude
    return Answer(
        None if attitude is None else attitude.rotation, solution.status.value,
        solution.identification.catalog_index,
    )
