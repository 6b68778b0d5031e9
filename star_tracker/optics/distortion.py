"""Lens distortion in the models that `sensor_msgs/CameraInfo` names.

Points are normalised image coordinates (n, 2): X/Z and Y/Z of the optical frame, no unit. The
models are those of Brown (1966) as OpenCV writes them (`plumb_bob`, `rational_polynomial`) and of
Kannala and Brandt (2006) (`equidistant`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats

#: Number of coefficients that each model takes.
MODELS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
#: What compiled code knows of a lens are the last numbers of an array whose first ones are the
#: camera's (`Camera.optics`): eight coefficients of Brown's model, or four of the equidistant one,
#: and which of them it is. One array, as taking it apart for each star would cost more than the
#: lens itself.
LENS_AT, OPTICS_SIZE = 8, 17
_EQUIDISTANT = 1.0
_MAX_ITERATIONS = 50
_CONVERGED = 1e-12
_STEP = 1e-7
_STEPS_FROM_AXIS = 33


@dataclass(frozen=True)
class Distortion:
    """A distortion model with its coefficients, in the order of `CameraInfo.d`.

    Raises ValueError for an unknown model, a wrong number of coefficients or a non-finite one.
    """

    model: str
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(
                f"unknown distortion model {self.model!r}: use one of {', '.join(MODELS)}"
            )
        expected = MODELS[self.model]
        if len(self.coefficients) != expected:
            raise ValueError(
                f"distortion model {self.model} takes {expected} coefficients, "
                f"not {len(self.coefficients)}"
            )
        if not np.all(np.isfinite(self.coefficients)):
            raise ValueError("distortion coefficients must be finite numbers")

    @cached_property
    def lens(self) -> Floats:
        """The model in an array (17,) for compiled code, the camera's numbers being 0."""
        lens = np.zeros(OPTICS_SIZE)
        lens[LENS_AT : LENS_AT + len(self.coefficients)] = self.coefficients
        if self.model == "equidistant":
            lens[-1] = _EQUIDISTANT
        return lens

    def distort(self, points: Floats) -> Floats:
        """Map ideal points (n, 2) to where the lens puts them."""
        return np.asarray(_distort_all(self.lens, np.ascontiguousarray(points)))

    def undistort(self, points: Floats) -> Floats:
        """Invert `distort` by Newton's method.

        Raises ValueError where no ray of the scene lands on a point, also where the polynomial
        reaches it again beyond its turning point or on the other side of the axis.
        """
        ideal, every = _undistort_all(self.lens, np.ascontiguousarray(points))
        if not every:
            raise ValueError(NOT_INVERTIBLE)
        return np.asarray(ideal)


NOT_INVERTIBLE = (
    "the distortion cannot be inverted for a point of the image: "
    "check the coefficients of the calibration"
)


@compiled
def distort(lens: Floats, x: float, y: float) -> tuple[float, float]:
    """Return where a lens (17,) puts the ideal point (x, y)."""
    if lens[16] == _EQUIDISTANT:
        r = np.hypot(x, y)
        if r == 0.0:
            return x, y
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (lens[8] + t2 * (lens[9] + t2 * (lens[10] + t2 * lens[11]))))
        return x * (bent / r), y * (bent / r)
    k1, k2, p1, p2, k3 = lens[8], lens[9], lens[10], lens[11], lens[12]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (
        1 + r2 * (lens[13] + r2 * (lens[14] + r2 * lens[15]))
    )
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


@compiled
def undistort(lens: Floats, x: float, y: float) -> tuple[float, float, bool]:
    """Return the ideal point that a lens (17,) puts at (x, y), and whether there is one."""
    ideal_x, ideal_y = x, y
    for _ in range(_MAX_ITERATIONS):
        at_x, at_y = distort(lens, ideal_x, ideal_y)
        error_x, error_y = at_x - x, at_y - y
        if abs(error_x) < _CONVERGED and abs(error_y) < _CONVERGED:
            return ideal_x, ideal_y, _reachable(lens, ideal_x, ideal_y)
        xx, xy, yx, yy = _jacobian(lens, ideal_x, ideal_y)
        determinant = xx * yy - xy * yx
        ideal_x -= (error_x * yy - error_y * yx) / determinant
        ideal_y -= (error_y * xx - error_x * xy) / determinant
    return ideal_x, ideal_y, False


@compiled
def _jacobian(lens: Floats, x: float, y: float) -> tuple[float, float, float, float]:
    """Return the derivatives of `distort`: of x and y by x, then of x and y by y."""
    x1, y1 = distort(lens, x + _STEP, y)
    x0, y0 = distort(lens, x - _STEP, y)
    x3, y3 = distort(lens, x, y + _STEP)
    x2, y2 = distort(lens, x, y - _STEP)
    scale = 1.0 / (2 * _STEP)
    return (x1 - x0) * scale, (y1 - y0) * scale, (x3 - x2) * scale, (y3 - y2) * scale


@compiled
def _reachable(lens: Floats, x: float, y: float) -> bool:
    """Return whether the lens maps one-to-one all the way from the axis to a point."""
    for step in range(_STEPS_FROM_AXIS):
        part = step / (_STEPS_FROM_AXIS - 1)
        xx, xy, yx, yy = _jacobian(lens, part * x, part * y)
        # Written so that a determinant that is not a number is refused too.
        if not xx * yy - xy * yx > 0.0:
            return False
    return True


@compiled
def _distort_all(lens: Floats, points: Floats) -> Floats:
    result = np.empty(points.shape)
    for i in range(len(points)):
        result[i, 0], result[i, 1] = distort(lens, points[i, 0], points[i, 1])
    return result


@compiled
def _undistort_all(lens: Floats, points: Floats) -> tuple[Floats, bool]:
    result, every = np.empty(points.shape), True
    for i in range(len(points)):
        x, y, exists = undistort(lens, points[i, 0], points[i, 1])
        result[i, 0], result[i, 1] = x, y
        every = every and exists
    return result, every
