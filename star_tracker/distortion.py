"""Lens distortion in the models that `sensor_msgs/CameraInfo` names.

Points are normalised image coordinates (n, 2): X/Z and Y/Z of the optical frame, no unit. The
models are those of Brown (1966) as OpenCV writes them (`plumb_bob`, `rational_polynomial`) and of
Kannala and Brandt (2006) (`equidistant`).
"""

from dataclasses import dataclass

import numpy as np

from star_tracker.spherical import Floats

#: Number of coefficients that each model takes.
MODELS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
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

    def distort(self, points: Floats) -> Floats:
        """Map ideal points (n, 2) to where the lens puts them."""
        if self.model == "equidistant":
            return self._equidistant(points)
        k1, k2, p1, p2, k3, *denominator = self.coefficients
        k4, k5, k6 = denominator or (0.0, 0.0, 0.0)
        x, y = points[:, 0], points[:, 1]
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return np.column_stack([
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ])

    def _equidistant(self, points: Floats) -> Floats:
        k1, k2, k3, k4 = self.coefficients
        r = np.hypot(points[:, 0], points[:, 1])
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        return points * np.where(r > 0, bent / np.where(r > 0, r, 1.0), 1.0)[:, None]

    def undistort(self, points: Floats) -> Floats:
        """Invert `distort` by Newton's method, all points at once.

        Raises ValueError where no ray of the scene lands on a point, also where the polynomial
        reaches it again beyond its turning point or on the other side of the axis.
        """
        ideal: Floats = points.copy()
        # Points far off a pole of the model overflow; they are refused below.
        with np.errstate(all="ignore"):
            for _ in range(_MAX_ITERATIONS):
                error = self.distort(ideal) - points
                dx, dy, determinant = self._jacobian(ideal)
                if np.max(np.abs(error), initial=0.0) < _CONVERGED:
                    break
                ideal = ideal - np.column_stack([
                    (error[:, 0] * dy[:, 1] - error[:, 1] * dy[:, 0]) / determinant,
                    (error[:, 1] * dx[:, 0] - error[:, 0] * dx[:, 1]) / determinant,
                ])
            if not np.all(np.abs(error) < _CONVERGED) or not self._reachable(ideal):
                raise ValueError(
                    "the distortion cannot be inverted for a point of the image: "
                    "check the coefficients of the calibration"
                )
        return ideal

    def _jacobian(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the derivatives of `distort` by x and y, each (n, 2), and the determinant."""
        step_x, step_y = np.array([[_STEP, 0.0]]), np.array([[0.0, _STEP]])
        dx = (self.distort(points + step_x) - self.distort(points - step_x)) / (2 * _STEP)
        dy = (self.distort(points + step_y) - self.distort(points - step_y)) / (2 * _STEP)
        return dx, dy, dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]

    def _reachable(self, points: Floats) -> bool:
        """Return whether the lens maps one-to-one all the way from the axis to each point."""
        way = np.linspace(0.0, 1.0, _STEPS_FROM_AXIS)[:, None, None] * points
        return bool(np.all(self._jacobian(way.reshape(-1, 2))[2] > 0))
