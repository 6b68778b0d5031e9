"""What would solve a frame that a camera, taken at its word, did not solve, or solved badly.

A wrong parity looks like an empty sky. So does a field of view that is off by a few percent, or
the frame is solved with residuals of many pixels: the search bears much.
"""

from dataclasses import replace
from typing import NamedTuple

from numpy.typing import ArrayLike

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.searcher import METHODS
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

#: The field of view may be so far off, and the parity be either.
_TOLERANCE_PERCENT = 10.0
#: What has to be reached: a second opinion is asked again and again where nothing is solved.
_MAX_LOG10_FALSE_ALARMS = -8.0
#: Solved frames with smaller residuals need no other camera; a better one at least halves them.
#: With a field of view that was 4 to 6 % off, the eight maps had 7 to 26 px.
_BAD_RMS_PX, _BETTER = 2.0, 0.5
#: A field of view that is this near to the told one is not worth a word, relative.
_SAME = 2e-3


class ToldBy(NamedTuple):
    """What tells a user's field of view, and how far it may be off: names for hints."""

    fov: str = "fov_deg"
    tolerance: str = "fov_tolerance_percent"


#: The parameters of that name, and the arguments of `Camera.from_fov`.
BY_PARAMETERS = ToldBy()


def is_doubtful(solution: Solution) -> bool:
    """Return whether a frame ended so that the camera may be the reason."""
    unsolved = solution.status in (Status.NO_MATCH, Status.TIMEOUT)
    return unsolved or solution.rms_px > _BAD_RMS_PX or _contradicts(solution)


def _contradicts(solution: Solution) -> bool:
    """Return whether the stars have contradicted a focal length that was told as exact."""
    told = solution.told_camera
    return told is not None and told.tolerance_percent == 0 and solution.scale != 1.0


class SecondOpinion:
    """Searches the frames of a camera without believing what was told of it.

    Args:
        database: guide stars and their features.
        camera: as told.
        settings: tolerances, thresholds and limits.
        told_by: what a hint calls the field of view.
    """

    def __init__(
        self, database: FeatureDatabase, camera: Camera, settings: SolveSettings, *,
        told_by: ToldBy = BY_PARAMETERS,
    ) -> None:
        self._told, self._told_by = camera, told_by
        strict = replace(
            settings, method=METHODS[0],
            max_log10_false_alarms=min(_MAX_LOG10_FALSE_ALARMS, settings.max_log10_false_alarms),
        )
        doubted = replace(camera, tolerance_percent=_TOLERANCE_PERCENT).with_parity("auto")
        self._tracker = StarTracker(database, doubted, strict)

    def hint(
        self, xy_px: ArrayLike, intensity: ArrayLike | None, solution: Solution,
        deadline_ms: float,
    ) -> str:
        """Return what would solve a frame or solve it better, empty where that is not known.

        Args:
            xy_px: (n, 2) centroids.
            intensity: (n,), None where they are not known.
            solution: what became of it.
            deadline_ms: the time for it.
        """
        told = self._told
        if _contradicts(solution) and solution.camera is not None:
            return self._improves(solution.camera)
        found = self._tracker.solve(xy_px, intensity, deadline_ms=deadline_ms)
        if found.camera is None or found.rms_px > _BETTER * solution.rms_px:
            return ""
        if told.parity not in ("auto", found.parity):
            return f"image looks mirrored: parity {found.parity} solves it"
        if abs(found.camera.fov_deg / told.fov_deg - 1) < _SAME:
            return ""
        return self._improves(found.camera)

    def _improves(self, found: Camera) -> str:
        return (
            f"improves if {self._told_by.fov} is {found.fov_deg:.2f} instead of "
            f"{self._told.fov_deg:.2f}, or may be off: {self._told_by.tolerance}"
        )
