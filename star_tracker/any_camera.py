"""Frames of a camera whose field of view is not known: a search over scales and depths."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.depth import stars_in_view
from star_tracker.catalogue.ladder import LadderStep
from star_tracker.frame_solution import judged, labelled, received, refused, setup_of
from star_tracker.identification.ended import Ended
from star_tracker.identification.escalation import Escalation
from star_tracker.identification.evidence import ScalePrior
from star_tracker.identification.searcher import METHODS, Searcher, Task
from star_tracker.identification.setup import with_mirror_image
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status

#: Steps overlap by this factor, so that no scale falls between two.
_OVERLAP = 1.01
#: Each scale is searched at so many depths, which share its evidence.
_DEPTHS = 2
#: Of more centroids than these, where it is known how bright they are, the brightest are searched
#: first, and have so much of the deadline: guide stars are the brightest of the sky, 25 to 60 in a
#: field, and each centroid beyond them is one more that may be anything. Of 500 rendered images
#: with up to 150 centroids 11 were not solved within 30 s, all of them within 0.2 s by their
#: brightest 50 (benchmark/end_to_end.py). A second look at most doubles the false alarms.
_BRIGHTEST, _SHARE = 50, 0.5


class AnyCameraTracker:
    """Identifies the stars of frames, and finds out the field of view of the camera.

    Each step of the ladder is searched by the shape of triangles, which do not depend on the
    scale, those first that show about as many stars as the frame has. All scales share the
    evidence, so that the answer is as honest as that of a known camera.

    Args:
        steps: the ladder, of one image size.
        settings: tolerances, thresholds and limits; the fallback is not used.
        parity: of the image.

    Raises ValueError for a ladder without steps.
    """

    def __init__(
        self, steps: Sequence[LadderStep], settings: SolveSettings | None = None, *,
        parity: str = "auto",
    ) -> None:
        if not steps:
            raise ValueError("a ladder needs at least one step")
        self.settings, self.steps = settings or SolveSettings(), tuple(steps)
        self._brightest = replace(self.settings, max_centroids=_BRIGHTEST)
        self._parity, self._both = parity, parity == "auto"
        setup = setup_of(replace(self.settings, method=METHODS[0]), both_parities=self._both)
        self._limits = setup.limits
        reach = math.log(
            _cotangent(steps[0].fov_min_deg) / _cotangent(steps[-1].fov_max_deg)
        )
        self._rungs: list[tuple[float, list[Searcher]]] = []
        for step, database in _depths(steps):
            camera = _middle(step, parity)
            half = 0.5 * math.log(
                _OVERLAP * _cotangent(step.fov_min_deg) / _cotangent(step.fov_max_deg)
            )
            prior = ScalePrior(-half, half, _DEPTHS * reach, told=False, sigma=math.inf)
            searchers = setup.searchers(database, with_mirror_image(camera), prior)
            self._rungs.append((stars_in_view(len(database.catalog), camera), searchers))
        self.solve(np.zeros((0, 2)))  # compiles the path, which would take a frame's time

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle it as what it was made with: another process makes its own of that."""
        return partial(AnyCameraTracker, parity=self._parity), (self.steps, self.settings)

    @property
    def searchers(self) -> list[Searcher]:
        """Those that may solve a frame, of all scales."""
        return self._asked(self._rungs)

    def _asked(self, rungs: list[tuple[float, list[Searcher]]]) -> list[Searcher]:
        """Return the searchers of each parity that may be the true one, in the rungs' order."""
        n_parities = 2 if self._both else 1
        return [one for _, searchers in rungs for one in searchers[:n_parities]]

    def solve(
        self,
        xy_px: ArrayLike,
        intensity: ArrayLike | None = None,
        *,
        deadline_ms: float | None = None,
    ) -> Solution:
        """Identify centroids (n, 2), pixels, at any scale; see `StarTracker.solve`.

        The solution's `camera` has the focal length that the stars show. Where a frame is solved
        by its brightest centroids the others stay unidentified, and are not counted as surplus.
        """
        task = received(xy_px, intensity, deadline_ms, self.settings)
        if len(task.intensity) > _BRIGHTEST:
            brightest = received(xy_px, intensity, _SHARE * task.deadline_ms, self._brightest)
            solution = self._searched(brightest)
            if solution.status is Status.SOLVED:
                return replace(solution, n_surplus=task.n_surplus)
        return self._searched(task)

    def _searched(self, task: Task) -> Solution:
        """Search all scales for the centroids of a task."""
        n = len(task.xy_px)
        rungs = self._rungs
        if len(rungs) > 1:
            rungs = sorted(rungs, key=lambda rung: abs(math.log((n + 1) / (rung[0] + 1))))
        first = rungs[0][1][0]
        first.follow(task, task.deadline_s)
        if first.ended == Ended.SOLVED:
            return labelled(task, first)
        if first.ended == Ended.TOO_FEW:
            return refused(task, first)
        asked = self._asked(rungs)
        mirrors = [] if self._both else [searchers[1] for _, searchers in rungs]
        return judged(task, Escalation(asked, mirrors, self._limits).run(task))


def _cotangent(fov_deg: float) -> float:
    return 1.0 / math.tan(math.radians(fov_deg) / 2)


def _middle(step: LadderStep, parity: str) -> Camera:
    """Return the camera in the middle of a step, on the logarithmic scale of focal lengths."""
    focal = step.width_px / 2 * math.sqrt(
        _cotangent(step.fov_min_deg) * _cotangent(step.fov_max_deg)
    )
    return Camera(
        step.width_px, step.height_px, focal, focal, step.width_px / 2, step.height_px / 2, parity
    )


def _depths(steps: Sequence[LadderStep]) -> Iterator[tuple[LadderStep, FeatureDatabase]]:
    """Yield each step with the databases that it is searched with: its own and a shallower one.

    A camera that sees fewer stars than suit its field has its stars' neighbours missing from the
    deeper catalogue's triangles.
    """
    for step, wider in zip_longest(steps, steps[1:]):
        yield step, step.database
        if wider is not None:
            yield step, wider.database
