"""A tracker that learns its camera: told, told within a tolerance, or not told at all."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.calibration.camera_estimator import (
    MIN_STARS,
    CameraEstimate,
    CameraEstimator,
)
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import LadderStep
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

#: Where the stars of a single frame tell a camera, its focal length is believed this well at
#: least, relative: what the lens bends is not known yet.
_LEAST_DOUBT = 0.005
#: A tracker is made anew where the camera's rays have moved by more than this in the image, px.
_MOVED_PX = 0.25
#: A frame is gone through so often, at the most, while the camera found in it explains more stars.
_ROUNDS = 4
#: After so many frames in a row without a solution a told camera is no longer taken at its word.
_PATIENCE = 10


@dataclass(frozen=True)
class Sources:
    """Where a learning tracker gets its guide stars.

    Attributes:
        database_for: the database that suits a camera.
        ladder: the steps of databases for a camera of any field of view.
    """

    database_for: Callable[[Camera], FeatureDatabase]
    ladder: Callable[[], Sequence[LadderStep]]


@dataclass
class _Belief:
    """A camera that is worked with, its tracker, and what frames have told about it."""

    camera: Camera
    tracker: StarTracker
    learns: bool
    estimator: CameraEstimator | None
    n_unsolved: int = 0


class LearningTracker:
    """Identifies frames of one camera and keeps what they tell about it for the next ones.

    A camera with a tolerance, and one that was found, is refined over the frames (focal length and
    lens). Where its stars are no longer those of the sky, or a frame
    cannot be solved, all fields of view are searched: a zoom or another lens is found again.

    Args:
        sources: where the guide stars come from.
        camera: the camera as told; None where its field of view is not known. Without a tolerance
            it is taken at its word, and nothing is learnt.
        settings: tolerances, thresholds and limits.
        parity: where the camera is not told.

    Attributes:
        camera: as believed now, None where none was found yet.
        news: sentences about what was found since it was last emptied, for a log.
    """

    def __init__(
        self, sources: Sources, camera: Camera | None, settings: SolveSettings | None = None, *,
        parity: str = "auto",
    ) -> None:
        self.settings = settings or SolveSettings()
        self._sources, self._parity = sources, parity if camera is None else camera.parity
        self._told = camera
        self._ladder: AnyCameraTracker | None = None
        self.news: list[str] = []
        self._belief = None if camera is None else self._trust(camera)

    @property
    def camera(self) -> Camera | None:
        """The camera as it is believed now."""
        return None if self._belief is None else self._belief.camera

    @property
    def estimate(self) -> CameraEstimate | None:
        """What frames have told about the camera, None where nothing was learnt."""
        if self._belief is None or self._belief.estimator is None:
            return None
        return self._belief.estimator.estimate

    def forget(self) -> None:
        """Begin anew with the camera as told."""
        self._belief = None if self._told is None else self._trust(self._told)

    def solve(
        self,
        xy_px: ArrayLike,
        intensity: ArrayLike | None = None,
        *,
        predicted: Solution | Floats | None = None,
        deadline_ms: float | None = None,
    ) -> Solution:
        """Identify centroids (n, 2), pixels; see `StarTracker.solve`."""
        started_s = time.perf_counter()
        deadline_ms = self.settings.deadline_ms if deadline_ms is None else deadline_ms
        solution = None
        if self._belief is not None:
            solution = self._belief.tracker.solve(
                xy_px, intensity, predicted=predicted,
                deadline_ms=self._share(self._belief) * deadline_ms,
            )
            if solution.status is Status.SOLVED:
                self._learn(self._belief, solution, xy_px)
                return solution
            if not self._may_search(self._belief, solution):
                return solution
        left_ms = deadline_ms - 1e3 * (time.perf_counter() - started_s)
        if left_ms <= 0 and solution is not None:
            return solution
        found = self._any_camera().solve(xy_px, intensity, deadline_ms=max(left_ms, 1.0))
        if found.status is Status.SOLVED:
            return self._adopt(found, xy_px, intensity)
        return solution or found

    def _share(self, belief: _Belief) -> float:
        """Return the share of a deadline that the believed camera has for itself."""
        return 0.5 if belief.learns else 1.0

    def _may_search(self, belief: _Belief, solution: Solution) -> bool:
        """Return whether an unsolved frame may be searched under all fields of view."""
        if solution.status not in (Status.NO_MATCH, Status.TIMEOUT):
            return False
        belief.n_unsolved += 1
        if not belief.learns:
            return False
        return self._told is None or belief.n_unsolved >= _PATIENCE

    def _any_camera(self) -> AnyCameraTracker:
        if self._ladder is None:
            self._ladder = AnyCameraTracker(
                self._sources.ladder(), self.settings, parity=self._parity
            )
        return self._ladder

    def _trust(self, camera: Camera) -> _Belief:
        """Work with a camera from now on."""
        tracker = StarTracker(self._sources.database_for(camera), camera, self.settings)
        learns, estimator = camera.tolerance_percent > 0, None
        if learns and camera.parity != "auto":  # else the first frame settles the parity
            estimator = CameraEstimator(camera, camera.tolerance_percent / 100)
        return _Belief(camera, tracker, learns, estimator)

    def _adopt(
        self, solution: Solution, xy_px: ArrayLike, intensity: ArrayLike | None
    ) -> Solution:
        """Believe in the camera of a frame solved under any; return the frame's best solution."""
        camera = _believed(solution)
        told = "" if self._belief is None else (
            f" instead of {self._belief.camera.fov_deg:.4g} deg: correct fov_deg, or the lens "
            "has changed"
        )
        self._belief = self._trust(camera)
        self.news.append(
            f"camera found: field of view {camera.fov_deg:.4g} deg over {camera.width_px} px, "
            f"parity {camera.parity}, from {len(solution.identification.identified)} stars{told}"
        )
        best = solution
        for _ in range(_ROUNDS):  # a lens that bends shows more of its stars once it is known
            self._learn(self._belief, best, xy_px, at_once=True)
            again = self._belief.tracker.solve(xy_px, intensity, predicted=best)
            more = len(again.identification.identified) - len(best.identification.identified)
            if again.status is not Status.SOLVED or more < 0:
                break
            best = again
            if more == 0:
                break
        return replace(best, solve_ms=solution.solve_ms)

    def _learn(
        self, belief: _Belief, solution: Solution, xy_px: ArrayLike, *, at_once: bool = False
    ) -> None:
        """Take in what a solved frame tells about the camera."""
        belief.n_unsolved = 0
        if not belief.learns or solution.catalog is None:
            return
        if belief.camera.parity == "auto":  # the parity is settled by the first frame
            self._belief = belief = self._trust(_believed(solution))
        estimator = belief.estimator
        which = solution.identification.identified
        if estimator is None or len(which) < MIN_STARS:
            return
        index = solution.identification.catalog_index[which]
        estimator.add(np.asarray(xy_px, float)[which], solution.catalog.vectors[index])
        if estimator.optics_changed:
            self.news.append(
                "the camera is no longer the one that was found: it is looked for again"
            )
            self._belief = None
            return
        n = estimator.estimate.n_frames
        if (at_once or n <= 10 or n % 10 == 0) and _moved_px(
            belief.tracker.camera, estimator.estimate.camera
        ) > _MOVED_PX:
            belief.camera = estimator.estimate.camera
            belief.tracker = StarTracker(
                belief.tracker.database, belief.camera, self.settings
            )


def _believed(solution: Solution) -> Camera:
    """Return the camera of a solution with the tolerance that its own stars leave."""
    camera = solution.camera
    if camera is None:
        raise ValueError("an unsolved frame tells no camera")
    doubt = max(3 * solution.focal_length_error, _LEAST_DOUBT)
    return replace(camera, tolerance_percent=100 * min(doubt, 0.1))


def _moved_px(before: Camera, after: Camera) -> float:
    """Return how far apart two cameras put the rays of the border and the middle of the image."""
    w, h = before.width_px, before.height_px
    points = np.array([
        (x, y) for x in (0.1 * w, 0.5 * w, 0.9 * w) for y in (0.1 * h, 0.5 * h, 0.9 * h)
    ])
    moved = after.pixels(before.vectors(points)) - points
    return float(np.max(np.hypot(moved[:, 0], moved[:, 1])))
