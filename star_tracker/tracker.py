"""The whole path: centroids -> vectors -> candidates -> verified identification -> attitude."""

import time
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.triangles import TriangleTable
from star_tracker.geometry.spherical import Floats
from star_tracker.identification import fallback, plan
from star_tracker.identification.ended import MIN_STARS, Ended
from star_tracker.identification.engine import (
    Results,
    Sizes,
    make_engine,
    make_scratch,
)
from star_tracker.identification.escalation import Candidates, Escalation, Verdict
from star_tracker.identification.evidence import evidence, scale_prior
from star_tracker.identification.judge import View
from star_tracker.identification.labels import LABEL, Identification
from star_tracker.identification.search import Limits
from star_tracker.identification.searcher import METHODS, Searcher, Task
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status, frozen

#: Decades of evidence that end the search at once, where half of the centroids are matched (else
#: it takes twice as many: a cluster can carry a pose whose roll is off). Weaker evidence that is
#: enough has to be better than that of the next so many candidates: a few true stars among 40 can
#: carry a pose that is off by half a degree. And the sky's mirror image must not fit better: a
#: real sky seen in a mirror has look-alikes along lines of stars (benchmark/wrong_solutions.py).
_CERTAIN = 8.0
_SECOND_LOOK = 10.0
#: Work, in votes, between two looks at the clock: less than 1 ms.
_WORK = 20_000.0
_UNKNOWN = np.empty(0)
_STATUS = {
    Ended.EXHAUSTED: Status.NO_MATCH, Ended.AMBIGUOUS: Status.AMBIGUOUS,
    Ended.MORE: Status.TIMEOUT,
}


class StarTracker:
    """Identifies the stars of single frames, lost in space, for one camera and database.

    A tracker uses its memory again for each frame: each thread needs one of its own. They can
    share a database. The first one made in a process compiles the path or loads it from the cache
    (`compiled.py`).

    Args:
        database: guide stars and their features.
        camera: the camera; its parity may be `auto`.
        settings: tolerances, thresholds and limits.
        candidates: a second matcher in place of the package's own fallback: a function that
            yields candidates for a field (`fallback.candidates`), as studies compare them.

    Raises ValueError where the camera's distortion cannot be inverted over the image, the
    catalogue is too dense for the fallback or its ring factors do not divide the rings.
    """

    def __init__(
        self, database: FeatureDatabase, camera: Camera, settings: SolveSettings | None = None,
        *, candidates: Candidates | None = None,
    ) -> None:
        self.database = database
        self.camera = camera
        self.settings = settings or SolveSettings()
        method = self.settings.method
        self._primary = method != METHODS[1]
        # Refuses what cannot work before any frame comes, and builds the fallback's patterns.
        if method != METHODS[0] and candidates is None:
            candidates = partial(
                fallback.candidates, database, settings=self.settings.radial_cyclic
            )
            for factor in self.settings.radial_cyclic.ring_factors:
                database.patterns.level(factor)
            _ = database.pattern_pairs
        enough = -self.settings.max_log10_false_alarms
        limits = Limits(
            max(_CERTAIN, enough), enough, _SECOND_LOOK, _WORK, self.settings.displaced_gate_px
        )
        searchers = self._searchers(limits)
        self._first = searchers[0]
        self._escalation = Escalation(
            searchers, limits, both=camera.parity == "auto", fallback=candidates,
            primary=self._primary,
        )
        self.solve(np.zeros((0, 2)))  # compiles what nearly every frame needs

    def solve(
        self,
        xy_px: ArrayLike,
        intensity: ArrayLike | None = None,
        *,
        predicted: Solution | Floats | None = None,
        deadline_ms: float | None = None,
    ) -> Solution:
        """Identify centroids (n, 2), pixels, and determine the attitude.

        Their intensities (n,), larger = brighter, on any linear scale, are of use but not needed;
        one that is not positive counts as unknown. A predicted attitude, a rotation (3, 3) camera
        to ICRS or an earlier solution, is tried first (where the parity is known): what comes of
        it is held to the same evidence as anything else, and where it fails the search starts as
        if lost in space. Centroids that are not finite, lie outside of the image or have no ray of
        the lens are left out and counted. A deadline, ms, holds for this frame instead of that of
        the settings. Raises ValueError only for an array of another shape, and a deadline that is
        not above 0.
        """
        task = self._task(xy_px, intensity, deadline_ms)
        first = self._first
        if predicted is not None and self._track(task, predicted):
            return _solved(task, first, 0)
        first.follow(task)
        if first.ended == Ended.SOLVED:  # nearly every frame
            return _solved(task, first, first.n_hypotheses)
        if first.ended in (Ended.TOO_FEW, Ended.TOO_MANY):
            return self._refused(task, first.ended)
        verdict = self._escalation.run(task)
        if verdict.ended == Ended.SOLVED:
            return _solved(task, verdict.best, verdict.n_hypotheses)
        return self._unsolved(task, _STATUS[verdict.ended], verdict.reason, verdict)

    def _searchers(self, limits: Limits) -> list[Searcher]:
        """Make a searcher for each parity: that which is asked for, and its mirror image."""
        s, database, camera = self.settings, self.database, self.camera
        cameras = camera.definite()
        if len(cameras) == 1:
            mirror = "normal" if camera.parity == "mirrored" else "mirrored"
            cameras += (camera.with_parity(mirror),)
        n = len(database.catalog)
        prior = scale_prior(camera.tolerance_percent)
        levels = plan.levels(s.match_group, prior)[: None if self._primary else 0]
        shapes = database.triangles if np.any(levels["by_shape"]) else TriangleTable.empty()
        companions = max(levels["companions"], default=1)
        sizes = Sizes(n, s.max_centroids, int(companions), max(levels["cells"], default=1))
        scratch = make_scratch(sizes)
        known = evidence(n + s.max_centroids, s.centroid_sigma_px)
        v_mag = np.ascontiguousarray(database.catalog.v_mag, float)
        searchers = []
        for one in cameras:
            view = View(
                database.sky_index, v_mag, one.optics, one.focal_length_px, camera.radius_rad,
                known, prior,
            )
            results = Results.blank(s.max_centroids)
            engine = make_engine(
                view, database.pairs, shapes, (levels, limits), scratch, results
            )
            searchers.append(Searcher(one, engine, results))
        return searchers

    def _task(
        self, xy_px: ArrayLike, intensity: ArrayLike | None, deadline_ms: float | None
    ) -> Task:
        """Check what came; return it with room for its labels."""
        started_s = time.perf_counter()
        xy = np.asarray(xy_px, np.float64, order="C")
        if xy.ndim != 2 or xy.shape[1] != 2:
            raise ValueError(f"centroids have shape {xy.shape}: give an array (n, 2) of x, y")
        if deadline_ms is None:
            deadline_ms = self.settings.deadline_ms
        elif not deadline_ms > 0:
            raise ValueError(f"deadline_ms is {deadline_ms}: it must be greater than 0")
        n = len(xy)
        brightness = _UNKNOWN
        if intensity is not None:
            brightness = np.asarray(intensity, np.float64, order="C")
            if brightness.shape != (n,):
                raise ValueError(
                    f"intensities have shape {brightness.shape}: "
                    f"give one for each of {n} centroids"
                )
        return Task(xy, brightness, np.empty(n, LABEL), started_s, deadline_ms)

    def _track(self, task: Task, predicted: Solution | Floats) -> bool:
        """Try a predicted attitude; return whether it has solved the frame."""
        if isinstance(predicted, Solution):
            if predicted.attitude is None:
                return False
            predicted = predicted.attitude.rotation
        rotation = np.asarray(predicted, float)
        if rotation.shape != (3, 3):
            raise ValueError(f"the predicted rotation has shape {rotation.shape}, not (3, 3)")
        if self.camera.parity == "auto" or not self._primary:
            return False
        self._first.track(task, rotation)
        if self._first.ended == Ended.NO_ROTATION:
            raise ValueError("the predicted attitude is no rotation: R^T R = 1, determinant +1")
        return self._first.ended == Ended.SOLVED

    def _refused(self, task: Task, ended: Ended) -> Solution:
        """Return the solution of a frame that cannot be searched."""
        n, n_given, most = self._first.n_usable, len(task.xy_px), self.settings.max_centroids
        status = Status.BAD_INPUT
        if ended == Ended.TOO_MANY:
            reason = (
                f"{n} centroids are more than max_centroids {most}: raise the detector's threshold"
            )
        elif n_given > 0 and n == 0:
            reason = (
                f"all {n_given} centroids are non-finite or outside of the "
                f"{self.camera.width_px} x {self.camera.height_px} px image: "
                "check the camera's size and the detector"
            )
        else:
            status = Status.TOO_FEW_STARS
            reason = f"{n} stars, at least {MIN_STARS} are needed"
        return self._unsolved(task, status, reason)

    def _unsolved(
        self, task: Task, status: Status, reason: str, verdict: Verdict | None = None
    ) -> Solution:
        """Return the solution of a frame that has none."""
        return Solution(
            status, reason, Identification.empty(len(task.xy_px)),
            log10_false_alarms=float("inf") if verdict is None else -verdict.best.score,
            n_hypotheses=0 if verdict is None else verdict.n_hypotheses,
            n_ignored=len(task.xy_px) - self._first.n_usable, solve_ms=task.elapsed_ms,
        )


def _solved(task: Task, searcher: Searcher, n_hypotheses: int) -> Solution:
    """Return the solution of a labelled frame."""
    labels, results = task.labels, searcher.results
    n_usable, ra, dec, roll, rms_px, *_ = results.outcome.item()
    return frozen(
        Solution, status=Status.SOLVED, reason="identified",
        identification=frozen(
            Identification, catalog_index=labels["catalog_index"], state=labels["state"],
            residual_px=labels["residual_px"],
        ),
        attitude=frozen(
            Attitude, quaternion_xyzw=results.quaternion.copy(),
            covariance_rad2=results.covariance.copy(), ra_rad=ra, dec_rad=dec, roll_rad=roll,
        ),
        method=searcher.method, parity=searcher.camera.parity,
        wrong_probability=searcher.wrong_probability, log10_false_alarms=-searcher.score,
        rms_px=rms_px, n_hypotheses=n_hypotheses, n_ignored=len(labels) - n_usable,
        solve_ms=task.elapsed_ms, mode=searcher.mode,
    )
