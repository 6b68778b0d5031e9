"""The whole path: centroids -> vectors -> candidates -> verified identification -> attitude."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from star_tracker import match_group
from star_tracker.attitude import Attitude, covariance
from star_tracker.camera import Camera
from star_tracker.database import FeatureDatabase
from star_tracker.field import StarField, Step
from star_tracker.match_group import MatchGroupSettings
from star_tracker.spherical import Floats
from star_tracker.verification import Identification, Verified, label, verify

#: Fewer stars than this fit some guide stars by chance too often to be told apart from truth.
MIN_STARS = 4
#: A hypothesis this good ends the search. A weaker one that can be accepted first has to hold out
#: against this many more: a few true stars among 40 can carry a pose that is off by half a degree.
#: A true sky seen in a mirror reached -2.5 in 1000 fields of 12 deg, so where the parity is not
#: known a weaker one needs a lead over the other parity after a full search of both.
_CERTAIN = -6.0
_SECOND_LOOK = 10
_AUTO_PARITY_LEAD = 4.0
#: A centroid this far outside of the image (in image sizes) cannot have come from it.
_OUTSIDE_MARGIN = 0.05


class Status(Enum):
    """How a frame ended. Everything but SOLVED comes without an attitude."""

    SOLVED = "SOLVED"
    TOO_FEW_STARS = "TOO_FEW_STARS"
    NO_MATCH = "NO_MATCH"
    AMBIGUOUS = "AMBIGUOUS"
    TIMEOUT = "TIMEOUT"
    BAD_INPUT = "BAD_INPUT"


@dataclass(frozen=True)
class SolveSettings:
    """What the user decides. Raises ValueError for a value out of range, naming it.

    Attributes:
        match_group: the primary matcher's settings.
        displaced_gate_px: farthest a displaced star may lie from its place; 0 labels none.
        max_log10_false_alarms: accept a hypothesis whose log10 false alarms are below this.
        deadline_ms: give up after this time; infinity never does.
        max_centroids: refuse a frame with more.
    """

    match_group: MatchGroupSettings = field(default_factory=MatchGroupSettings)
    displaced_gate_px: float = 40.0
    max_log10_false_alarms: float = -4.0
    deadline_ms: float = 200.0
    max_centroids: int = 1000

    def __post_init__(self) -> None:
        tolerances = self.match_group.pair_tolerance_px
        if not tolerances or not all(0.01 <= t <= 100 for t in tolerances):
            raise ValueError("pair_tolerance_px needs one or more values from 0.01 to 100")
        if self.match_group.companions < 1 or self.match_group.cells < 1:
            raise ValueError("companions and cells must be at least 1")
        if not 0 <= self.displaced_gate_px <= 1000:
            raise ValueError("displaced_gate_px must be from 0 to 1000")
        if not -100 <= self.max_log10_false_alarms <= 0:
            raise ValueError("max_log10_false_alarms must be from -100 to 0")
        if not self.deadline_ms > 0:
            raise ValueError("deadline_ms must be greater than 0")
        if self.max_centroids < MIN_STARS:
            raise ValueError(f"max_centroids must be at least {MIN_STARS}")


@dataclass(frozen=True)
class Solution:
    """What one frame gave.

    Attributes:
        status: SOLVED or why not; `reason` says it in a sentence.
        identification: one row for each centroid, also of an unsolved frame.
        attitude: only where solved.
        method: the matcher that found the solution, empty where none did.
        parity: the parity under which it was found, empty where none was.
        log10_false_alarms: of the best hypothesis, solved or not; infinity where there was none.
        rms_px: root mean square residual of the identified stars, NaN where unsolved.
        n_hypotheses: how many hypotheses were compared. Those compared before the best one was
            found are charged in its false alarms.
        n_ignored: centroids left out because they are not finite or lie outside of the image.
        solve_ms: wall-clock time.
    """

    status: Status
    reason: str
    identification: Identification
    attitude: Attitude | None = None
    method: str = ""
    parity: str = ""
    log10_false_alarms: float = float("inf")
    rms_px: float = float("nan")
    n_hypotheses: int = 0
    n_ignored: int = 0
    solve_ms: float = 0.0

    @property
    def wrong_probability(self) -> float:
        """Estimate of the chance that this solution is a coincidence; 1 where unsolved.

        It takes the expected false alarms for a probability. It has been conservative wherever it
        was measured (benchmark/false_alarms.py), but it is about unrelated points: of a sky seen
        with the wrong parity it knows nothing.
        """
        if self.status is not Status.SOLVED:
            return 1.0
        return float(min(1.0, 10.0**self.log10_false_alarms))


@dataclass
class _Search:
    """What the search has found so far: of each parity the best hypothesis and its score.

    The score is log10 of the false alarms, with all hypotheses charged that were compared before.
    """

    best: list[Verified | None]
    score: list[float]
    n_compared: list[int]
    timed_out: bool = False

    def judged(self, parity: int, verified: Verified | None) -> None:
        """Keep a judged hypothesis if it is the parity's best; charge all compared so far."""
        if verified is None:
            return
        score = verified.log10_false_alarms + float(np.log10(self.n_hypotheses))
        if score < self.score[parity]:
            self.best[parity], self.score[parity] = verified, score

    @property
    def n_hypotheses(self) -> int:
        """Hypotheses compared so far, of all parities."""
        return sum(self.n_compared)


class StarTracker:
    """Identifies the stars of single frames, lost in space, for one camera and database.

    Args:
        database: guide stars and their features.
        camera: the camera; its parity may be `auto`.
        settings: tolerances, thresholds and limits.

    Raises ValueError where the camera's distortion cannot be inverted over the image.
    """

    def __init__(
        self, database: FeatureDatabase, camera: Camera, settings: SolveSettings | None = None
    ) -> None:
        self.database = database
        self.camera = camera
        self.settings = settings or SolveSettings()
        self._cameras = camera.definite()
        # Refuses a lens that does not reach the corners of the image, before any frame comes.
        _ = camera.radius_rad

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
        fields = [StarField.from_pixels(camera, xy) for camera in self._cameras]
        search = self._search(fields, started + self.settings.deadline_ms / 1e3)
        chosen = min(range(len(fields)), key=search.score.__getitem__)
        status, reason = self._judge(search, chosen)
        verified = search.best[chosen]
        if status is not Status.SOLVED or verified is None:
            return Solution(
                status, reason, Identification.empty(len(xy)),
                log10_false_alarms=search.score[chosen], n_hypotheses=search.n_hypotheses,
            )
        star_field = fields[chosen]
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
            status, reason, identification, attitude, "match_group",
            star_field.camera.parity, search.score[chosen],
            float(np.sqrt(residual2 / len(identified))), search.n_hypotheses,
        )

    def _search(self, fields: list[StarField], deadline: float) -> _Search:
        """Judge candidates until one is certain, none is left or the time is up."""
        n = len(fields)
        search = _Search([None] * n, [float("inf")] * n, [0] * n)
        threshold = self.settings.max_log10_false_alarms
        second_look = 0
        for parity, (n_compared, candidate) in self._candidates(fields):
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

    def _candidates(self, fields: list[StarField]) -> Iterator[tuple[int, Step]]:
        """Yield (parity, step of its matcher), the parities in turn."""
        sources = [
            match_group.candidates(self.database, star_field, self.settings.match_group)
            for star_field in fields
        ]
        for steps in zip_longest(*sources):
            yield from ((parity, step) for parity, step in enumerate(steps) if step is not None)

    def _judge(self, search: _Search, chosen: int) -> tuple[Status, str]:
        score, n_parities = search.score[chosen], len(search.best)
        threshold = self.settings.max_log10_false_alarms
        if score < (threshold if n_parities == 1 else min(_CERTAIN, threshold)):
            return Status.SOLVED, "identified"
        if score < threshold and not search.timed_out:
            lead = min(search.score[p] for p in range(n_parities) if p != chosen) - score
            if lead >= _AUTO_PARITY_LEAD:
                return Status.SOLVED, "identified"
            return Status.AMBIGUOUS, (
                "the sky and its mirror image fit about as well: set parity to normal or mirrored"
            )
        found = f"the best of {search.n_hypotheses} hypotheses has log10 false alarms {score:.1f}"
        if search.timed_out:
            return Status.TIMEOUT, f"deadline {self.settings.deadline_ms:g} ms passed, {found}"
        return Status.NO_MATCH, found

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
