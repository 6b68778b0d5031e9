"""A camera from many solved frames: an information filter over focal length and lens.

Each frame has an attitude of its own; eliminated, it leaves what the frame's stars tell about the
camera: an information matrix and a gradient about the camera as it is believed now. They add up
(an extended Kalman filter in information form; Maybeck 1979, 5.7). What a narrow field or few
stars cannot tell keeps its prior: no lens bends without stars that show it.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.camera_model import CameraModel
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera

Index = NDArray[np.int64]

#: Noise of a centroid beforehand, px, worth so many residuals; and never less than this.
_SIGMA_PX, _SIGMA_FREEDOM, _SIGMA_FLOOR_PX = 0.7, 4.0, 0.02
#: A frame disagrees whose stars lie farther from where the camera believed puts them than so many
#: times the noise; so many in a row say that the optics are others.
_GATE, _ALL_WRONG = 6.0, 5
#: Where the parameters begin that a lens off the axis shows in: p1, p2 and the principal point.
_UNBENT = 3
#: Stars that a frame needs to tell anything beside its attitude.
MIN_STARS = 5
#: Huber's limit of a residual, in standard deviations.
_HUBER = 2.0
#: Steps of a fit, and what is so small, in standard deviations, that none more is needed.
_STEPS, _SMALL_STEP = 5, 0.05
#: A frame is begun with this part of its stars, the inner ones.
_INNER = 0.6
#: A star is looked for within so many standard deviations of where it should be, if that is at
#: most this part of the mean distance of two centroids: else one in ten that are not seen would
#: get a wrong one.
_REACH, _MOST_APART, _ROUNDS = 3.0, 0.18, 8


@dataclass(frozen=True)
class _Fit:
    """What a frame and all before it say: values and information (p,) and (p, p).

    The frame's rotation (3, 3), how its pose gives way to the camera (3, p), and what is left of
    its residuals (2 n,), px.
    """

    values: Floats
    information: Floats
    rotation: Floats
    gain: Floats
    left: Floats


@dataclass(frozen=True)
class CameraEstimate:
    """What is known of a camera.

    Attributes:
        camera: as estimated, its `tolerance_percent` three standard errors of the focal length.
        names: of the parameters that were estimated.
        covariance: (p, p) of these.
        sigma_px: noise of a centroid along each axis, as the residuals show it.
        n_frames: frames that went in.
        n_left_out: frames that did not: too few stars, or too far off.
    """

    camera: Camera
    names: tuple[str, ...]
    covariance: Floats
    sigma_px: float
    n_frames: int
    n_left_out: int

    @property
    def standard_errors(self) -> Floats:
        """Of the parameters (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


class CameraEstimator:
    """Follows one camera over frames whose stars are identified.

    Args:
        camera: as first found, of definite parity. Its distortion, where it is of another model,
            is kept and only the focal length is followed.
        tolerance: standard deviation of its log focal length beforehand.
        told: where its principal point, then followed too, and its tangential terms are believed
            to be beforehand; None = the principal point stays where it is.
    """

    def __init__(self, camera: Camera, tolerance: float, *, told: Camera | None = None) -> None:
        self._model = CameraModel(camera, with_center=told is not None)
        self._values = self._model.start
        self._mean = self._values.copy()
        if told is not None:
            self._mean[_UNBENT:] = self._model.values_of(told)[_UNBENT:]
        self._information = np.diag(self._model.deviations(tolerance) ** -2.0)
        self._squares, self._freedom = _SIGMA_FREEDOM * _SIGMA_PX**2, _SIGMA_FREEDOM
        self._n_frames = self._n_left_out = self._n_wrong_in_a_row = 0

    @property
    def optics_changed(self) -> bool:
        """Whether so many frames in a row disagree that the camera must be another one."""
        return self._n_wrong_in_a_row >= _ALL_WRONG

    @property
    def estimate(self) -> CameraEstimate:
        """What is known so far."""
        covariance = np.asarray(np.linalg.inv(self._information))
        camera = self._model.camera(self._values)
        tolerance_percent = min(100 * 3 * float(np.sqrt(covariance[0, 0])), 5.0)
        return CameraEstimate(
            replace(camera, tolerance_percent=tolerance_percent), self._model.names, covariance,
            self._sigma_px, self._n_frames, self._n_left_out,
        )

    def add_frame(
        self, xy_px: Floats, guides: Floats, seeds: tuple[Index, Index]
    ) -> tuple[Index, Index] | None:
        """Take in a frame of which some stars are identified; others are found with them.

        A lens that is not known well keeps most stars away from where they are looked for. Where
        each may be follows from how well the camera is known, and each that is found makes it
        better known: the frame is gone through until no more come.

        Args:
            xy_px: (n, 2) all centroids.
            guides: (m, 3) unit vectors of the guide stars, ICRS.
            seeds: identified centroids (k,) and their guide stars (k,).

        Returns the centroids and guide stars that were used, None where the frame disagreed.
        """
        observed, catalog = self._inner(xy_px, seeds)
        fit = self._fit(xy_px[observed], guides[catalog])
        if fit is None or not self._agrees(xy_px[observed], guides[catalog]):
            self._take(fit, xy_px[observed], guides[catalog])
            return None
        for _ in range(_ROUNDS):
            found = self._found(fit, xy_px, guides)
            better = self._fit(xy_px[found[0]], guides[found[1]])
            if better is None:
                break
            same = np.array_equal(found, (observed, catalog))
            fit, (observed, catalog) = better, found
            if same:
                break
        if not self._take(fit, xy_px[observed], guides[catalog]):
            return None
        return observed, catalog

    def _inner(self, xy_px: Floats, seeds: tuple[Index, Index]) -> tuple[Index, Index]:
        """Return the seeds without the outer ones: a lens that bends gives those wrong stars."""
        observed, catalog = seeds
        x, y = (xy_px[observed] - (self._model.first.cx_px, self._model.first.cy_px)).T
        kept = np.argsort(np.hypot(x, y), kind="stable")
        kept = kept[: max(MIN_STARS, int(np.ceil(_INNER * len(observed))))]
        return observed[kept], catalog[kept]

    def _take(self, fit: _Fit | None, xy_px: Floats, stars: Floats) -> bool:
        """Believe in a fit, if it agrees with what is known."""
        if fit is None:
            self._n_left_out += 1
            return False
        if not self._agrees(xy_px, stars):
            self._n_left_out += 1
            self._n_wrong_in_a_row += 1
            return False
        self._n_wrong_in_a_row = 0
        self._information, self._values, self._mean = fit.information, fit.values, fit.values
        limit = _HUBER * self._sigma_px
        self._squares += float(np.sum(np.minimum(np.abs(fit.left), limit) ** 2))
        self._freedom += max(len(fit.left) - 3, 1)
        self._n_frames += 1
        return True

    def _fit(self, xy_px: Floats, stars: Floats) -> _Fit | None:
        """Fit the camera to a frame and to what is known: Gauss and Newton, residuals bounded.

        None for too few stars, stars on one line, or centroids without a ray.
        """
        if len(xy_px) < MIN_STARS:
            return None
        spread = np.linalg.inv(self._information) + np.diag(self._model.walk**2)
        known, values = np.linalg.inv(spread), self._values
        for _ in range(_STEPS):
            try:
                rotation = wahba(self._model.camera(values).vectors(xy_px), stars)
            except ValueError:
                return None
            residual, of_pose, of_camera = self._linearised(values, xy_px, stars, rotation)
            weight = self._weights(residual)
            information, gradient, gain = _without_pose(of_pose, of_camera, residual, weight)
            information = known + information
            step = np.linalg.solve(information, gradient - known @ (values - self._mean))
            values = values + step
            if step @ information @ step < _SMALL_STEP**2:
                break
        left = residual - of_camera @ step
        left -= of_pose @ np.linalg.lstsq(of_pose, left, rcond=None)[0]
        return _Fit(values, information, rotation, gain, left)

    def _weights(self, residual: Floats) -> Floats:
        """Return the weights of residuals (n,): those that are too large count less."""
        sigma = self._sigma_px
        size = np.maximum(np.abs(residual), 1e-12)
        return np.asarray(np.minimum(1.0, _HUBER * sigma / size) / sigma**2)

    def _found(self, fit: _Fit, xy_px: Floats, guides: Floats) -> tuple[Index, Index]:
        """Return centroids and guide stars that are each other's nearest, near enough."""
        camera = self._model.camera(fit.values)
        ahead = np.flatnonzero(guides @ fit.rotation[:, 2] > np.cos(camera.radius_rad))
        inside = ahead[camera.contains(camera.pixels(guides[ahead] @ fit.rotation))]
        if len(inside) == 0:
            return inside, inside
        at, of_pose, of_camera = self._model.moves(fit.values, guides[inside] @ fit.rotation)
        with_pose = of_camera - of_pose @ fit.gain
        spread = np.linalg.inv(fit.information)
        variance = np.einsum("ij,jk,ik->i", with_pose, spread, with_pose).reshape(-1, 2)
        gate = _REACH * np.sqrt(self._sigma_px**2 + variance.max(axis=1))
        area = camera.width_px * camera.height_px
        gate[gate > _MOST_APART * np.sqrt(area / len(xy_px))] = 0.0
        tree = scipy.spatial.cKDTree
        apart, nearest = tree(xy_px).query(at)
        back = tree(at).query(xy_px)[1]
        good = (apart < gate) & (back[nearest] == np.arange(len(inside)))
        return nearest[good], inside[good]

    @property
    def _sigma_px(self) -> float:
        return max(float(np.sqrt(self._squares / self._freedom)), _SIGMA_FLOOR_PX)

    def _linearised(
        self, values: Floats, xy_px: Floats, stars: Floats, rotation: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the residuals (2 n,), px, and what moves the predictions: pose and camera."""
        at, of_pose, of_camera = self._model.moves(values, stars @ rotation)
        return (xy_px - at).ravel(), of_pose, of_camera

    def _agrees(self, xy_px: Floats, stars: Floats) -> bool:
        """Return whether a frame fits the camera believed as well as its uncertainty allows."""
        rotation = wahba(self._model.camera(self._values).vectors(xy_px), stars)
        residual, of_pose, of_camera = self._linearised(self._values, xy_px, stars, rotation)
        left, with_pose = (
            one - of_pose @ np.linalg.lstsq(of_pose, one, rcond=None)[0]
            for one in (residual, of_camera)
        )
        spread = np.linalg.inv(self._information)
        expected = self._sigma_px**2 + np.einsum("ij,jk,ik->i", with_pose, spread, with_pose)
        return float(np.median(np.abs(left) / np.sqrt(expected))) < _GATE


def _without_pose(
    of_pose: Floats, of_camera: Floats, residual: Floats, weight: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the information about the camera and the gradient, the pose eliminated (Schur).

    And the gain (3, ...), by which the pose gives way to a change of the camera.
    """
    pose_weighted = of_pose * weight[:, None]
    own, shared = pose_weighted.T @ of_pose, pose_weighted.T @ of_camera
    gain = np.linalg.solve(own, shared)
    information = (of_camera * weight[:, None]).T @ of_camera - shared.T @ gain
    gradient = of_camera.T @ (weight * residual) - gain.T @ (pose_weighted.T @ residual)
    return 0.5 * (information + information.T), gradient, gain
