"""A tracker that learns its camera: told, told within a tolerance, or not told at all."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.calibration.belief import Belief, believed, moved_px
from star_tracker.calibration.camera_estimator import (
    MIN_STARS,
    CameraEstimate,
    CameraEstimator,
)
from star_tracker.calibration.noise import StreamNoise
from star_tracker.calibration.second_opinion import (
    BY_PARAMETERS,
    SecondOpinion,
    ToldBy,
    is_doubtful,
)
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import LadderStep
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.searcher import METHODS
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

#: A tracker is made anew where the camera's rays have moved by more than this in the image, px.
_MOVED_PX = 0.25
#: Or where the focal length may be off by less than this part of what it might be before: each
#: scale that need not be searched leaves more of the evidence to frames of few stars.
_SURER = 0.5
#: A frame is gone through so often, at the most, while the camera found in it explains more stars.
_ROUNDS = 4
#: After so many frames in a row without a solution a told camera is no longer believed; and each
#: time that so many more have gone by, one is worth a longer search.
_PATIENCE = 10
#: The first frames in a row without a good solution are looked at, for what would help.
_FIRST_LOOKS = 2
#: The share of a deadline that the believed camera has where another search may follow.
_SHARE = 0.5


@dataclass(frozen=True)
class Sources:
    """Where a learning tracker gets its guide stars.

    Attributes:
        database_for: the database that suits a camera.
        ladder: the steps of databases for a camera of any field of view.
    """

    database_for: Callable[[Camera], FeatureDatabase]
    ladder: Callable[[], Sequence[LadderStep]]


@dataclass(frozen=True)
class Learnt:
    """What a tracker has learnt.

    Attributes:
        belief: the camera, None where it is as told.
        noise: of the centroids, and the share of false stars.
        centroid_sigma_px: what was told of the noise, 0 = nothing.
        n_doubtful: frames in a row without a good solution.
    """

    belief: Belief | None
    noise: StreamNoise
    centroid_sigma_px: float
    n_doubtful: int


class LearningTracker:
    """Identifies frames of one camera and keeps what they tell about it for the next ones.

    A camera with a tolerance, and one that was found, is refined over the frames (focal length and
    lens). Where its stars are no longer those of the sky, or a frame
    cannot be solved, all fields of view are searched: a zoom or another lens is found again.
    The noise of the centroids and the share of false stars are learnt of any camera, and used for
    the frames that follow.

    Args:
        sources: where the guide stars come from.
        camera: the camera as told; None where its field of view is not known. Without a tolerance
            it is taken at its word, nothing is learnt, and `hint` says where the stars disagree.
        settings: tolerances, thresholds and limits.
        parity: where the camera is not told.
        told_by: what hints call the field of view.

    Raises ValueError for method `radial_cyclic` without a camera, and as `StarTracker`.

    Attributes:
        camera: as believed now, None where none was found yet.
        news: sentences about what was found since it was last emptied, for a log.
        hint: what would solve the last frame, or solve it better; empty where that is not known.
        noise: what frames have taught of the centroids.
    """

    def __init__(
        self, sources: Sources, camera: Camera | None, settings: SolveSettings | None = None, *,
        parity: str = "auto", told_by: ToldBy = BY_PARAMETERS,
    ) -> None:
        self.settings = settings or SolveSettings()
        if camera is None and self.settings.method == METHODS[1]:
            raise ValueError(
                f"method {METHODS[1]} cannot find out a field of view: tell it, or set method to "
                "auto"
            )
        self._sources, self._parity = sources, parity if camera is None else camera.parity
        self._told, self._told_by = camera, told_by
        self._ladder: AnyCameraTracker | None = None
        self.news: list[str] = []
        self.hint = ""
        self.noise = StreamNoise(self.settings.centroid_sigma_px)
        self._n_doubtful = 0
        self._belief = None if camera is None else self._trust(camera)
        if camera is None:
            self._any_camera()  # takes a second, while no frame waits

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

    @property
    def has_learnt(self) -> bool:
        """Whether the camera is another one than was told."""
        return self.camera is not None and self.camera != self._told

    @property
    def learnt(self) -> "Learnt":
        """What was learnt so far, for another tracker of the same camera."""
        return Learnt(
            self._belief if self.has_learnt else None, self.noise,
            self.settings.centroid_sigma_px, self._n_doubtful,
        )

    def go_on_from(self, learnt: "Learnt") -> None:
        """Go on with what another tracker has learnt, of which the same camera was told."""
        self._n_doubtful = learnt.n_doubtful
        if learnt.centroid_sigma_px == self.settings.centroid_sigma_px:
            self.noise = learnt.noise
        if learnt.belief is not None:
            trusted = self._trust(learnt.belief.camera)
            self._belief = replace(
                learnt.belief, tracker=trusted.tracker, second_opinion=None
            )

    def forget(self) -> None:
        """Begin anew with the camera as told."""
        self._belief = None if self._told is None else self._trust(self._told)
        self.noise.forget()

    def solve(
        self,
        xy_px: ArrayLike,
        intensity: ArrayLike | None = None,
        *,
        predicted: Solution | Floats | None = None,
        deadline_ms: float | None = None,
    ) -> Solution:
        """Identify centroids (n, 2), pixels; see `StarTracker.solve`."""
        if deadline_ms is None:
            deadline_ms = self.settings.deadline_ms
        stop_s = time.perf_counter() + deadline_ms / 1e3
        self.hint, belief = "", self._belief
        if belief is None:
            return self._searched(xy_px, intensity, None, stop_s)
        share = _SHARE if belief.learns or self._looks_next else 1.0
        belief.tracker.expect(self.noise.expectation)
        solution = belief.tracker.solve(
            xy_px, intensity, predicted=predicted, deadline_ms=share * deadline_ms
        )
        self._count(solution)
        self.noise.add(solution)
        if solution.status is Status.SOLVED:
            self._learn(belief, solution, xy_px)
        elif belief.learns and self._n_doubtful >= self._patience:
            solution = self._searched(xy_px, intensity, solution, stop_s)
        if self._looks:
            self._ask(belief, xy_px, intensity, solution, stop_s)
        return solution

    @property
    def at_a_loss(self) -> bool:
        """Whether the next frame is worth a longer search: none of the last ones was solved."""
        return self._n_doubtful >= _PATIENCE and (self._n_doubtful + 1) % _PATIENCE == 0

    @property
    def _patience(self) -> int:
        """After how many frames in a row without a solution the camera is looked for anew."""
        return 1 if self._told is None else _PATIENCE

    @property
    def _looks(self) -> bool:
        """Whether it is asked what would help with the last frame."""
        n = self._n_doubtful
        return 0 < n <= _FIRST_LOOKS or (n > 0 and n % _PATIENCE == 0)

    @property
    def _looks_next(self) -> bool:
        """Whether it will be asked for the next frame, if that ends as the last one did."""
        n = self._n_doubtful
        return 0 < n < _FIRST_LOOKS or (n > 0 and (n + 1) % _PATIENCE == 0)

    def _count(self, solution: Solution) -> None:
        if is_doubtful(solution):
            self._n_doubtful += 1
        elif solution.status is Status.SOLVED:
            self._n_doubtful = 0

    def _searched(
        self, xy_px: ArrayLike, intensity: ArrayLike | None, before: Solution | None,
        stop_s: float,
    ) -> Solution:
        """Search all fields of view, in the time that is left after another search."""
        left_ms = 1e3 * (stop_s - time.perf_counter())
        if left_ms <= 0 and before is not None:
            return before
        found = self._any_camera().solve(xy_px, intensity, deadline_ms=max(left_ms, 1.0))
        if before is None:
            self._count(found)
        if found.status is Status.SOLVED:
            self._n_doubtful = 0
            return self._adopt(found, xy_px, intensity)
        return before or found

    def _ask(
        self, belief: Belief, xy_px: ArrayLike, intensity: ArrayLike | None,
        solution: Solution, stop_s: float,
    ) -> None:
        """Ask in the time that is left whether the camera is another one than was told."""
        if self._told is None or (belief.learns and self._parity == "auto"):
            return
        if belief.second_opinion is None:
            belief.second_opinion = SecondOpinion(
                belief.tracker.database, belief.camera, self.settings, told_by=self._told_by
            )
        left_ms = 1e3 * (stop_s - time.perf_counter())
        if left_ms > 0:
            self.hint = belief.second_opinion.hint(xy_px, intensity, solution, left_ms)

    def _any_camera(self) -> AnyCameraTracker:
        if self._ladder is None:
            self._ladder = AnyCameraTracker(
                self._sources.ladder(), self.settings, parity=self._parity
            )
        return self._ladder

    def _trust(self, camera: Camera) -> Belief:
        """Work with a camera from now on."""
        tracker = StarTracker(self._sources.database_for(camera), camera, self.settings)
        learns, estimator = camera.tolerance_percent > 0, None
        if learns and camera.parity != "auto":  # else the first frame settles the parity
            estimator = CameraEstimator(camera, camera.tolerance_percent / 100)
        return Belief(camera, tracker, learns, estimator)

    def _adopt(
        self, solution: Solution, xy_px: ArrayLike, intensity: ArrayLike | None
    ) -> Solution:
        """Believe in the camera of a frame solved under any; return the frame's best solution."""
        camera = believed(solution)
        told = "" if self._belief is None else (
            f" instead of {self._belief.camera.fov_deg:.4g} deg: correct fov_deg, or the lens "
            "has changed"
        )
        self._belief = self._trust(camera)
        self.noise.forget()
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
        self, belief: Belief, solution: Solution, xy_px: ArrayLike, *, at_once: bool = False
    ) -> None:
        """Take in what a solved frame tells about the camera."""
        if not belief.learns or solution.catalog is None:
            return
        if belief.camera.parity == "auto":  # the parity is settled by the first frame
            self._belief = belief = self._trust(believed(solution))
        belief.n_solved += 1
        which = solution.identification.identified
        if belief.estimator is None or len(which) < MIN_STARS:
            return
        if not (at_once or belief.learns_from_it):
            return
        seeds = which, solution.identification.catalog_index[which].astype(np.int64)
        used = belief.estimator.add_frame(
            np.asarray(xy_px, float), solution.catalog.vectors, seeds
        )
        belief.agreed = used is not None
        if belief.estimator.optics_changed:
            self.news.append(
                "the camera is no longer the one that was found: it is looked for again"
            )
            self._belief = None
            self.noise.forget()
            return
        camera, at_work = belief.estimator.estimate.camera, belief.tracker.camera
        surer = camera.tolerance_percent < _SURER * at_work.tolerance_percent
        moved = moved_px(at_work, camera) > _MOVED_PX
        if moved:  # the residuals before had the camera's error in them
            self.noise.forget()
        if surer or moved:
            belief.camera = camera
            belief.tracker = StarTracker(belief.tracker.database, camera, self.settings)
