"""The whole path: centroids -> vectors -> candidates -> verified identification -> attitude."""

import time
from collections.abc import Iterator
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import Floats
from star_tracker.identification import fallback as radial_cyclic
from star_tracker.identification.evidence import evidence
from star_tracker.identification.field import StarField, Step
from star_tracker.identification.judge import Sky, verify
from star_tracker.identification.labels import Identification
from star_tracker.identification.path import (
    BEGIN,
    COVARIANCE,
    GO_ON,
    LABEL,
    LENS,
    LOST_IN_SPACE,
    MIN_STARS,
    NO_ROTATION,
    NUMBERS,
    RMS,
    SOLVED,
    TOO_FEW,
    TOO_MANY,
    TRACK,
    TRACKING,
    USABLE,
    FrameResult,
    Search,
    follow,
)
from star_tracker.identification.search import MORE, Progress, keep
from star_tracker.identification.votes import vote_counts
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import NOT_INVERTIBLE
from star_tracker.solution import METHODS, Solution, SolveSettings, Status

#: Decades of evidence that end the search at once, where half of the centroids are matched (else
#: it takes twice as many: a cluster can carry a pose whose roll is off). Weaker evidence that is
#: enough has to be better than that of the next so many candidates: a few true stars among 40 can
#: carry a pose that is off by half a degree. And the sky's mirror image must not fit better: a
#: real sky seen in a mirror has look-alikes along lines of stars (benchmark/wrong_solutions.py).
_CERTAIN = 8.0
_SECOND_LOOK = 10.0
#: Where the parity is known the other one has to fit better by more than rounding to raise doubt.
#: Where it is not, a solution that is not certain needs this lead over the other
#: parity's; in any case over other poses of its own.
_MIRROR_LEAD = 0.01
_PARITY_LEAD = 4.0
_POSE_LEAD = 1.0
#: Work, in votes, between two looks at the clock: less than 0.1 ms.
_WORK = 20_000.0
#: With method auto, the share of the deadline after which the primary makes way for the fallback.
_PRIMARY_SHARE = 0.5
_UNKNOWN = np.empty(0)


class StarTracker:
    """Identifies the stars of single frames, lost in space, for one camera and database.

    A tracker uses its memory again for each frame: each thread needs one of its own. They can
    share a database. The first one made in a process compiles the path or loads it from the cache
    (`compiled.py`).

    Args:
        database: guide stars and their features.
        camera: the camera; its parity may be `auto`.
        settings: tolerances, thresholds and limits.

    Raises ValueError where the camera's distortion cannot be inverted over the image, the
    catalogue is too dense for the fallback or its ring factors do not divide the rings.
    """

    def __init__(
        self, database: FeatureDatabase, camera: Camera, settings: SolveSettings | None = None
    ) -> None:
        self.database = database
        self.camera = camera
        self.settings = s = settings or SolveSettings()
        self._methods = METHODS if s.method == "auto" else (s.method,)
        # Refuses what cannot work before any frame comes, and builds the fallback's patterns.
        radius = camera.radius_rad
        if "radial_cyclic" in self._methods:
            for factor in s.radial_cyclic.ring_factors:
                database.patterns.level(factor)
            _ = database.pattern_pairs
        # The parity that is asked for comes first, its mirror image second.
        parities = camera.definite()
        if len(parities) == 1:
            parities += (camera.with_parity(
                "normal" if camera.parity == "mirrored" else "mirrored"
            ),)
        self._searches = [Search(one, one.optics, Progress.blank()) for one in parities]
        n, pairs = len(database.catalog), database.pairs
        self._evidence = evidence(n + s.max_centroids, s.centroid_sigma_px)
        enough = -s.max_log10_false_alarms
        self._limits = np.array([
            max(_CERTAIN, enough), enough, _SECOND_LOOK, s.match_group.cells, _WORK,
            s.displaced_gate_px, s.max_centroids, radius, pairs.max_separation_rad,
            self._evidence.freedom, self._evidence.scale_px2, s.match_group.voting == "plain",
        ])
        primary = METHODS[0] in self._methods
        levels = s.match_group.levels if primary else np.empty((0, 4))
        self._fixed = (
            np.ascontiguousarray(database.catalog.v_mag, float), *database.sky_index,
            *pairs[:-1], self._evidence.log_factorial, *vote_counts(n),
            np.empty(n, np.int64), np.empty((n, 3)), np.empty(n, np.int64), levels, self._limits,
        )
        self.solve(np.zeros((0, 2)))  # compiles

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
        if lost in space. Centroids that are not finite or lie outside of the image are left out
        and counted. A deadline, ms, holds for this frame instead of that of the settings. Raises
        ValueError only for an array of another shape, and a deadline that is not above 0.
        """
        started = time.perf_counter()
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
        frame = FrameResult(
            xy, brightness,
            Identification(np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n)),
            np.empty(NUMBERS), started, deadline_ms,
        )
        first = self._searches[0]
        if predicted is not None and self._track(frame, predicted):
            return _solved(frame, first, 0)
        self._run(first, frame, BEGIN)
        if first.code == SOLVED:  # nearly every frame
            return _solved(frame, first, first.n_hypotheses)
        return self._refused(frame, first.code) or self._persist(frame)

    def _track(self, frame: FrameResult, predicted: Solution | Floats) -> bool:
        """Try a predicted attitude; return whether it has solved the frame."""
        if isinstance(predicted, Solution):
            if predicted.attitude is None:
                return False
            predicted = predicted.attitude.rotation
        rotation = np.asarray(predicted, float)
        if rotation.shape != (3, 3):
            raise ValueError(f"the predicted rotation has shape {rotation.shape}, not (3, 3)")
        if self.camera.parity == "auto" or self._methods[0] != METHODS[0]:
            return False
        first = self._searches[0]
        first.progress.rotation[:] = rotation
        self._run(first, frame, TRACK)
        if first.code == NO_ROTATION:
            raise ValueError("the predicted attitude is no rotation: R^T R = 1, determinant +1")
        return first.code == SOLVED

    def _run(self, search: Search, frame: FrameResult, action: int) -> None:
        """Take the compiled path one step farther."""
        i = frame.identification
        if action in (BEGIN, TRACK):
            search.method = METHODS[0]
            search.mode = TRACKING if action == TRACK else LOST_IN_SPACE
        search.code = follow(
            frame.xy_px, frame.intensity, search.optics, *self._fixed, *search.progress,
            i.catalog_index, i.state, i.residual_px, frame.numbers, action,
        )

    def _refused(self, frame: FrameResult, code: int) -> Solution | None:
        """Return the solution of a frame that cannot be searched, None for one that can."""
        n, most = int(frame.numbers[USABLE]), self.settings.max_centroids
        if code == LENS:
            return _unsolved(frame, Status.BAD_INPUT, NOT_INVERTIBLE)
        if code == TOO_MANY:
            return _unsolved(
                frame, Status.BAD_INPUT, f"{n} centroids are more than max_centroids {most}: "
                "raise the detector's threshold",
            )
        if code != TOO_FEW:
            return None
        if len(frame.xy_px) > 0 and n == 0:
            return _unsolved(
                frame, Status.BAD_INPUT,
                f"all {len(frame.xy_px)} centroids are non-finite or outside of the "
                f"{self.camera.width_px} x {self.camera.height_px} px image: "
                "check the camera's size and the detector",
            )
        return _unsolved(
            frame, Status.TOO_FEW_STARS, f"{n} stars, at least {MIN_STARS} are needed"
        )

    def _persist(self, frame: FrameResult) -> Solution:
        """Search on, under both parities where that is asked for, then with the fallback."""
        asked = self._searches[: 2 if self.camera.parity == "auto" else 1]
        deadline = frame.started + frame.deadline_ms / 1e3
        n_hypotheses = self._search_on(asked, frame, deadline) + _compared(asked)
        for one in asked:
            if one.code == SOLVED:
                return _solved(frame, one, n_hypotheses)
        best = max(asked, key=lambda one: one.score)
        in_time = all(one.code != MORE for one in asked)
        found = f"the best of {n_hypotheses} hypotheses has log10 false alarms {-best.score:.1f}"
        status, reason = Status.NO_MATCH, found
        if best.score > self._limits[0]:  # found by the fallback
            status, in_time = Status.SOLVED, True
        elif best.score > self._limits[1]:
            status, reason = self._doubt(best, asked, frame, deadline)
            in_time = in_time and status is not Status.TIMEOUT
        if not in_time:
            status = Status.TIMEOUT
            reason = f"deadline {frame.deadline_ms:g} ms passed, {found}"
        if status is not Status.SOLVED:
            return _unsolved(frame, status, reason, best.score, n_hypotheses)
        self._run(best, frame, LABEL)
        return _solved(frame, best, n_hypotheses)

    def _search_on(self, asked: list[Search], frame: FrameResult, deadline: float) -> int:
        """Let the primary go on, the fallback have its turn, and the primary what time is left.

        Ends where something is solved. Returns the hypotheses that the fallback has compared.
        """
        for other in asked[1:]:
            self._run(other, frame, BEGIN)
            if other.code == SOLVED:
                return 0
        if self._methods[-1] == METHODS[0]:
            self._exhaust(asked, frame, deadline)
            return 0
        share = _PRIMARY_SHARE * frame.deadline_ms / 1e3
        self._exhaust(asked, frame, frame.started + share)
        n_fallback = 0
        if max(one.score for one in asked) <= self._limits[1]:
            n_fallback = self._fall_back(asked, frame, deadline)
        unsolved = max(one.score for one in asked) <= self._limits[0]
        if unsolved and time.perf_counter() < deadline:
            self._exhaust(asked, frame, deadline)
        return n_fallback

    def _exhaust(self, searches: list[Search], frame: FrameResult, deadline: float) -> None:
        """Go on in turn until a search has solved the frame, all have ended or time is up.

        Those that time has stopped keep the code MORE.
        """
        while any(one.code == MORE for one in searches):
            for one in searches:
                if one.code == MORE:
                    self._run(one, frame, GO_ON)
                if one.code == SOLVED or time.perf_counter() > deadline:
                    return

    def _doubt(
        self, best: Search, asked: list[Search], frame: FrameResult, deadline: float
    ) -> tuple[Status, str]:
        """Hold a pose that is good enough, but not certain, against its rivals."""
        other = self._searches[1 - self._searches.index(best)]
        if other not in asked:
            self._run(other, frame, BEGIN)
            self._exhaust([other], frame, deadline)
            if other.code == MORE:
                return Status.TIMEOUT, ""
        if len(asked) == 2 and other.score > best.score - _PARITY_LEAD:
            return Status.AMBIGUOUS, (
                "the sky and its mirror image fit about as well: set parity to normal or mirrored"
            )
        if other.score > best.score + _MIRROR_LEAD:
            return Status.AMBIGUOUS, (
                f"the mirror image of the sky fits better: set parity to {other.camera.parity}"
            )
        if best.progress.score[1] > best.score - _POSE_LEAD:
            return Status.AMBIGUOUS, "two attitudes fit about as well"
        return Status.SOLVED, ""

    def _fall_back(
        self, asked: list[Search], frame: FrameResult, deadline: float
    ) -> int:
        """Judge the candidates of the fallback; return how many hypotheses were compared."""
        n_compared = [0] * len(asked)
        fields = [
            StarField.from_pixels(one.camera, frame.xy_px, frame.intensity) for one in asked
        ]
        for at, (n, candidate) in self._candidates(fields):
            one, n_compared[at] = asked[at], n
            if candidate is not None:
                verified = verify(self._sky(one), fields[at], candidate)
                if verified is not None:
                    before = one.score
                    score = -verified.log10_false_alarms
                    keep(one.progress, score, 0, verified.tolerance_px, verified.rotation)
                    if one.score > before:
                        one.method = METHODS[1]
                    if score > self._limits[0]:
                        break
            if time.perf_counter() > deadline:
                one.code = MORE
                break
        return sum(n_compared)

    def _candidates(self, fields: list[StarField]) -> Iterator[tuple[int, Step]]:
        """Yield (place of the field, step of the fallback), the fields in turn."""
        sources = [
            radial_cyclic.candidates(self.database, one, self.settings.radial_cyclic)
            for one in fields
        ]
        for steps in zip_longest(*sources):
            yield from ((at, step) for at, step in enumerate(steps) if step is not None)

    def _sky(self, search: Search) -> Sky:
        """Return the guide stars as a search's camera sees them."""
        return Sky(
            self.database.sky_index, self._fixed[0], search.optics, self.camera.radius_rad,
            self._evidence,
        )


def _compared(searches: list[Search]) -> int:
    return sum(one.n_hypotheses for one in searches)


def _solved(frame: FrameResult, search: Search, n_hypotheses: int) -> Solution:
    """Return the solution of a labelled frame."""
    v = frame.numbers
    attitude = Attitude(v[:4], v[COVARIANCE:RMS].reshape(3, 3), *v[4:COVARIANCE].tolist())
    return Solution(
        Status.SOLVED, "identified", frame.identification, attitude, search.method,
        search.camera.parity, search.wrong_probability, -search.score, float(v[RMS]),
        n_hypotheses, frame.n_ignored, frame.elapsed_ms, search.mode,
    )


def _unsolved(
    frame: FrameResult, status: Status, reason: str, score: float = -np.inf, n_hypotheses: int = 0
) -> Solution:
    """Return the solution of a frame that has none."""
    return Solution(
        status, reason, Identification.empty(len(frame.xy_px)), log10_false_alarms=-score,
        n_hypotheses=n_hypotheses, n_ignored=frame.n_ignored, solve_ms=frame.elapsed_ms,
    )
