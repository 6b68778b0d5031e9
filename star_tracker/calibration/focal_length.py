"""The focal length from many solved frames: a slow, bounded, robust estimate.

Each frame's own value and standard error come from the joint fit of `calibration.py`. A scalar
Kalman filter of the relative deviation from the nominal focal length combines them: temperature
moves a lens slowly, so that its random walk is small; a frame that disagrees is left out, unless
so many in a row do that the lens itself must have moved.
"""

from dataclasses import dataclass, replace

import numpy as np

from star_tracker.calibration.lens import calibrate
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera

MODES = ("off", "report", "apply")
#: The estimate stays within this of the nominal value, and is at first as uncertain as that.
BOUND = 0.05
#: Random walk of the deviation from frame to frame, and smallest standard error of one frame:
#: residuals of noise-free simulated frames promise more than a real lens holds.
_WALK, _FRAME_FLOOR = 1e-5, 2e-5
#: A frame farther off than so many standard deviations is left out; so many in a row start anew.
_GATE_SIGMA, _ALL_WRONG = 4.0, 20
#: Stars and centroids that a frame needs.
_MIN_STARS = 5
#: `apply` follows a change of more than this, once it is known to better than that.
_STEP, _KNOWN = 1e-4, 3e-3


@dataclass(frozen=True)
class FocalLength:
    """What is known of a focal length.

    Attributes:
        nominal_px: as configured.
        value_px: estimated.
        standard_error_px: of the estimate.
        n_frames: frames that went in.
        n_left_out: frames that did not: too few stars, no fit, or too far off.
    """

    nominal_px: float
    value_px: float
    standard_error_px: float
    n_frames: int
    n_left_out: int

    @property
    def drift(self) -> float:
        """Relative deviation from the nominal value."""
        return self.value_px / self.nominal_px - 1


class FocalLengthEstimator:
    """Follows the focal length of one camera.

    Args:
        camera: with the nominal focal length; of any parity.
    """

    def __init__(self, camera: Camera) -> None:
        self.nominal = camera
        self.camera = camera  #: with the focal length that `apply` has reached
        self._drift, self._variance = 0.0, (BOUND / 2) ** 2
        self._n_frames = self._n_left_out = self._n_wrong_in_a_row = 0

    def add(self, camera: Camera, xy_px: Floats, star_vectors: Floats) -> bool:
        """Take in a solved frame; return whether it was used.

        Args:
            camera: with which it was solved, of definite parity.
            xy_px: (n, 2) its identified centroids, displaced ones not among them.
            star_vectors: (n, 3) their unit vectors, ICRS.
        """
        found = self._measure(camera, xy_px, star_vectors)
        if found is None or not self._agrees(*found):
            self._n_left_out += 1
            return False
        drift, variance = found
        predicted = self._variance + _WALK**2
        gain = predicted / (predicted + variance)
        self._drift = float(np.clip(self._drift + gain * (drift - self._drift), -BOUND, BOUND))
        self._variance = (1 - gain) * predicted
        self._n_frames += 1
        self._n_wrong_in_a_row = 0
        return True

    def apply(self) -> Camera:
        """Return the camera to solve with: it follows the estimate in steps."""
        change = abs(self.nominal.fx_px * (1 + self._drift) / self.camera.fx_px - 1)
        if self._variance < _KNOWN**2 and change > _STEP:
            self.camera = replace(
                self.nominal, fx_px=self.nominal.fx_px * (1 + self._drift),
                fy_px=self.nominal.fy_px * (1 + self._drift),
            )
        return self.camera

    @property
    def estimate(self) -> FocalLength:
        """What is known so far."""
        nominal = self.nominal.focal_length_px
        return FocalLength(
            nominal, nominal * (1 + self._drift), nominal * float(np.sqrt(self._variance)),
            self._n_frames, self._n_left_out,
        )

    def _measure(
        self, camera: Camera, xy_px: Floats, star_vectors: Floats
    ) -> tuple[float, float] | None:
        """Return a frame's deviation from the nominal value and its variance."""
        if len(xy_px) < _MIN_STARS:
            return None
        try:
            fit = calibrate(camera, xy_px, star_vectors, terms=())
        except ValueError:  # the stars lie too close together, or the fit left the bounds
            return None
        nominal = self.nominal.focal_length_px
        error = max(float(fit.standard_errors[0]) / nominal, _FRAME_FLOOR)
        return float(fit.values[0]) / nominal - 1, error**2

    def _agrees(self, drift: float, variance: float) -> bool:
        """Return whether a frame agrees with what is known; start anew where too many do not."""
        if abs(drift) > BOUND:
            return False
        if abs(drift - self._drift) <= _GATE_SIGMA * np.sqrt(self._variance + variance):
            return True
        self._n_wrong_in_a_row += 1
        if self._n_wrong_in_a_row < _ALL_WRONG:
            return False
        self._variance = (BOUND / 2) ** 2
        return True
