"""The camera that a learning tracker works with, and when it is another one."""

import math
from dataclasses import dataclass, replace

import numpy as np

from star_tracker.calibration.camera_estimator import CameraEstimator
from star_tracker.calibration.second_opinion import SecondOpinion
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution
from star_tracker.tracker import StarTracker

#: Where the stars of a single frame tell a camera, its focal length is believed this well at
#: least, relative: what the lens bends is not known yet.
_LEAST_DOUBT, _MOST_DOUBT = 0.005, 0.1
#: And a lens that bends by k1 = 0.15 shows another focal length: by half of that in the corners.
_BEND = 0.075
#: The camera learns from each of the first so many solved frames, and then from one in so many:
#: going through a frame takes 15 ms. Where one disagrees the next one is gone through too.
_EACH, _ONE_IN = 10, 10


@dataclass
class Belief:
    """A camera that is worked with, its tracker, and what frames have told about it."""

    camera: Camera
    tracker: StarTracker
    learns: bool
    estimator: CameraEstimator | None
    second_opinion: SecondOpinion | None = None
    n_solved: int = 0
    agreed: bool = True

    @property
    def learns_from_it(self) -> bool:
        """Whether the frame that was just solved is one of those that the camera learns from."""
        n = self.n_solved
        return n <= _EACH or n % _ONE_IN == 0 or not self.agreed


def believed(solution: Solution) -> Camera:
    """Return the camera of a solution with the tolerance that its own stars leave."""
    camera = solution.camera
    if camera is None:
        raise ValueError("an unsolved frame tells no camera")
    corner = math.tan(min(camera.radius_rad, math.radians(80.0)))
    doubt = max(3 * solution.focal_length_error, _LEAST_DOUBT, _BEND * corner**2)
    return replace(camera, tolerance_percent=100 * min(doubt, _MOST_DOUBT))


def moved_px(before: Camera, after: Camera) -> float:
    """Return how far apart two cameras put the rays of the border and the middle of the image."""
    w, h = before.width_px, before.height_px
    points = np.array([
        (x, y) for x in (0.1 * w, 0.5 * w, 0.9 * w) for y in (0.1 * h, 0.5 * h, 0.9 * h)
    ])
    moved = after.pixels(before.vectors(points)) - points
    return float(np.max(np.hypot(moved[:, 0], moved[:, 1])))
