"""One engine as Python sees it: the search of frames under one parity."""

import math
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.compiled import machine_code
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.contradiction import LEAST_DEVIATION
from star_tracker.identification.ended import Ended
from star_tracker.identification.engine import Results
from star_tracker.identification.fallback import Candidate, StarField
from star_tracker.identification.labels import blank_labels
from star_tracker.identification.verbs import Verb, act
from star_tracker.optics.camera import Camera

#: How a solution was come by: with no prior knowledge, or from a predicted attitude.
LOST_IN_SPACE, TRACKING = MODES = ("lost_in_space", "tracking")
#: The matchers, the primary first.
METHODS = ("match_group", "radial_cyclic")
#: By value: a tenth of the time of `Ended(value)`. And verbs as the numbers that they are, as
#: numba takes long over members of an enum.
_ENDED = tuple(Ended)
_FOLLOW, _BEGIN, _GO_ON, _TRACK, _JUDGE_MATCH, _LABEL_BEST = (verb.value for verb in Verb)
#: A focal length is another one beyond `LEAST_DEVIATION` and so many standard deviations.
_SCALE_SIGMA = 4.0


class Sample(NamedTuple):
    """Which of too many centroids are searched.

    Attributes:
        rows: (n,) where they stand among those that were given.
        n_given: how many were given.
        n_surplus: how many are finite and left out.
    """

    rows: NDArray[np.int64]
    n_given: int
    n_surplus: int


@dataclass(slots=True)
class Task:
    """One frame on its way.

    Attributes:
        xy_px: (n, 2) centroids that are searched.
        intensity: (n,), or (0,) where they are not known.
        labels: (n,) of `labels.LABEL`, which the engine writes.
        started_s: `time.perf_counter` of its coming.
        deadline_ms: the time that it has.
        sample: which they are of those that were given; None where all are searched.
    """

    xy_px: Floats
    intensity: Floats
    labels: NDArray[Any]
    started_s: float
    deadline_ms: float
    sample: Sample | None = None

    @property
    def n_given(self) -> int:
        """How many centroids were given."""
        return len(self.xy_px) if self.sample is None else self.sample.n_given

    @property
    def n_surplus(self) -> int:
        """How many are finite and are not searched, as they are too many."""
        return 0 if self.sample is None else self.sample.n_surplus

    def n_ignored(self, n_usable: int) -> int:
        """Return how many are neither usable nor too many."""
        return self.n_given - self.n_surplus - n_usable

    @property
    def all_labels(self) -> NDArray[Any]:
        """Labels (n_given,), blank for centroids that are not searched."""
        if self.sample is None:
            return self.labels
        labels = blank_labels(self.n_given)
        labels[self.sample.rows] = self.labels
        return labels

    @property
    def deadline_s(self) -> float:
        """`time.perf_counter` when its time is up."""
        return self.started_s + self.deadline_ms / 1e3

    def ms_until(self, ended_s: float) -> float:
        """Return the wall-clock time from its coming to a `time.perf_counter`."""
        return 1e3 * (ended_s - self.started_s)


class Searcher:
    """Searches frames under one parity.

    Attributes:
        camera: of that parity.
        catalog: the guide stars.
        engine: `engine.Engine`, which Python hands to compiled code.
        results: what both read and write.
        scale_is_told: whether the focal length is more than a place in a range.
        ended: how the last step ended.
        method: the matcher whose pose is the best.
        mode: of `MODES`, how that pose was come by.
    """

    __slots__ = (
        "_act", "_progress", "_stop_s", "camera", "catalog", "ended", "engine", "method", "mode",
        "results", "scale_is_told",
    )

    def __init__(
        self, camera: Camera, catalog: StarCatalog, engine: Any, results: Results, *,
        scale_is_told: bool = True,
    ) -> None:
        self.scale_is_told = scale_is_told
        self.camera, self.catalog, self.engine, self.results = camera, catalog, engine, results
        self._progress = results.progress[0]  # the record itself, not a copy of it
        self._stop_s = math.inf
        nothing = np.empty((0, 2)), np.empty(0)
        self._act = machine_code(act, engine, _FOLLOW, nothing, blank_labels(0))
        self.ended, self.method, self.mode = Ended.MORE, METHODS[0], LOST_IN_SPACE

    def follow(self, task: Task, stop_s: float = math.inf) -> None:
        """Begin a frame, search for a while and label it where that solves it.

        It takes the search until a `time.perf_counter` at the most.
        """
        self.method, self.mode = METHODS[0], LOST_IN_SPACE
        if stop_s != self._stop_s:
            self.stop_at(stop_s)
        self.ended = self._done(_FOLLOW, task)

    def begin(self, task: Task) -> None:
        """Take a frame in without searching it."""
        self.ended = self._done(_BEGIN, task)

    def track(self, task: Task, rotation: Floats, scale: float = 1.0) -> None:
        """Begin a frame with a predicted rotation (3, 3) and label it where that solves it.

        Where the focal length may be off it is looked for near `scale` times the camera's.
        """
        self.method, self.mode = METHODS[0], TRACKING
        self.results.rotation[:] = rotation
        self._progress["predicted_scale"] = scale
        self.ended = self._done(_TRACK, task)

    def go_on(self, task: Task) -> None:
        """Search on for a while, and label the frame where that solves it."""
        self.ended = self._done(_GO_ON, task)

    def stop_at(self, stop_s: float) -> None:
        """Go on until a `time.perf_counter` at the most; holds until told otherwise."""
        self._stop_s = stop_s
        self._progress["stop_s"] = time.monotonic() + (stop_s - time.perf_counter())

    def judge(self, task: Task, candidate: Candidate) -> bool:
        """Judge a candidate of the fallback; return whether it is certain."""
        before, progress, proposed = self.score, self._progress, self.results.proposed
        k = min(len(candidate.observed), proposed.shape[1])  # a centroid may be there twice
        proposed[0, :k], proposed[1, :k] = candidate.observed[:k], candidate.catalog[:k]
        progress["n_proposed"] = k
        progress["proposed_tolerance_px"] = candidate.tolerance_px
        found = self._done(_JUDGE_MATCH, task)
        if self.score > before:
            self.method = METHODS[1]
        return found == Ended.CERTAIN

    def label(self, task: Task) -> None:
        """Label the frame with the best pose; see `verbs.label` for how that ends."""
        self.ended = self._done(_LABEL_BEST, task)

    def _done(self, verb: int, task: Task) -> Ended:
        """Have the engine do something with a frame; return how that ended."""
        # `received` has made sure of the arrays' types.
        return _ENDED[
            self._act(self.engine, verb, (task.xy_px, task.intensity), task.labels)
        ]

    def field(self) -> StarField:
        """Return the frame's stars for the fallback; they hold until the next frame."""
        return StarField(self.results.vectors[: self.n_usable], self.camera.focal_length_px)

    @property
    def rotation(self) -> Floats:
        """The rotation (3, 3) of the best pose."""
        return self.results.rotation

    @property
    def n_usable(self) -> int:
        """Centroids that are finite and in the image."""
        return int(self.results.outcome["n_usable"][0])

    @property
    def scale(self) -> float:
        """The focal length of the labelled pose as a multiple of the told one."""
        return float(self.results.outcome["scale"][0])

    @property
    def contradicts_the_told_scale(self) -> bool:
        """Whether the labelled pose's focal length is clearly another one than the told one."""
        off = abs(math.log(self.scale))
        error = math.sqrt(self.results.outcome["scale_variance"][0])
        return off > LEAST_DEVIATION + _SCALE_SIGMA * error

    @property
    def score(self) -> float:
        """Decades of evidence of the best pose."""
        return float(self._progress["score"])

    @property
    def rival_score(self) -> float:
        """Decades of evidence of the best other pose."""
        return float(self._progress["rival_score"])

    @property
    def explains_its_view(self) -> bool:
        """Whether the best pose explains half of the centroids, or a third of its guide stars.

        Where a camera is not as told a part of the image may carry a pose that is off: of 3000
        such frames the wrong ones had a quarter of the guide stars in their view at the most, the
        right ones 0.4 and more, as those with many false stars have.
        """
        n_matched = int(self._progress["n_matched"])
        return 2 * n_matched >= self.n_usable or 3 * n_matched >= int(self._progress["n_in_view"])

    @property
    def n_hypotheses(self) -> int:
        """Pairs matched with pairs so far by the primary."""
        return int(self._progress["n_hypotheses"])
