"""One observed star field, and the candidate matches that both matchers produce from it."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats, position_angle, separation
from star_tracker.optics.camera import Camera, in_image, plane_of_pixel
from star_tracker.optics.distortion import NOT_INVERTIBLE

#: Position angles in the camera are counted from the image's up direction, -y of the frame.
CAMERA_POLE = (0.0, -1.0, 0.0)
#: A centroid this far outside of the image (in image sizes) cannot have come from it: noise may
#: push some over its edge. With distortion there is no margin, the lens may have no rays beyond.
_OUTSIDE_MARGIN = 0.05
#: Two stars closer than this have no good position angle, pixels.
_CLOSEST_PX = 15.0


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
#: brought one. Steps without a candidate let the caller look at the clock.
Step = tuple[int, Candidate | None]


class Frame(NamedTuple):
    """The usable centroids of one frame as directions, from left to right, for compiled code.

    Attributes:
        vectors: (n, 3) unit vectors in the optical frame.
        plane_px: (n, 2) undistorted image coordinates about the principal point, pixels, y down;
            plane_px[:, 0] ascends.
        row: (n,) index of the centroid in the input.
        mains: (n,) indices in the order in which stars are tried as main star.
        magnitude: (n,) instrumental magnitudes, NaN = not known; (0,) where none is.
        lost: whether the lens has no ray for some centroid.
    """

    vectors: Floats
    plane_px: Floats
    row: NDArray[np.int64]
    mains: NDArray[np.int64]
    magnitude: Floats
    lost: bool


@compiled
def make_frame(optics: Floats, xy_px: Floats, intensity: Floats) -> Frame:
    """Convert centroids (m, 2), leaving out those that are not finite or outside of the image.

    Their intensities (m,), larger = brighter, or (0,) where they are not known.
    """
    row, key = np.empty(len(xy_px), np.int64), np.empty(len(xy_px))
    points = np.empty(xy_px.shape)
    margin = 0.0 if optics[7] != 0.0 else _OUTSIDE_MARGIN * max(optics[0], optics[1])
    n, lost = 0, False
    for i in range(len(xy_px)):
        if in_image(optics, xy_px[i, 0], xy_px[i, 1], margin):
            x, y, exists = plane_of_pixel(optics, xy_px[i, 0], xy_px[i, 1])
            points[i, 0], points[i, 1] = x, y
            row[n], key[n] = i, x
            lost = lost or not exists
            n += 1
    _sort(row, key, n)
    vectors, plane_px = np.empty((n, 3)), np.empty((n, 2))
    focal_px = np.sqrt(optics[2] * optics[3])
    for i in range(n):
        x, y = points[row[i], 0], points[row[i], 1]
        scale = 1.0 / np.sqrt(1.0 + x * x + y * y)
        vectors[i, 0], vectors[i, 1], vectors[i, 2] = x * scale, y * scale, scale
        plane_px[i, 0], plane_px[i, 1] = x * focal_px, y * focal_px
    magnitude = np.empty(n if len(intensity) > 0 else 0)
    for i in range(len(magnitude)):
        value = intensity[row[i]]
        magnitude[i] = -2.5 * np.log10(value) if 0.0 < value < np.inf else np.nan
    return Frame(
        vectors, plane_px, row[:n], _order_mains(plane_px, magnitude, key), magnitude, lost
    )


@compiled
def _order_mains(plane_px: Floats, magnitude: Floats, key: Floats) -> NDArray[np.int64]:
    """Return the stars with the nearest companions first, bright ones before faint ones.

    Close pairs have the fewest look-alikes in the catalogue, so that they are compared fastest.
    Those too close for a good position angle count as if they were farther. Bright stars are less
    likely to be false.
    """
    n = len(plane_px)
    mains = np.empty(n, np.int64)
    for i in range(n):
        d1 = d2 = d3 = 1e30  # squared distances of the three nearest
        for direction in (-1, 1):
            j = i + direction
            while 0 <= j < n:
                dx, dy = plane_px[j, 0] - plane_px[i, 0], plane_px[j, 1] - plane_px[i, 1]
                if dx * dx >= d3:
                    break
                d = max(dx * dx + dy * dy, _CLOSEST_PX**2)
                if d < d1:
                    d1, d2, d3 = d, d1, d2
                elif d < d2:
                    d2, d3 = d, d2
                elif d < d3:
                    d3 = d
                j += direction
        mains[i], key[i] = i, np.sqrt(d1) + np.sqrt(d2) + np.sqrt(d3)
        if len(magnitude) > 0:
            brighter = 0
            for j in range(n):
                brighter += not magnitude[j] >= magnitude[i]
            key[i] *= 1.0 + brighter / n
    _sort(mains, key, n)
    return mains


@compiled
def _sort(values: NDArray[np.int64], key: Floats, n: int) -> None:
    """Sort the first `n` values by their keys, both in place (Shell 1959; gaps of Ciura 2001)."""
    for gap in (701, 301, 132, 57, 23, 10, 4, 1):
        for i in range(gap, n):
            value, k, at = values[i], key[i], i
            while at >= gap and key[at - gap] > k:
                values[at], key[at] = values[at - gap], key[at - gap]
                at -= gap
            values[at], key[at] = value, k


@dataclass(frozen=True)
class StarField:
    """The centroids of one frame as directions, and the camera, of definite parity."""

    camera: Camera
    frame: Frame

    @classmethod
    def from_pixels(
        cls, camera: Camera, xy_px: Floats, intensity: Floats | None = None
    ) -> "StarField":
        """Convert centroids (n, 2), pixels, which must be finite and in or near the image.

        Their intensities (n,) are optional. Raises ValueError where the lens has no ray for one.
        """
        brightness = np.empty(0) if intensity is None else intensity
        frame = make_frame(camera.optics, np.ascontiguousarray(xy_px, float), brightness)
        if frame.lost:
            raise ValueError(NOT_INVERTIBLE)
        return cls(camera, frame)

    def __len__(self) -> int:
        return len(self.frame.vectors)

    @property
    def vectors(self) -> Floats:
        """Unit vectors (n, 3) in the optical frame, from left to right."""
        return self.frame.vectors

    @cached_property
    def from_centre(self) -> NDArray[np.intp]:
        """Star indices in order of distance from the boresight, nearest first."""
        return np.argsort(-self.vectors[:, 2], kind="stable")

    def neighbours(self, star: int, count: int) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return the `count` nearest other stars: index, separation and position angle, rad."""
        separations = np.asarray(separation(self.vectors, self.vectors[star]))
        nearest = np.argsort(separations, kind="stable")
        nearest = nearest[nearest != star][:count]
        angle = position_angle(self.vectors[star], self.vectors[nearest], CAMERA_POLE)
        return nearest, separations[nearest], angle
