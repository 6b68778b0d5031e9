"""The whole path: centroids -> vectors -> candidates -> verified identification -> attitude."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from star_tracker import match_group, radial_cyclic
from star_tracker.attitude import Attitude, covariance
from star_tracker.camera import Camera
from star_tracker.database import FeatureDatabase
from star_tracker.field import StarField, Step
from star_tracker.solution import METHODS, MIN_STARS, Solution, SolveSettings, Status
from star_tracker.spherical import Floats
from star_tracker.verification import Identification, Verified, label, verify

#: A hypothesis this good ends the search. A weaker one that can be accepted first has to hold out
#: against this many more: a few true stars among 40 can carry a pose that is off by half a degree.
#: A true sky seen in a mirror reached -3.3 in 400 fields of 12 deg and -5.0 in 400 of 20 deg, so
#: where the parity is not known a weaker one needs a lead over the other parity after a full
#: search of both (benchmark/false_alarms.py).
_CERTAIN = -8.0
_SECOND_LOOK = 10
_AUTO_PARITY_LEAD = 4.0
#: A centroid this far outside of the image (in image sizes) cannot have come from it.
_OUTSIDE_MARGIN = 0.05
#: With method auto, the share of the deadline after which the primary makes way for the fallback.
_PRIMARY_SHARE = 0.5


@dataclass
class _Search:
    """What one matcher's search has found: of each parity the best hypothesis and its score.

    The score is log10 of the false alarms, with all hypotheses charged that were compared before,
    also by the matcher before this one.
    """

    method: str
    earlier: int
    best: list[Verified | None]
    score: list[float]
    n_compared: list[int]
    timed_out: bool = False

    def judged(self, parity: int, verified: Verified | None) -> None:
        """Keep a judged hypothesis if it is the parity's best; charge all compared so far."""
        if verified is None:
            return
        score = verified.log10_false_alarms + float(np.log10(max(1, self.n_hypotheses)))
        if score < self.score[parity]:
            self.best[parity], self.score[parity] = verified, score

    @property
    def n_hypotheses(self) -> int:
        """Hypotheses compared so far, of all parities and both matchers."""
        return self.earlier + sum(self.n_compared)

    @property
    def winner(self) -> int:
        """The parity with the best score."""
        return min(range(len(self.score)), key=self.score.__getitem__)


class StarTracker:
    """Identifies the stars of single frames, lost in space, for one camera and database.

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
        self.settings = settings or SolveSettings()
        self._cameras = camera.definite()
        method = self.settings.method
        self._methods = METHODS if method == "auto" else (method,)
        # Refuses what cannot work before any frame comes, and builds the fallback's patterns.
        _ = camera.radius_rad
        if "radial_cyclic" in self._methods:
            for factor in self.settings.radial_cyclic.ring_factors:
                database.patterns.level(factor)
            _ = database.pattern_pairs

    def solve(self, xy_px: ArrayLike) -> Solution:
        """Identify centroids (n, 2), pixels, and determine the attitude.

        Centroids that are not finite or lie outside of the image are left out and counted.
        Raises ValueError only for an array of another shape.
        """
        started = time.perf_counter()
        xy = np.asarray(xy_px, float)
        if xy.ndim != 2 or xy.shape[1] != 2:
            raise ValueError(f"centroids have shape {xy.shape}: give an array (n, 2) of x, y")
        usable = self._usable(xy)
        solution = self._unusable(xy, usable) or self._solve(xy[usable], started)
        return self._finish(solution, usable, started)

    def _usable(self, xy: Floats) -> np.ndarray:
        """Return which centroids can have come from the image: noise may push some over its edge.

        With distortion there is no margin: the lens may have no rays beyond the edge.
        """
        camera = self.camera
        size = max(camera.width_px, camera.height_px)
        return camera.contains(xy, _OUTSIDE_MARGIN * size if camera.distortion is None else 0.0)

    def _unusable(self, xy: Floats, usable: np.ndarray) -> Solution | None:
        """Return the solution of a frame that need not be searched, None for one that must."""
        n, settings = int(usable.sum()), self.settings
        size = f"{self.camera.width_px} x {self.camera.height_px} px image"
        nothing = Identification.empty(n)
        if len(xy) > 0 and n == 0:
            return Solution(
                Status.BAD_INPUT,
                f"all {len(xy)} centroids are non-finite or outside of the {size}: "
                "check the camera's size and the detector",
                nothing,
            )
        if n > settings.max_centroids:
            return Solution(
                Status.BAD_INPUT,
                f"{n} centroids are more than max_centroids {settings.max_centroids}: "
                "raise the detector's threshold",
                nothing,
            )
        if n < MIN_STARS:
            return Solution(
                Status.TOO_FEW_STARS, f"{n} stars, at least {MIN_STARS} are needed", nothing
            )
        return None

    def _solve(self, xy: Floats, started: float) -> Solution:
        """Let the matchers have their turns until one has a solution."""
        try:
            fields = [StarField.from_pixels(camera, xy) for camera in self._cameras]
        except ValueError as error:  # a lens that folds inside of the image
            return Solution(Status.BAD_INPUT, str(error), Identification.empty(len(xy)))
        budget = self.settings.deadline_ms / 1e3
        searches: list[_Search] = []
        for method in self._methods:
            last = method == self._methods[-1]
            deadline = started + (budget if last else _PRIMARY_SHARE * budget)
            earlier = searches[-1].n_hypotheses if searches else 0
            searches.append(self._search(method, fields, deadline, earlier))
            if self._judge(searches[-1]) is Status.SOLVED:
                return self._solved(fields[searches[-1].winner], searches[-1])
        return self._unsolved(searches, len(xy))

    def _solved(self, star_field: StarField, search: _Search) -> Solution:
        """Label the stars of an accepted hypothesis and determine the attitude from them."""
        verified = search.best[search.winner]
        assert verified is not None
        identification, rotation = label(
            self.database.catalog, star_field, verified, self.settings.displaced_gate_px
        )
        identified = identification.identified
        residual2 = float(np.sum(identification.residual_px[identified] ** 2))
        # Three of the 2 k coordinates went into the rotation.
        sigma_px = np.sqrt(residual2 / (2 * len(identified) - 3))
        sigma_rad = float(sigma_px / star_field.camera.focal_length_px)
        attitude = Attitude.from_rotation(
            rotation, covariance(star_field.vectors[identified], sigma_rad)
        )
        return Solution(
            Status.SOLVED, "identified", identification, attitude, search.method,
            star_field.camera.parity, search.score[search.winner],
            float(np.sqrt(residual2 / len(identified))), search.n_hypotheses,
        )

    def _unsolved(self, searches: list[_Search], n: int) -> Solution:
        """Say why no matcher has a solution: the first reason of this order that holds."""
        statuses = [self._judge(search) for search in searches]
        status = next(
            s for s in (Status.AMBIGUOUS, Status.TIMEOUT, Status.NO_MATCH) if s in statuses
        )
        score = min(min(search.score) for search in searches)
        n_hypotheses = searches[-1].n_hypotheses
        found = f"the best of {n_hypotheses} hypotheses has log10 false alarms {score:.1f}"
        reason = {
            Status.AMBIGUOUS: "the sky and its mirror image fit about as well: "
            "set parity to normal or mirrored",
            Status.TIMEOUT: f"deadline {self.settings.deadline_ms:g} ms passed, {found}",
            Status.NO_MATCH: found,
        }[status]
        return Solution(
            status, reason, Identification.empty(n), log10_false_alarms=score,
            n_hypotheses=n_hypotheses,
        )

    def _search(
        self, method: str, fields: list[StarField], deadline: float, earlier: int
    ) -> _Search:
        """Judge one matcher's candidates until one is certain, none is left or time is up."""
        n = len(fields)
        search = _Search(method, earlier, [None] * n, [float("inf")] * n, [0] * n)
        threshold = self.settings.max_log10_false_alarms
        second_look = 0
        for parity, (n_compared, candidate) in self._candidates(method, fields):
            search.n_compared[parity] = n_compared
            if candidate is not None:
                search.judged(parity, verify(self.database.catalog, fields[parity], candidate))
                score = search.score[parity]
                if score < min(_CERTAIN, threshold):
                    return search
                second_look += score < threshold
                if second_look > _SECOND_LOOK and n == 1:
                    return search
            if time.perf_counter() > deadline:
                search.timed_out = True
                return search
        return search

    def _candidates(self, method: str, fields: list[StarField]) -> Iterator[tuple[int, Step]]:
        """Yield (parity, step of the matcher), the parities in turn."""
        settings = self.settings
        if method == "match_group":
            sources = [
                match_group.candidates(self.database, star_field, settings.match_group)
                for star_field in fields
            ]
        else:
            sources = [
                radial_cyclic.candidates(self.database, star_field, settings.radial_cyclic)
                for star_field in fields
            ]
        for steps in zip_longest(*sources):
            yield from ((parity, step) for parity, step in enumerate(steps) if step is not None)

    def _judge(self, search: _Search) -> Status:
        """Return how one matcher's search has ended."""
        score, n_parities = search.score[search.winner], len(search.score)
        threshold = self.settings.max_log10_false_alarms
        if score < (threshold if n_parities == 1 else min(_CERTAIN, threshold)):
            return Status.SOLVED
        if search.timed_out:
            return Status.TIMEOUT
        if score < threshold:
            other = min(s for parity, s in enumerate(search.score) if parity != search.winner)
            lead = other - score
            return Status.SOLVED if lead >= _AUTO_PARITY_LEAD else Status.AMBIGUOUS
        return Status.NO_MATCH

    def _finish(self, solution: Solution, usable: np.ndarray, started: float) -> Solution:
        """Give every input centroid its row again, and the time taken."""
        identification = Identification.empty(len(usable))
        part = solution.identification
        identification.catalog_index[usable] = part.catalog_index
        identification.state[usable] = part.state
        identification.residual_px[usable] = part.residual_px
        return replace(
            solution,
            identification=identification,
            n_ignored=int(np.count_nonzero(~usable)),
            solve_ms=1e3 * (time.perf_counter() - started),
        )
