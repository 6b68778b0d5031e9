"""One observed star field, and the candidate matches that both matchers produce from it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from star_tracker.camera import Camera, vectors_of_plane
from star_tracker.spherical import Floats, position_angle, separation

#: Position angles in the camera are counted from the image's up direction, -y of the frame.
CAMERA_POLE = (0.0, -1.0, 0.0)


@dataclass(frozen=True)
class Candidate:
    """A hypothesis: observed stars `observed[i]` are guide stars `catalog[i]`.

    Attributes:
        observed: (k,) indices into the field's stars.
        catalog: (k,) catalogue indices.
        tolerance_px: position tolerance with which the match was found.
    """

    observed: NDArray[np.intp]
    catalog: NDArray[np.intp]
    tolerance_px: float


#: What a matcher yields: how many hypotheses it has compared so far, and a candidate if this step
#: brought one. All hypotheses compared are charged: the best of many may be good by chance. Steps
#: without a candidate let the caller look at the clock.
Step = tuple[int, Candidate | None]


@dataclass(frozen=True)
class StarField:
    """The centroids of one frame as directions.

    Attributes:
        camera: the camera, of definite parity.
        vectors: (n, 3) unit vectors in the optical frame.
        plane_px: (n, 2) undistorted image coordinates about the principal point, pixels, y down.
    """

    camera: Camera
    vectors: Floats
    plane_px: Floats

    @classmethod
    def from_pixels(cls, camera: Camera, xy_px: Floats) -> "StarField":
        """Convert centroids (n, 2), pixels, which must be finite."""
        plane = camera.plane(xy_px)
        return cls(camera, vectors_of_plane(plane), plane * camera.focal_length_px)

    def __len__(self) -> int:
        return len(self.vectors)

    @cached_property
    def from_centre(self) -> NDArray[np.intp]:
        """Star indices in order of distance from the boresight, nearest first."""
        return np.argsort(np.hypot(self.plane_px[:, 0], self.plane_px[:, 1]), kind="stable")

    def neighbours(self, star: int, count: int) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return the `count` nearest other stars: index, separation and position angle, rad."""
        separations = np.asarray(separation(self.vectors, self.vectors[star]))
        nearest = np.argsort(separations, kind="stable")
        nearest = nearest[nearest != star][:count]
        angle = position_angle(self.vectors[star], self.vectors[nearest], CAMERA_POLE)
        return nearest, separations[nearest], angle
