"""A camera from all its frames at once: `learning` for those that lie on a disk."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.camera_estimator import CameraEstimate, CameraEstimator
from star_tracker.calibration.learning import LearningTracker
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, Status

#: Standard deviation of the log focal length before the frames: next to nothing is known.
_DOUBT = 0.1
#: The frames are gone through so often, each time from the camera that came out before: the stars
#: of the first ones are then looked for where the last ones have shown them to be.
_PASSES = 2


class Sighting(NamedTuple):
    """A frame: centroids (n, 2), pixels, and their intensities (n,) or None."""

    xy_px: Floats
    intensity: Floats | None


@dataclass(frozen=True)
class CalibratedFrames:
    """A camera and how well it fits the frames that it comes from.

    Attributes:
        estimate: the camera with standard errors.
        before: the camera as it was told, or found in the first frame.
        rms_before_px, rms_after_px: root mean square residual of the same stars with either, the
            attitudes fitted anew.
        n_stars: of all frames that went in.
        used: (n,) whether each frame went in.
        solutions: of the frames, with the camera before.
    """

    estimate: CameraEstimate
    before: Camera
    rms_before_px: float
    rms_after_px: float
    n_stars: int
    used: NDArray[np.bool_]
    solutions: tuple[Solution, ...]


def calibrate_frames(
    tracker: LearningTracker, frames: Sequence[Sighting]
) -> CalibratedFrames:
    """Fit focal length and lens to all stars of frames of one camera, each with its attitude.

    Raises ValueError where no frame is solved, or none agrees with the others.
    """
    told, first = tracker.camera, None
    solutions = [tracker.solve(*frame) for frame in frames]
    solutions = [  # once more, with what the others have taught
        one if one.status is Status.SOLVED else tracker.solve(*frame)
        for one, frame in zip(solutions, frames, strict=True)
    ]
    solved = [i for i, one in enumerate(solutions) if one.status is Status.SOLVED]
    if not solved or tracker.camera is None:
        raise ValueError(
            f"none of {len(frames)} frames was solved: without stars there is no calibration"
        )
    first = solutions[solved[0]].camera
    before = first if told is None or first is None else told.with_parity(first.parity)
    camera, matches = tracker.camera, {}
    for _ in range(_PASSES):
        estimator = CameraEstimator(replace(camera, tolerance_percent=0.0), _DOUBT)
        matches = {i: _matched(estimator, frames[i], solutions[i]) for i in solved}
        camera = estimator.estimate.camera
    found = [match for match in matches.values() if match is not None]
    if before is None or not found:
        raise ValueError(
            f"none of {len(frames)} frames has stars enough, or no two agree on a camera"
        )
    return CalibratedFrames(
        estimator.estimate, before, _rms_px(before, found), _rms_px(camera, found),
        sum(len(xy) for xy, _ in found),
        np.array([matches.get(i) is not None for i in range(len(frames))]), tuple(solutions),
    )


def _matched(
    estimator: CameraEstimator, frame: Sighting, solution: Solution
) -> tuple[Floats, Floats] | None:
    """Take a solved frame in; return the centroids and stars that were used."""
    if solution.catalog is None:
        return None
    which = solution.identification.identified
    seeds = which, solution.identification.catalog_index[which]
    xy, guides = np.asarray(frame.xy_px, float), solution.catalog.vectors
    used = estimator.add_frame(xy, guides, seeds)
    return None if used is None else (xy[used[0]], guides[used[1]])


def _rms_px(camera: Camera, found: Sequence[tuple[Floats, Floats]]) -> float:
    """Return the root mean square residual over all frames, each with its best attitude."""
    squares = [
        np.sum((camera.pixels(stars @ wahba(camera.vectors(xy), stars)) - xy) ** 2, axis=1)
        for xy, stars in found
    ]
    return float(np.sqrt(np.mean(np.concatenate(squares))))
