"""The pinhole camera: pixels <-> unit vectors of the optical frame. The only home of parity.

The optical frame is that of REP-103: x right, y down, z along the boresight. A pixel (x, y) is
the direction ((x - cx) / fx, (y - cy) / fy, 1) for parity `normal`; for `mirrored`, y is negated
(pixel coordinates whose y axis points up, or an image seen in a mirror). `auto` says that the
parity is not known: `definite()` then gives one camera for each possibility.

By default the principal point is (width / 2, height / 2), so the origin of pixel coordinates is
the outer corner of the first pixel and that pixel's centre is (0.5, 0.5). A detector that calls
the first pixel's centre (0, 0), as OpenCV and CameraInfo do, needs cx = (width - 1) / 2 or the
calibrated value.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.distortion import (
    LENS_AT,
    LIMIT_AT,
    NOT_INVERTIBLE,
    OPTICS_SIZE,
    Distortion,
    distort,
    undistort,
)

PARITIES = ("normal", "mirrored", "auto")
#: Where pixels are counted from, the middle of the first one or its outer corner, and how much
#: more a coordinate is that is counted from the corner, px.
PIXEL_ORIGINS = {"center": 0.5, "corner": 0.0}
#: Fields of view outside of this range are refused: no star pair fits, or no pinhole does.
FOV_RANGE_DEG = (0.5, 120.0)
#: Farthest that a focal length may be off and still count as told.
MOST_TOLERANCE_PERCENT = 30.0
#: Sizes and places beyond, and pixels so many times longer than wide, are no camera's.
_LARGEST_PX, _MOST_OBLONG = 1e6, 10.0
#: Points of each side of the image's border, the corner it begins at among them: a lens bends it.
_SIDE = 8
#: Halvings that find the last pixel with a ray on the way to a border that has none.
_BISECTIONS = 20
#: The middle of an image that a lens has to show, in image sizes.
_MIDDLE = (3 / 8, 1 / 2, 5 / 8)


def vectors_of_plane(points: Floats) -> Floats:
    """Return unit vectors (n, 3) for normalised coordinates X/Z, Y/Z (n, 2)."""
    vectors = np.column_stack([points, np.ones(len(points))])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


@dataclass(frozen=True)
class Camera:
    """A camera's intrinsics, in pixels. Raises ValueError for values no camera can have.

    Attributes:
        width_px, height_px: of the image.
        fx_px, fy_px: focal lengths.
        cx_px, cy_px: principal point.
        parity: of `PARITIES`.
        distortion: of the lens, None where it has none.
        tolerance_percent: how far off the focal length, and so the field of view, may be; 0 where
            it is exact. It is then found out from the stars.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    parity: str = "normal"
    distortion: Distortion | None = field(default=None)
    tolerance_percent: float = 0.0

    def __post_init__(self) -> None:
        if self.parity not in PARITIES:
            raise ValueError(f"parity {self.parity!r} is unknown: use {', '.join(PARITIES)}")
        if not (0 < self.width_px < _LARGEST_PX and 0 < self.height_px < _LARGEST_PX):
            raise ValueError(
                f"image size {self.width_px} x {self.height_px} px is impossible: "
                "give the width and height of the image"
            )
        for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"camera {name} is not a finite number")
        if self.fx_px <= 0 or self.fy_px <= 0:
            raise ValueError("the focal length must be greater than 0 px")
        low, high = FOV_RANGE_DEG
        # Rounded, since the focal length came from the field of view and back again.
        if not low <= round(self.fov_deg, 9) <= high:
            raise ValueError(
                f"field of view {self.fov_deg:.4g} deg is outside of {low:g} to {high:g} deg: "
                "check the focal length and the width of the image"
            )
        if not 1 / _MOST_OBLONG <= self.fy_px / self.fx_px <= _MOST_OBLONG:
            raise ValueError(
                f"fx {self.fx_px:g} px and fy {self.fy_px:g} px belong to no image sensor"
            )
        if not 0.0 <= self.tolerance_percent <= MOST_TOLERANCE_PERCENT:
            raise ValueError(
                f"tolerance_percent {self.tolerance_percent:g} is outside of 0 to "
                f"{MOST_TOLERANCE_PERCENT:g}: a camera that is less well known is one of unknown "
                "field of view"
            )
        if max(abs(self.cx_px), abs(self.cy_px)) >= _LARGEST_PX:
            raise ValueError(
                f"principal point ({self.cx_px:g}, {self.cy_px:g}) px is impossible: "
                "it lies near the middle of the image"
            )

    @classmethod
    def from_fov(
        cls,
        fov_deg: float,
        width_px: int,
        height_px: int,
        *,
        principal_point_px: tuple[float | None, float | None] = (None, None),
        parity: str = "normal",
        tolerance_percent: float = 0.0,
    ) -> "Camera":
        """Return a camera without distortion from the field of view across its width (4-16).

        The principal point is x, y; None for the middle of the image.
        """
        low, high = FOV_RANGE_DEG
        if not low <= fov_deg <= high:  # also refuses NaN
            raise ValueError(
                f"fov_deg {fov_deg:g} is outside of {low:g} to {high:g}: "
                "give the full angle across the width of the image in degrees"
            )
        focal = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
        cx, cy = principal_point_px
        cx = width_px / 2 if cx is None else cx
        cy = height_px / 2 if cy is None else cy
        return cls(
            width_px, height_px, focal, focal, cx, cy, parity, tolerance_percent=tolerance_percent
        )

    @property
    def fov_deg(self) -> float:
        """Full angle across the width of the image, degrees, not counting what a lens bends."""
        return math.degrees(2 * math.atan(self.width_px / 2 / self.fx_px))

    @property
    def focal_length_px(self) -> float:
        """Mean focal length: the scale by which small angles (rad) become pixels."""
        return math.sqrt(self.fx_px * self.fy_px)

    def scaled(self, scale: float) -> "Camera":
        """Return the same camera with its focal lengths multiplied."""
        return replace(self, fx_px=self.fx_px * scale, fy_px=self.fy_px * scale)

    def moved(self, by_px: float) -> "Camera":
        """Return the same camera for coordinates of pixels that are larger along both axes."""
        return replace(self, cx_px=self.cx_px + by_px, cy_px=self.cy_px + by_px)

    def with_parity(self, parity: str) -> "Camera":
        """Return the same camera with another parity."""
        return replace(self, parity=parity)

    def definite(self) -> tuple["Camera", ...]:
        """Return this camera, or for parity `auto` one camera for each possible parity."""
        if self.parity != "auto":
            return (self,)
        return self.with_parity("normal"), self.with_parity("mirrored")

    @cached_property
    def radius_rad(self) -> float:
        """Largest angle between the boresight and anything that the camera sees.

        It is seen at a point of the image's border, or at the lens' limit where that lies in the
        image. Raises ValueError where the lens does not even show the middle of the image.
        """
        vectors, lens = self.outline, self.distortion
        if lens is not None and not self.has_ray(self._border()).all():
            return math.atan(lens.limit)
        return float(np.max(np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])))

    @cached_property
    def outline(self) -> Floats:
        """Unit vectors (33, 3) around what the camera sees, the last being the first again.

        They are those of the image's border. Where the lens has no ray for it, those of the last
        pixels that have one on the way to it from the middle of the image. For parity `auto` as
        for `normal`. Raises ValueError where the lens does not even show the middle.
        """
        size = np.array([self.width_px, self.height_px], float)
        if not self.has_ray(np.array([(x, y) for x in _MIDDLE for y in _MIDDLE]) * size).all():
            raise ValueError(NO_MIDDLE)
        border = self._border()
        shown = self.has_ray(border)
        if not shown.all():
            border = self._last_with_ray(np.where(shown[:, None], border, size / 2), border)
        return self.definite()[0].vectors(border)

    def _last_with_ray(self, low: Floats, high: Floats) -> Floats:
        """Return the last pixels (n, 2) with a ray from those that have one to those that may."""
        step = high - low
        for _ in range(_BISECTIONS):
            step = step / 2
            low = np.where(self.has_ray(low + step)[:, None], low + step, low)
        return low

    def _border(self) -> Floats:
        """Return pixels (33, 2) around the image, the last being the first again."""
        along = np.arange(_SIDE) / _SIDE
        back, none = 1 - along, np.zeros(_SIDE)
        unit = np.concatenate([
            np.column_stack([along, none]), np.column_stack([none + 1, along]),
            np.column_stack([back, none + 1]), np.column_stack([none, back]), [[0.0, 0.0]],
        ])
        return unit * (self.width_px, self.height_px)

    @cached_property
    def optics(self) -> Floats:
        """The camera as an array (31,) for compiled code; only of definite parity."""
        optics = np.zeros(OPTICS_SIZE) if self.distortion is None else self.distortion.lens.copy()
        optics[:LENS_AT] = (
            self.width_px, self.height_px, self.fx_px, self.fy_px, self.cx_px, self.cy_px,
            self._y_sign(), self.distortion is not None,
        )
        return optics

    def plane(self, xy_px: ArrayLike) -> Floats:
        """Return normalised coordinates X/Z, Y/Z (n, 2) of the optical frame for pixels (n, 2).

        Raises ValueError for a pixel that the lens has no ray for: see `has_ray`.
        """
        points, exists = _plane_of_pixels(self.optics, _rows(xy_px))
        if not exists.all():
            raise ValueError(NOT_INVERTIBLE)
        return np.asarray(points)

    def has_ray(self, xy_px: ArrayLike) -> NDArray[np.bool_]:
        """Return for which pixels (n, 2) the lens has a ray, in the image or not.

        Without distortion for all of them. A barrel lens may have none for the image's corners.
        """
        return np.asarray(_plane_of_pixels(self.definite()[0].optics, _rows(xy_px))[1])

    def pixels_of_plane(self, points: Floats) -> Floats:
        """Return pixels (n, 2) for normalised coordinates (n, 2): the inverse of `plane`.

        NaN for what is beyond the lens' limit (`Distortion.limit`): it has no pixel.
        """
        return np.asarray(_pixels_of_plane(self.optics, np.ascontiguousarray(points)))

    def vectors(self, xy_px: ArrayLike) -> Floats:
        """Return unit vectors (n, 3) in the optical frame for pixels (n, 2)."""
        return vectors_of_plane(self.plane(xy_px))

    def pixels(self, vectors: ArrayLike) -> Floats:
        """Return pixels (n, 2) for vectors (n, 3) of the optical frame.

        NaN for a vector beyond the lens' limit. Raises ValueError for one that is not in front of
        the camera (z <= 0).
        """
        v = np.asarray(vectors, float).reshape(-1, 3)
        if np.any(v[:, 2] <= 0):
            raise ValueError("a direction behind the camera has no pixel: drop those with z <= 0")
        return self.pixels_of_plane(v[:, :2] / v[:, 2:])

    def contains(self, xy_px: ArrayLike, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Return which pixels (n, 2) lie in the image, widened by a margin; NaN does not."""
        optics = self.definite()[0].optics
        return np.asarray(_in_image_all(optics, _rows(xy_px), float(margin_px)))

    def _y_sign(self) -> float:
        if self.parity == "auto":
            raise ValueError(
                "parity auto has no pixels of its own: use one of the cameras of definite()"
            )
        return -1.0 if self.parity == "mirrored" else 1.0


#: What is wrong with a camera that cannot be used at all.
NO_MIDDLE = (
    "the distortion has no ray for the middle of the image: "
    "check its coefficients and the principal point"
)


def _rows(xy_px: ArrayLike) -> Floats:
    return np.ascontiguousarray(xy_px, float).reshape(-1, 2)


@inlined
def plane_of_pixel(optics: Floats, x_px: float, y_px: float) -> tuple[float, float, bool]:
    """Return the normalised coordinates of a pixel, and whether the lens has a ray for it."""
    x, y = (x_px - optics[4]) / optics[2], (y_px - optics[5]) / optics[3]
    exists = True
    if optics[7] != 0.0:
        x, y, exists = undistort(optics, x, y)
    return x, y * optics[6], exists


@compiled
def pixel_of_plane(optics: Floats, x: float, y: float) -> tuple[float, float]:
    """Return the pixel of normalised coordinates: the inverse of `plane_of_pixel`.

    NaN beyond the lens' limit. The polynomial has a value there too, often one in the image.
    """
    y = y * optics[6]
    if optics[7] != 0.0:
        if not x * x + y * y <= optics[LIMIT_AT]:
            return np.nan, np.nan
        x, y = distort(optics, x, y)
    return x * optics[2] + optics[4], y * optics[3] + optics[5]


@inlined
def _beyond(at_px: float, size_px: float) -> float:
    """Return how far outside of 0 to a size a coordinate lies, less than 0 within: the border."""
    return max(-at_px, at_px - size_px)


@inlined
def in_image(optics: Floats, x_px: float, y_px: float, margin_px: float) -> bool:
    """Return whether a pixel lies in the image, widened by a margin; NaN does not."""
    # Without branches: they would cost more than the comparisons. Each by itself, since the
    # larger of a number and NaN may be the number.
    return (_beyond(x_px, optics[0]) <= margin_px) & (_beyond(y_px, optics[1]) <= margin_px)


@compiled
def outside_px(optics: Floats, points: Floats, n: int) -> None:
    """Write how far outside of the image normalised coordinates are: (n, 3), x, y, pixels.

    Infinitely far where the lens has no pixel for them. Without a lens in a loop of its own, which
    is several times as fast.
    """
    if optics[7] == 0.0:
        for i in range(n):
            x_px = points[i, 0] * optics[2] + optics[4]
            y_px = points[i, 1] * optics[6] * optics[3] + optics[5]
            points[i, 2] = max(_beyond(x_px, optics[0]), _beyond(y_px, optics[1]))
        return
    for i in range(n):
        x_px, y_px = pixel_of_plane(optics, points[i, 0], points[i, 1])
        outside = max(_beyond(x_px, optics[0]), _beyond(y_px, optics[1]))
        points[i, 2] = outside if np.isfinite(x_px + y_px) else np.inf


@compiled
def _plane_of_pixels(optics: Floats, xy_px: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    points, exists = np.empty(xy_px.shape), np.empty(len(xy_px), np.bool_)
    for i in range(len(xy_px)):
        points[i, 0], points[i, 1], exists[i] = plane_of_pixel(optics, xy_px[i, 0], xy_px[i, 1])
    return points, exists


@compiled
def _pixels_of_plane(optics: Floats, points: Floats) -> Floats:
    xy_px = np.empty(points.shape)
    for i in range(len(points)):
        xy_px[i, 0], xy_px[i, 1] = pixel_of_plane(optics, points[i, 0], points[i, 1])
    return xy_px


@compiled
def _in_image_all(optics: Floats, xy_px: Floats, margin_px: float) -> NDArray[np.bool_]:
    inside = np.empty(len(xy_px), np.bool_)
    for i in range(len(xy_px)):
        inside[i] = in_image(optics, xy_px[i, 0], xy_px[i, 1], margin_px)
    return inside
