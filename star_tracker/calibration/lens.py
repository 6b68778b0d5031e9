"""The camera from one frame of identified stars: joint least squares of attitude and lens.

Attitude and focal length are always fitted. The principal point and the radial distortion terms
k1 and k2 (Brown 1966, as `distortion.plumb_bob`) join only where they make the residuals smaller
by more than noise does: in a narrow field a shifted principal point is nearly a rotation, and a
few stars cannot tell them apart.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import ArrayLike

from star_tracker.attitude.attitude import Attitude
from star_tracker.attitude.wahba import wahba
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

#: The parameters of each term, in the order of the fit.
TERMS = {"principal_point": ("cx_px", "cy_px"), "k1": ("k1",), "k2": ("k2",)}
#: A term joins where an F test gives its gain this chance of being noise.
SIGNIFICANCE = 0.001
_N_ATTITUDE = 3


@dataclass(frozen=True)
class Calibration:
    """A fitted camera.

    Attributes:
        camera: the camera with the fitted values.
        terms: the terms that were fitted beside attitude and focal length.
        names: the camera's fitted parameters: `focal_length_px`, then those of the terms.
        values: their values; distortion coefficients have no unit.
        standard_errors: of the values, from the residuals.
        covariance: (3 + p, 3 + p) of the rotation about the camera's axes, rad, and the values.
        attitude: with its covariance, which includes what the camera's uncertainty adds.
        residuals_px: (n, 2) measured minus predicted.
        sigma_px: noise of a centroid along each axis, as the residuals show it.
        degrees_of_freedom: 2 n less the fitted parameters.
    """

    camera: Camera
    terms: tuple[str, ...]
    names: tuple[str, ...]
    values: Floats
    standard_errors: Floats
    covariance: Floats
    attitude: Attitude
    residuals_px: Floats
    sigma_px: float
    degrees_of_freedom: int


@dataclass(frozen=True)
class _Problem:
    """Centroids (n, 2) and ICRS unit vectors (n, 3) of one frame, with where to start."""

    camera: Camera
    xy_px: Floats
    star_vectors: Floats
    rotation: Floats

    def camera_of(self, values: Floats, terms: tuple[str, ...]) -> Camera:
        """Return the camera with focal length values[0] and the terms' values after it."""
        given = self.camera
        scale = float(values[0]) / given.focal_length_px
        named = dict(zip(_names(terms)[1:], map(float, values[1:]), strict=True))
        radial = (named.get("k1", 0.0), named.get("k2", 0.0), 0.0, 0.0, 0.0)
        return replace(
            given, fx_px=given.fx_px * scale, fy_px=given.fy_px * scale,
            cx_px=named.get("cx_px", given.cx_px), cy_px=named.get("cy_px", given.cy_px),
            distortion=Distortion("plumb_bob", radial) if "k1" in named else given.distortion,
        )

    def rotation_of(self, parameters: Floats) -> Floats:
        """Return the rotation (3, 3), camera to ICRS, that the first three parameters turn."""
        turn = scipy.spatial.transform.Rotation.from_rotvec(parameters[:_N_ATTITUDE]).as_matrix()
        return np.asarray(self.rotation @ turn)

    def residuals(self, terms: tuple[str, ...]) -> Callable[[Floats], Floats]:
        """Return the function of all parameters that gives the residuals (2 n,), pixels."""

        def function(parameters: Floats) -> Floats:
            camera = self.camera_of(parameters[_N_ATTITUDE:], terms)
            predicted = camera.pixels(self.star_vectors @ self.rotation_of(parameters))
            return np.asarray(self.xy_px - predicted).ravel()

        return function

    def start(self, terms: tuple[str, ...]) -> Floats:
        """Return the parameters to start from: no turn, the camera as given, no distortion."""
        given = {
            "focal_length_px": self.camera.focal_length_px,
            "cx_px": self.camera.cx_px, "cy_px": self.camera.cy_px,
        }
        return np.array([0.0] * _N_ATTITUDE + [given.get(name, 0.0) for name in _names(terms)])

    def fit(self, terms: tuple[str, ...]) -> Calibration:
        """Fit these terms. Raises ValueError where the stars do not determine them."""
        start = self.start(terms)
        free = 2 * len(self.xy_px) - len(start)
        if free < 1:
            raise ValueError(
                f"{len(self.xy_px)} stars do not determine {len(start)} parameters: "
                f"{len(start) // 2 + 1} or more are needed"
            )
        fitted = scipy.optimize.least_squares(
            self.residuals(terms), start, jac="2-point", x_scale="jac", method="trf", xtol=1e-12,
            ftol=1e-12, gtol=1e-12,
        )
        scale = np.linalg.norm(fitted.jac, axis=0)
        if not fitted.success or np.linalg.matrix_rank(fitted.jac / scale, tol=1e-7) < len(start):
            raise ValueError("the stars do not determine the camera: they lie too close together")
        sigma = float(np.sqrt(2 * fitted.cost / free))
        scaled = np.linalg.inv((fitted.jac / scale).T @ (fitted.jac / scale))
        covariance = sigma**2 * scaled / np.outer(scale, scale)
        values = fitted.x[_N_ATTITUDE:]
        turned = covariance[:_N_ATTITUDE, :_N_ATTITUDE]
        return Calibration(
            self.camera_of(values, terms), terms, _names(terms), values,
            np.sqrt(np.diag(covariance))[_N_ATTITUDE:], covariance,
            Attitude.from_rotation(self.rotation_of(fitted.x), turned),
            fitted.fun.reshape(-1, 2), sigma, free,
        )


def calibrate(
    camera: Camera,
    xy_px: ArrayLike,
    star_vectors: ArrayLike,
    *,
    terms: tuple[str, ...] | None = None,
) -> Calibration:
    """Fit attitude, focal length and further terms to a frame's identified stars.

    Args:
        camera: where to start, of definite parity. Its distortion, where it has one, is kept and
            radial terms are not fitted. The ratio of fx and fy is kept.
        xy_px: (n, 2) centroids of the identified stars, displaced ones not among them.
        star_vectors: (n, 3) their unit vectors, ICRS.
        terms: of `TERMS`, what to fit beside attitude and focal length; None for what the data
            support: in the order principal point, k1, k2 those whose F test has a chance below
            `SIGNIFICANCE`, k2 only after k1.

    Raises ValueError for a wrong shape, an unknown term, or stars that do not determine the fit.
    """
    xy, stars = np.asarray(xy_px, float), np.asarray(star_vectors, float)
    if xy.ndim != 2 or xy.shape[1] != 2 or stars.shape != (len(xy), 3):
        raise ValueError(
            f"centroids {xy.shape} and star vectors {stars.shape} must be (n, 2) and (n, 3)"
        )
    unknown = [term for term in terms or () if term not in TERMS]
    if unknown:
        raise ValueError(f"term {unknown[0]!r} is unknown: use {', '.join(TERMS)}")
    if camera.distortion is not None and set(terms or ()) & {"k1", "k2"}:
        raise ValueError("k1 and k2 are fitted to a camera without distortion only")
    if "k2" in (terms or ()) and "k1" not in (terms or ()):
        raise ValueError("k2 is fitted only together with k1")
    problem = _Problem(camera, xy, stars, wahba(camera.vectors(xy), stars))
    if terms is not None:
        return problem.fit(tuple(term for term in TERMS if term in terms))
    return _supported(problem)


def _supported(problem: _Problem) -> Calibration:
    """Fit, adding terms while the most significant of those left is significant."""
    best = problem.fit(())
    while True:
        trials = []
        for term in TERMS:
            done = term in best.terms or (term == "k2" and "k1" not in best.terms)
            if done or (term != "principal_point" and problem.camera.distortion is not None):
                continue
            terms = tuple(t for t in TERMS if t == term or t in best.terms)
            if 2 * len(problem.xy_px) <= _N_ATTITUDE + len(_names(terms)):
                continue
            trial = problem.fit(terms)
            trials.append((_chance(best, trial), trial))
        chance, trial = min(trials, key=lambda pair: pair[0], default=(1.0, best))
        if not chance < SIGNIFICANCE:
            return best
        best = trial


def _chance(small: Calibration, large: Calibration) -> float:
    """Return the chance that noise alone gains as much as `large` does over `small` (F test)."""
    added = small.degrees_of_freedom - large.degrees_of_freedom
    before, after = (float(np.sum(fit.residuals_px**2)) for fit in (small, large))
    if after == 0:
        return 0.0 if before > 0 else 1.0
    gain = (before - after) / added / (after / large.degrees_of_freedom)
    return float(scipy.special.fdtrc(added, large.degrees_of_freedom, gain))


def _names(terms: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the camera's fitted parameters."""
    return ("focal_length_px", *(name for term in terms for name in TERMS[term]))
