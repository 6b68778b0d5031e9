"""A camera from all its frames at once: `learning` for those that lie on a disk."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.camera_estimator import CameraEstimate, CameraEstimator
from star_tracker.calibration.camera_model import CENTER
from star_tracker.calibration.learning import LearningTracker
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, Status

#: Standard deviation of the log focal length before the frames: next to nothing is known.
_DOUBT = 0.1
#: The frames are gone through so often, each time from the camera that came out before: the stars
#: of the first ones are then looked for where the last ones have shown them to be.
_PASSES = 2
#: The principal point is another one where noise has less than this chance of moving it as far: as
#: in `lens`. (The chi-square of two values is an exponential.)
_SIGNIFICANCE = 0.001

Found = tuple[Floats, Floats]


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
        center_error_px: standard errors (2,) of the principal point, also where the stars did not
            show another one and it stayed; None where it was not asked for.
        rms_before_px, rms_after_px: root mean square residual of the same stars with either, the
            attitudes fitted anew.
        n_stars: of all frames that went in.
        used: (n,) whether each frame went in.
        solutions: of the frames, with the camera before.
    """

    estimate: CameraEstimate
    before: Camera
    center_error_px: Floats | None
    rms_before_px: float
    rms_after_px: float
    n_stars: int
    used: NDArray[np.bool_]
    solutions: tuple[Solution, ...]


def calibrate_frames(
    tracker: LearningTracker, frames: Sequence[Sighting], *, principal_point: bool = False
) -> CalibratedFrames:
    """Fit focal length and lens to all stars of frames of one camera, each with its attitude.

    With `principal_point` that is fitted too, and with it the axis that is the boresight. It stays
    where it was told, or in the middle of the image, where the stars do not show another.

    Raises ValueError where no frame is solved, or none agrees with the others.
    """
    told = tracker.camera
    solutions = _solved(tracker, frames)
    solved = [i for i, one in enumerate(solutions) if one.status is Status.SOLVED]
    if not solved or tracker.camera is None:
        raise ValueError(
            f"none of {len(frames)} frames was solved: without stars there is no calibration"
        )
    first = solutions[solved[0]].camera
    before = first if told is None or first is None else told.with_parity(first.parity)
    sky, center_error_px = {i: (frames[i], solutions[i]) for i in solved}, None
    estimate, matches = _fitted(tracker.camera, sky, before if principal_point else None)
    if principal_point and before is not None:
        center_error_px = estimate.standard_errors[-len(CENTER):]
        if not _is_another(estimate, before):
            estimate, matches = _fitted(tracker.camera, sky, None)
    if before is None or not matches:
        raise ValueError(
            f"none of {len(frames)} frames has stars enough, or no two agree on a camera"
        )
    found = list(matches.values())
    return CalibratedFrames(
        estimate, before, center_error_px, _rms_px(before, found), _rms_px(estimate.camera, found),
        sum(len(xy) for xy, _ in found),
        np.array([i in matches for i in range(len(frames))]), tuple(solutions),
    )


def _solved(tracker: LearningTracker, frames: Sequence[Sighting]) -> list[Solution]:
    """Solve frames; those that were not solved once more, with what the others have taught."""
    solutions = [tracker.solve(*frame) for frame in frames]
    return [
        one if one.status is Status.SOLVED else tracker.solve(*frame)
        for one, frame in zip(solutions, frames, strict=True)
    ]


def _fitted(
    camera: Camera, sky: Mapping[int, tuple[Sighting, Solution]], told: Camera | None
) -> tuple[CameraEstimate, dict[int, Found]]:
    """Return the camera of solved frames, and what was used of those that went in.

    Where `told` is given its principal point is fitted too.
    """
    for _ in range(_PASSES):
        estimator = CameraEstimator(replace(camera, tolerance_percent=0.0), _DOUBT, told=told)
        matches = {i: _matched(estimator, *frame) for i, frame in sky.items()}
        camera = estimator.estimate.camera
    return estimator.estimate, {i: one for i, one in matches.items() if one is not None}


def _is_another(estimate: CameraEstimate, told: Camera) -> bool:
    """Return whether the principal point has moved farther than noise would move it."""
    camera, n = estimate.camera, len(CENTER)
    moved = np.array([camera.cx_px - told.cx_px, camera.cy_px - told.cy_px])
    chi_square = moved @ np.linalg.solve(estimate.covariance[-n:, -n:], moved)
    return bool(chi_square > -2 * np.log(_SIGNIFICANCE))


def _matched(
    estimator: CameraEstimator, frame: Sighting, solution: Solution
) -> Found | None:
    """Take a solved frame in; return the centroids and stars that were used."""
    if solution.catalog is None:
        return None
    which = solution.identification.identified
    seeds = which, solution.identification.catalog_index[which]
    xy, guides = np.asarray(frame.xy_px, float), solution.catalog.vectors
    used = estimator.add_frame(xy, guides, seeds)
    return None if used is None else (xy[used[0]], guides[used[1]])


def _rms_px(camera: Camera, found: Sequence[Found]) -> float:
    """Return the root mean square residual over all frames, each with its best attitude."""
    squares = [
        np.sum((camera.pixels(stars @ wahba(camera.vectors(xy), stars)) - xy) ** 2, axis=1)
        for xy, stars in found
    ]
    return float(np.sqrt(np.mean(np.concatenate(squares))))
