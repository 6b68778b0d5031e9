"""Lens distortion in the models that `sensor_msgs/CameraInfo` names.

Points are normalised image coordinates (n, 2): X/Z and Y/Z of the optical frame, no unit. The
models are those of Brown (1966) as OpenCV writes them (`plumb_bob`, `rational_polynomial`, the
latter also with its thin prism and its tilted sensor) and of Kannala and Brandt (2006)
(`equidistant`).

A polynomial is a lens only as far from the axis as it rises. Beyond its turning point it comes
back into the image, where no ray of the scene goes. Each lens therefore has a limit: the largest
radius of an ideal point out to which it maps one to one in all directions. Nothing beyond it has a
pixel, and no pixel has a ray from beyond it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats

#: Numbers of coefficients that each model takes, in OpenCV's order: k1 k2 p1 p2 k3, k4 k5 k6,
#: s1 s2 s3 s4 (thin prism), tau_x tau_y (tilt of the sensor, rad); k1 k2 k3 k4 of a fisheye.
MODELS = {"plumb_bob": (5,), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
#: What compiled code knows of a lens are the last numbers of an array whose first ones are the
#: camera's (`Camera.optics`): eight coefficients of Brown's model, or four of the equidistant one,
#: and which of them it is; the square of the limit; four coefficients of the thin prism and the
#: matrix (3, 3) of the tilt. One array, as taking it apart for each star would cost more than the
#: lens itself.
LENS_AT, OPTICS_SIZE = 8, 31
_KIND, LIMIT_AT, _PRISM, _TILT = 16, 17, 18, 22
_BROWN, _EQUIDISTANT, _TILTED = 0.0, 1.0, 2.0
#: A pinhole's image plane ends near 90 deg from the axis: so far a lens is followed.
_FARTHEST_RAD = 1.55
#: Steps of the way out, bisections of the one in which a lens turns, directions of a lens that is
#: not the same all around.
_STEPS_OUT, _BISECTIONS, _DIRECTIONS = 128, 40, 16
_MAX_ITERATIONS = 50
_CONVERGED = 1e-12
_STEP = 1e-7
#: Halvings of a step of Newton's method, and the share of the squared error that may be left after
#: one: a step of 1/64 leaves less. Nothing helps where there is no ray.
_HALVINGS, _LEFT = 7, 0.98
#: From where a point beyond the limit is sought, in limits: at the limit itself is no slope.
_START = 0.9


@dataclass(frozen=True)
class Distortion:
    """A distortion model with its coefficients, in the order of `CameraInfo.d`.

    Raises ValueError for an unknown model, a wrong number of coefficients, one that is not finite
    or a sensor that is tilted by 90 deg or more.
    """

    model: str
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(
                f"unknown distortion model {self.model!r}: use one of {', '.join(MODELS)}"
            )
        lengths = MODELS[self.model]
        if len(self.coefficients) not in lengths:
            raise ValueError(
                f"distortion model {self.model} takes {' or '.join(map(str, lengths))} "
                f"coefficients, not {len(self.coefficients)}"
            )
        if not np.all(np.isfinite(self.coefficients)):
            raise ValueError("distortion coefficients must be finite numbers")
        if max(map(abs, self.coefficients[12:]), default=0.0) >= np.pi / 2:
            raise ValueError("the sensor's tilt, coefficients 13 and 14, must be below 90 deg")

    @cached_property
    def lens(self) -> Floats:
        """The model in an array (31,) for compiled code, the camera's numbers being 0."""
        lens, c = np.zeros(OPTICS_SIZE), self.coefficients
        lens[LENS_AT : LENS_AT + len(c[:8])] = c[:8]
        lens[_KIND] = _EQUIDISTANT if self.model == "equidistant" else _BROWN
        if any(c[8:]):
            lens[_KIND] = _TILTED
            lens[_PRISM:_TILT] = c[8:12]
            lens[_TILT:] = _tilt_matrix(*(c[12:] or (0.0, 0.0))).ravel()
        lens[LIMIT_AT] = _limit2(lens)
        return lens

    @property
    def limit(self) -> float:
        """Largest radius of an ideal point that the lens shows: the tangent of its angle."""
        return float(np.sqrt(self.lens[LIMIT_AT]))

    def distort(self, points: Floats) -> Floats:
        """Map ideal points (n, 2) to where the lens puts them, or would beyond its limit."""
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


def _tilt_matrix(tau_x: float, tau_y: float) -> Floats:
    """Return the matrix (3, 3) that projects onto a tilted sensor (OpenCV, calib3d; Scheimpflug).

    The sensor is turned by tau_x about x, then by tau_y about y, and seen through its projection
    along the axis, so that the axis stays where it is.
    """
    (sx, cx), (sy, cy) = ((np.sin(tau), np.cos(tau)) for tau in (tau_x, tau_y))
    turned = np.array([[cy, sy * sx, -sy * cx], [0, cx, sx], [sy, -cy * sx, cy * cx]])
    depth = turned[2, 2]
    matrix = np.vstack([
        depth * turned[0] - turned[0, 2] * turned[2], depth * turned[1] - turned[1, 2] * turned[2],
        turned[2],
    ])
    matrix[:2, 2] = 0.0  # exactly
    return matrix


@compiled
def distort(lens: Floats, x: float, y: float) -> tuple[float, float]:
    """Return where a lens (31,) puts the ideal point (x, y)."""
    if lens[_KIND] == _EQUIDISTANT:
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
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    if lens[_KIND] == _BROWN:
        return bent_x, bent_y
    bent_x += r2 * (lens[_PRISM] + r2 * lens[_PRISM + 1])
    bent_y += r2 * (lens[_PRISM + 2] + r2 * lens[_PRISM + 3])
    m = lens[_TILT:]
    depth = m[6] * bent_x + m[7] * bent_y + m[8]
    return (
        (m[0] * bent_x + m[1] * bent_y + m[2]) / depth,
        (m[3] * bent_x + m[4] * bent_y + m[5]) / depth,
    )


@compiled
def undistort(lens: Floats, x: float, y: float) -> tuple[float, float, bool]:
    """Return the ideal point that a lens (31,) puts at (x, y), and whether there is one."""
    ideal_x, ideal_y = x, y
    if not x * x + y * y <= lens[LIMIT_AT]:
        within = _START * np.sqrt(lens[LIMIT_AT] / (x * x + y * y))
        ideal_x, ideal_y = x * within, y * within
    at_x, at_y = distort(lens, ideal_x, ideal_y)
    for _ in range(_MAX_ITERATIONS):
        error_x, error_y = at_x - x, at_y - y
        if abs(error_x) < _CONVERGED and abs(error_y) < _CONVERGED:
            return ideal_x, ideal_y, True
        xx, xy, yx, yy = _jacobian(lens, ideal_x, ideal_y)
        determinant = xx * yy - xy * yx
        step_x = (error_x * yy - error_y * yx) / determinant
        step_y = (error_y * xx - error_x * xy) / determinant
        enough, nearer = _LEFT * (error_x * error_x + error_y * error_y), False
        for _ in range(_HALVINGS):
            new_x, new_y = ideal_x - step_x, ideal_y - step_y
            at_x, at_y = distort(lens, new_x, new_y)
            nearer = (at_x - x) ** 2 + (at_y - y) ** 2 < enough
            nearer &= new_x * new_x + new_y * new_y <= lens[LIMIT_AT]
            if nearer:
                break
            step_x, step_y = 0.5 * step_x, 0.5 * step_y
        if not nearer:
            break
        ideal_x, ideal_y = new_x, new_y
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
def _limit2(lens: Floats) -> float:
    """Return the square of the largest radius out to which a lens maps one to one.

    Followed from the axis outwards, in small steps at first, for the less an angle is the finer a
    polynomial can turn within it; in one direction where all are alike.
    """
    alike = lens[_KIND] == _EQUIDISTANT or (lens[_KIND] == _BROWN and lens[10] == lens[11] == 0.0)
    limit_rad = _FARTHEST_RAD
    for i in range(1 if alike else _DIRECTIONS):
        azimuth = 2 * np.pi * i / _DIRECTIONS
        low = high = 0.0
        for step in range(1, _STEPS_OUT + 1):
            high = _FARTHEST_RAD * (step / _STEPS_OUT) ** 2
            if low >= limit_rad or not _goes_on(lens, azimuth, high):
                break
            low = high
        for _ in range(_BISECTIONS if low < high else 0):
            middle = 0.5 * (low + high)
            if _goes_on(lens, azimuth, middle):
                low = middle
            else:
                high = middle
        limit_rad = min(limit_rad, low)
    return float(np.tan(limit_rad) ** 2)


@compiled
def _goes_on(lens: Floats, azimuth: float, angle_rad: float) -> bool:
    """Return whether a lens maps one to one about the ray so far from its axis, on its side."""
    r = np.tan(angle_rad)
    x, y = r * np.cos(azimuth), r * np.sin(azimuth)
    xx, xy, yx, yy = _jacobian(lens, x, y)
    at_x, at_y = distort(lens, x, y)
    # Written so that what is not a number is refused too.
    return bool(xx * yy - xy * yx > 0.0 and x * at_x + y * at_y > 0.0)


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
