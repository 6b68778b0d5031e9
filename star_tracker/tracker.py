"""The whole path: centroids -> vectors -> candidates -> verified identification -> attitude."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.frame_solution import judged, labelled, received, refused, setup_of
from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.geometry.spherical import Floats
from star_tracker.identification import fallback
from star_tracker.identification.ended import Ended
from star_tracker.identification.escalation import Candidates, Escalation
from star_tracker.identification.evidence import DOUBT, scale_prior
from star_tracker.identification.searcher import METHODS, Task
from star_tracker.identification.setup import with_mirror_image
from star_tracker.identification.stream import Expectation, expect
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings

#: Python 3.11 takes longer over `Ended.SOLVED` than over a call.
_SOLVED = Ended.SOLVED
#: Work, in votes, of the short search with the focal length free. A true pose takes some hundred;
#: a frame whose camera is as told and that the quick search has not solved waits for it.
_SHORT_WORK = 2000.0


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

    With method `auto` the fallback is left out where the catalogue is too dense for it. Raises
    ValueError where the camera's distortion cannot be inverted over the image, the catalogue is
    too dense for method `radial_cyclic` or its ring factors do not divide the rings.
    """

    def __init__(
        self, database: FeatureDatabase, camera: Camera, settings: SolveSettings | None = None,
        *, candidates: Candidates | None = None,
    ) -> None:
        self.database = database
        self.camera = camera
        self._own_candidates = candidates
        self.settings = s = settings or SolveSettings()
        method = s.method
        if method == "auto" and candidates is None and not database.patterns_available:
            method = METHODS[0]
        self._primary = method != METHODS[1]
        # Refuses what cannot work before any frame comes, and builds the fallback's patterns.
        if method != METHODS[0] and candidates is None:
            candidates = partial(fallback.candidates, database, settings=s.radial_cyclic)
            for factor in s.radial_cyclic.ring_factors:
                _ = database.patterns.level(factor).log_likelihoods
            _ = database.pattern_pairs
        both_parities = camera.parity == "auto"
        setup = setup_of(s, both_parities=both_parities)
        self._expected = setup.expected
        searchers = setup.searchers(
            database, with_mirror_image(camera), scale_prior(camera.tolerance_percent)
        )
        freed = []
        if camera.tolerance_percent == 0:
            primary = replace(
                setup, match_group=s.match_group, limits=setup.limits._replace(work=_SHORT_WORK)
            )
            freed = primary.searchers(database, camera.definite(), DOUBT)
        #: Those that may solve a frame: of each parity that is asked for.
        self.searchers = searchers[: 2 if both_parities else 1]
        self._first = searchers[0]
        self._escalation = Escalation(
            self.searchers, searchers[len(self.searchers):], setup.limits, freed=freed,
            fallback=candidates, primary=self._primary,
        )
        # Compiles the path and what a predicted solution needs: it would take a frame's time.
        self.solve(np.zeros((0, 2)))
        rotation_matrix(np.array([0.0, 0.0, 0.0, 1.0]))

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
        if lost in space. Where the focal length may be off an earlier solution tells it, too.
        Centroids that are not finite, lie outside of the image or have no ray of
        the lens are left out and counted. A deadline, ms, holds for this frame instead of that of
        the settings. Raises ValueError only for an array of another shape, and a deadline that is
        not above 0.
        """
        task = received(xy_px, intensity, deadline_ms, self.settings)
        first = self._first
        if predicted is not None and self._track(task, predicted):
            return labelled(task, first)
        first.follow(task)
        if first.ended == _SOLVED:  # nearly every frame
            return labelled(task, first)
        if first.ended == Ended.TOO_FEW:
            return refused(task, first)
        return judged(task, self._escalation.run(task))

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle it as what it was made with: another process makes its own of that."""
        made = partial(StarTracker, candidates=self._own_candidates)
        return made, (self.database, self.camera, self.settings)

    def expect(self, what: Expectation | None) -> None:
        """Use what earlier frames have taught of centroids for those that come; None forgets.

        It adds to the evidence of frames that are like those, and to the covariance of few stars;
        one that is not like them loses half of its evidence at the most.
        """
        expect(what, self._expected)

    def _track(self, task: Task, predicted: Solution | Floats) -> bool:
        """Try a predicted attitude; return whether it has solved the frame."""
        scale = 1.0
        if isinstance(predicted, Solution):
            if predicted.attitude is None or predicted.camera is None:
                return False
            scale = predicted.camera.focal_length_px / self.camera.focal_length_px
            predicted = predicted.attitude.rotation
        rotation = np.asarray(predicted, float)
        if rotation.shape != (3, 3):
            raise ValueError(f"the predicted rotation has shape {rotation.shape}, not (3, 3)")
        if self.camera.parity == "auto" or not self._primary:
            return False
        self._first.track(task, rotation, scale)
        if self._first.ended == Ended.NO_ROTATION:
            raise ValueError("the predicted attitude is no rotation: R^T R = 1, determinant +1")
        return self._first.ended == _SOLVED
