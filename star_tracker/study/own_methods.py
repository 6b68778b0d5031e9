"""Our own methods as contestants."""

from dataclasses import dataclass, replace
from functools import cache

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.database import MAX_PATTERN_STARS, FeatureDatabase
from star_tracker.catalogue.ladder import LadderStep, ladder
from star_tracker.identification.searcher import METHODS
from star_tracker.maps.simulation import Condition
from star_tracker.optics.camera import MOST_TOLERANCE_PERCENT
from star_tracker.solution import Solution, SolveSettings
from star_tracker.study.contestants import Answer, Contestant, Entrant, Told
from star_tracker.study.scenes import Sky
from star_tracker.tracker import StarTracker


@dataclass(frozen=True)
class OwnMethod(Contestant):
    """A method of this package with its default settings: `match_group`, `radial_cyclic`, `auto`.

    A field of view that may be wrong is told with its tolerance, as a user would. Raises
    ValueError for a method that does not exist.
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

    def declines(self, condition: Condition) -> str:
        """Return why it cannot take part under a condition; empty where it can."""
        return "" if self.finds_camera else super().declines(condition)

    @property
    def finds_camera(self) -> bool:
        """Whether it can find out a field of view that is not told."""
        return self.method != METHODS[1]

    def set_up(self, told: Told) -> Entrant:
        """Make it ready for a camera."""
        if self.finds_camera and told.fov_tolerance_percent > MOST_TOLERANCE_PERCENT:
            return self._for_any_camera(told)
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
        tolerance = told.fov_tolerance_percent if self.finds_camera else 0.0
        camera = replace(told.camera, tolerance_percent=tolerance)
        return StarTracker(database, camera, settings)

    def any_camera_tracker(self, told: Told) -> AnyCameraTracker:
        """Return the tracker that is measured where the field of view may be any of a range."""
        camera = told.camera
        steps = _ladder(told.fov_range_deg, (camera.width_px, camera.height_px), told.sky)
        settings = SolveSettings(method=METHODS[0], deadline_ms=told.deadline_ms)
        return AnyCameraTracker(steps, settings, parity=camera.parity)

    def _for_any_camera(self, told: Told) -> Entrant:
        """Make it ready for a camera of a wide range, or any, field of view."""
        tracker = self.any_camera_tracker(told)
        return Entrant(
            lambda scene: (scene.xy_px, scene.intensity if self.brightness else None),
            lambda given: tracker.solve(*given),
            # Its numbers are those of the catalogue of a step, not of the sky's.
            lambda solution: replace(_answer(solution), catalog_index=None),
            sum(step.database.nbytes for step in tracker.steps),
        )

    def _storage_bytes(self, database: FeatureDatabase) -> int:
        size = 0 if self.method == METHODS[1] else database.pairs.nbytes
        if self.method == METHODS[0] or len(database.catalog) > MAX_PATTERN_STARS:
            return size
        return size + database.patterns.packed.nbytes


@cache
def _ladder(
    fov_range_deg: tuple[float, float], size_px: tuple[int, int], sky: Sky
) -> tuple[LadderStep, ...]:
    """Return the databases for a range of fields of view, once in each process."""
    catalog = "paper" if sky.limiting_magnitude is None else "hipparcos"
    return ladder(fov_range_deg, size_px, catalog=catalog)


def _answer(solution: Solution) -> Answer:
    attitude = solution.attitude
    index = solution.identification.catalog_index
    if attitude is None:
        return Answer(None, solution.status.value, index)
    return Answer(attitude.rotation, solution.status.value, index, attitude.covariance_rad2)
