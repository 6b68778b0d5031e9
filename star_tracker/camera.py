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
from numpy.typing import ArrayLike

from star_tracker.distortion import Distortion
from star_tracker.spherical import Floats

PARITIES = ("normal", "mirrored", "auto")
#: Fields of view outside of this range are refused: no star pair fits, or no pinhole does.
FOV_RANGE_DEG = (0.5, 120.0)


def vectors_of_plane(points: Floats) -> Floats:
    """Return unit vectors (n, 3) for normalised coordinates X/Z, Y/Z (n, 2)."""
    vectors = np.column_stack([points, np.ones(len(points))])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


@dataclass(frozen=True)
class Camera:
    """A camera's intrinsics, in pixels. Raises ValueError for values no camera can have."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    parity: str = "normal"
    distortion: Distortion | None = field(default=None)

    def __post_init__(self) -> None:
        if self.parity not in PARITIES:
            raise ValueError(f"parity {self.parity!r} is unknown: use {', '.join(PARITIES)}")
        if not (0 < self.width_px < 1e6 and 0 < self.height_px < 1e6):
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

    @classmethod
    def from_fov(
        cls,
        fov_deg: float,
        width_px: int,
        height_px: int,
        *,
        cx_px: float | None = None,
        cy_px: float | None = None,
        parity: str = "normal",
    ) -> "Camera":
        """Return a camera without distortion from the field of view across its width (4-16)."""
        low, high = FOV_RANGE_DEG
        if not low <= fov_deg <= high:  # also refuses NaN
            raise ValueError(
                f"fov_deg {fov_deg:g} is outside of {low:g} to {high:g}: "
                "give the full angle across the width of the image in degrees"
            )
        focal = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
        cx = width_px / 2 if cx_px is None else cx_px
        cy = height_px / 2 if cy_px is None else cy_px
        return cls(width_px, height_px, focal, focal, cx, cy, parity)

    @property
    def fov_deg(self) -> float:
        """Full angle across the width of the image, degrees."""
        return math.degrees(2 * math.atan(self.width_px / 2 / self.fx_px))

    @property
    def focal_length_px(self) -> float:
        """Mean focal length: the scale by which small angles (rad) become pixels."""
        return math.sqrt(self.fx_px * self.fy_px)

    @property
    def area_px2(self) -> float:
        """Area of the image."""
        return float(self.width_px) * self.height_px

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
        """Largest angle between the boresight and a point of the image's border."""
        along = np.linspace(0.0, 1.0, 9)
        w, h = float(self.width_px), float(self.height_px)
        border = np.concatenate([
            np.column_stack([along * w, 0 * along]), np.column_stack([along * w, 0 * along + h]),
            np.column_stack([0 * along, along * h]), np.column_stack([0 * along + w, along * h]),
        ])
        vectors = self.definite()[0].vectors(border)
        return float(np.max(np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])))

    def plane(self, xy_px: ArrayLike) -> Floats:
        """Return normalised coordinates X/Z, Y/Z (n, 2) of the optical frame for pixels (n, 2)."""
        sign = self._y_sign()
        points = (np.asarray(xy_px, float).reshape(-1, 2) - (self.cx_px, self.cy_px)) / (
            self.fx_px, self.fy_px,
        )
        if self.distortion is not None:
            points = self.distortion.undistort(points)
        return points * (1.0, sign)

    def pixels_of_plane(self, points: Floats) -> Floats:
        """Return pixels (n, 2) for normalised coordinates (n, 2): the inverse of `plane`."""
        points = points * (1.0, self._y_sign())
        if self.distortion is not None:
            points = self.distortion.distort(points)
        return points * (self.fx_px, self.fy_px) + (self.cx_px, self.cy_px)

    def vectors(self, xy_px: ArrayLike) -> Floats:
        """Return unit vectors (n, 3) in the optical frame for pixels (n, 2)."""
        return vectors_of_plane(self.plane(xy_px))

    def pixels(self, vectors: ArrayLike) -> Floats:
        """Return pixels (n, 2) for vectors (n, 3) of the optical frame.

        Raises ValueError for a vector that is not in front of the camera (z <= 0).
        """
        v = np.asarray(vectors, float).reshape(-1, 3)
        if np.any(v[:, 2] <= 0):
            raise ValueError("a direction behind the camera has no pixel: drop those with z <= 0")
        return self.pixels_of_plane(v[:, :2] / v[:, 2:])

    def contains(self, xy_px: Floats, margin_px: float = 0.0) -> np.ndarray:
        """Return which pixels (n, 2) lie in the image, widened by a margin; NaN does not."""
        x, y = xy_px[:, 0], xy_px[:, 1]
        inside = (x >= -margin_px) & (x <= self.width_px + margin_px)
        return inside & (y >= -margin_px) & (y <= self.height_px + margin_px)

    def _y_sign(self) -> float:
        if self.parity == "auto":
            raise ValueError(
                "parity auto has no pixels of its own: use one of the cameras of definite()"
            )
        return -1.0 if self.parity == "mirrored" else 1.0
