"""A camera from many solved frames: an information filter over focal length and lens.

Each frame has an attitude of its own; eliminated, it leaves what the frame's stars tell about the
camera: an information matrix and a gradient about the camera as it is believed now. They add up
(an extended Kalman filter in information form; Maybeck 1979, 5.7). What a narrow field or few
stars cannot tell keeps its prior: no lens bends without stars that show it.
"""

from dataclasses import dataclass, replace

import numpy as np

from star_tracker.attitude.wahba import wahba
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

#: What is estimated: log of the focal length as a multiple of the first one, and the lens, radial
#: and tangential (Brown 1966). The principal point stays where it was said to be, as the camera's
#: frame is defined by it: moved, it would turn the attitude of all later frames. A lens off the
#: axis shows in the tangential terms instead.
PARAMETERS = ("log_focal_length", "k1", "k2", "p1", "p2")
#: Standard deviations of the lens beforehand: of lenses without a calibration.
_LENS = (0.15, 0.1, 0.01, 0.01)
#: Random walk a frame, of a lens that warms up or is touched, in the same units.
_WALK = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5])
#: Noise of a centroid beforehand, px, worth so many residuals; and never less than this.
_SIGMA_PX, _SIGMA_FREEDOM, _SIGMA_FLOOR_PX = 0.7, 4.0, 0.02
#: A frame disagrees whose stars lie farther from where the camera believed puts them than so many
#: times the noise; so many in a row say that the optics are others.
_GATE, _ALL_WRONG = 6.0, 5
#: Stars that a frame needs to tell anything beside its attitude.
MIN_STARS = 5
#: Huber's limit of a residual, in standard deviations.
_HUBER = 2.0
_STEP = 1e-5


@dataclass(frozen=True)
class CameraEstimate:
    """What is known of a camera.

    Attributes:
        camera: as estimated, its `tolerance_percent` three standard errors of the focal length.
        standard_errors: of `PARAMETERS`.
        sigma_px: noise of a centroid along each axis, as the residuals show it.
        n_frames: frames that went in.
        n_left_out: frames that did not: too few stars, or too far off.
    """

    camera: Camera
    standard_errors: Floats
    sigma_px: float
    n_frames: int
    n_left_out: int


class CameraEstimator:
    """Follows one camera over frames whose stars are identified.

    Args:
        camera: as first found, of definite parity. Its distortion, where it is of another model,
            is kept and only the focal length is followed.
        tolerance: standard deviation of its log focal length beforehand.
    """

    def __init__(self, camera: Camera, tolerance: float) -> None:
        self._first = camera
        self._values = np.zeros(len(PARAMETERS))
        given = camera.distortion
        self._keeps_lens = given is not None and not _is_brown(given)
        if given is not None and not self._keeps_lens:
            self._values[1:] = given.coefficients[:4]
        lens = [1e-9] * len(_LENS) if self._keeps_lens else _LENS
        prior = np.array([tolerance, *lens])
        self._information = np.diag(prior**-2.0)
        self._squares, self._freedom = _SIGMA_FREEDOM * _SIGMA_PX**2, _SIGMA_FREEDOM
        self._n_frames = self._n_left_out = self._n_wrong_in_a_row = 0

    @property
    def optics_changed(self) -> bool:
        """Whether so many frames in a row disagree that the camera must be another one."""
        return self._n_wrong_in_a_row >= _ALL_WRONG

    @property
    def estimate(self) -> CameraEstimate:
        """What is known so far."""
        errors = np.sqrt(np.diag(np.linalg.inv(self._information)))
        camera = self._camera(self._values)
        return CameraEstimate(
            replace(camera, tolerance_percent=float(min(100 * 3 * errors[0], 5.0))), errors,
            self._sigma_px, self._n_frames, self._n_left_out,
        )

    def add(self, xy_px: Floats, star_vectors: Floats) -> bool:
        """Take in a frame: identified centroids (n, 2) and their stars (n, 3), ICRS.

        Returns whether it agreed with what is known and was used.
        """
        if len(xy_px) < MIN_STARS:
            self._n_left_out += 1
            return False
        camera = self._camera(self._values)
        try:
            rotation = wahba(camera.vectors(xy_px), star_vectors)
        except ValueError:  # no ray for a centroid, or stars on one line
            self._n_left_out += 1
            return False
        residual, of_pose, of_camera = self._linearised(xy_px, star_vectors, rotation)
        sigma = self._sigma_px
        weight = np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(residual), 1e-12)) / sigma**2
        information, gradient = _without_pose(of_pose, of_camera, residual, weight)
        if not self._agrees(residual, of_pose, of_camera):
            self._n_left_out += 1
            self._n_wrong_in_a_row += 1
            return False
        self._n_wrong_in_a_row = 0
        spread = np.linalg.inv(self._information) + np.diag(_WALK**2)
        self._information = np.linalg.inv(spread) + information
        step = np.linalg.solve(self._information, gradient)
        self._values = self._values + step
        left = residual - of_camera @ step
        left -= of_pose @ np.linalg.lstsq(of_pose, left, rcond=None)[0]
        self._squares += float(np.sum(np.minimum(np.abs(left), _HUBER * sigma) ** 2))
        self._freedom += max(len(residual) - 3, 1)
        self._n_frames += 1
        return True

    @property
    def _sigma_px(self) -> float:
        return max(float(np.sqrt(self._squares / self._freedom)), _SIGMA_FLOOR_PX)

    def _camera(self, values: Floats) -> Camera:
        """Return the camera of some values of the parameters."""
        first, scale = self._first, float(np.exp(values[0]))
        lens = first.distortion
        if not self._keeps_lens:
            terms = tuple(float(value) for value in values[1:])
            lens = Distortion("plumb_bob", (*terms, 0.0)) if any(terms) else None
        return replace(
            first, fx_px=first.fx_px * scale, fy_px=first.fy_px * scale, distortion=lens
        )

    def _linearised(
        self, xy_px: Floats, stars: Floats, rotation: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the residuals (2 n,), px, and what moves the predictions: pose and camera."""
        in_camera = stars @ rotation
        camera = self._camera(self._values)
        at = camera.pixels(in_camera)
        of_pose = []
        for axis in np.eye(3):
            turned = camera.pixels(in_camera + _STEP * np.cross(axis, in_camera))
            of_pose.append(((turned - at) / _STEP).ravel())
        of_camera = []
        for i in range(len(PARAMETERS)):
            values = self._values.copy()
            values[i] += _STEP
            moved = self._camera(values).pixels(in_camera)
            of_camera.append(((moved - at) / _STEP).ravel())
        return (xy_px - at).ravel(), np.column_stack(of_pose), np.column_stack(of_camera)

    def _agrees(self, residual: Floats, of_pose: Floats, of_camera: Floats) -> bool:
        """Return whether a frame fits the camera as well as its uncertainty allows."""
        spread = np.linalg.inv(self._information)
        expected = self._sigma_px**2 + np.einsum("ij,jk,ik->i", of_camera, spread, of_camera)
        left = residual - of_pose @ np.linalg.lstsq(of_pose, residual, rcond=None)[0]
        return float(np.median(np.abs(left) / np.sqrt(expected))) < _GATE


def _is_brown(lens: Distortion) -> bool:
    """Return whether a lens is described by the terms that are estimated."""
    return lens.model == "plumb_bob" and lens.coefficients[4] == 0


def _without_pose(
    of_pose: Floats, of_camera: Floats, residual: Floats, weight: Floats
) -> tuple[Floats, Floats]:
    """Return the information about the camera and the gradient, the pose eliminated (Schur)."""
    pose_weighted = of_pose * weight[:, None]
    own, shared = pose_weighted.T @ of_pose, pose_weighted.T @ of_camera
    gain = np.linalg.solve(own, shared)
    information = (of_camera * weight[:, None]).T @ of_camera - shared.T @ gain
    gradient = of_camera.T @ (weight * residual) - gain.T @ (pose_weighted.T @ residual)
    return 0.5 * (information + information.T), gradient
