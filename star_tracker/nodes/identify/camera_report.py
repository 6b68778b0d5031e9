"""What /diagnostics says of the camera: as told or found, and what frames have taught about it."""

from collections.abc import Callable

from star_tracker.calibration.camera_estimator import CameraEstimate
from star_tracker.calibration.learning import LearningTracker
from star_tracker.optics.camera import Camera

#: Names of the coefficients that come first in every model.
_RADIAL = ("k1", "k2")


def camera_report(
    tracker: LearningTracker | None, told: Callable[[Camera], Camera]
) -> tuple[str, str, dict[str, object]]:
    """Return level, sentence and values of a status.

    There is no tracker before camera_info has told a camera. `told` returns a camera of the
    tracker, counted as the centroids are.
    """
    if tracker is None:
        return "warn", "no frame with a camera_info has come yet", {}
    if tracker.camera is None:
        return "warn", "no camera was found yet", {}
    camera, estimate = told(tracker.camera), tracker.estimate
    values: dict[str, object] = {
        "fov_deg": f"{camera.fov_deg:.6g}", "parity": camera.parity,
        "focal_length_px": camera.focal_length_px, "cx_px": camera.cx_px, "cy_px": camera.cy_px,
    }
    lens = camera.distortion
    if lens is not None:
        values["distortion_model"] = lens.model
        for name, value in zip(_RADIAL, lens.coefficients, strict=False):
            values[name] = f"{value:.5g}"
    if tracker.noise.sigma_px is not None and tracker.settings.centroid_sigma_px == 0:
        values["learnt_sigma_px"] = tracker.noise.sigma_px
    if tracker.noise.false_share is not None:
        values["learnt_false_star_ratio"] = tracker.noise.false_share
    if estimate is None:
        taught = "taken at its word" if camera.tolerance_percent == 0 else "no frame has gone in"
        return "ok", f"{_text(camera)}, {taught}", values
    relative = float(estimate.standard_errors[0])
    values |= {
        "focal_length_error_px": relative * camera.focal_length_px,
        "centroid_sigma_px": estimate.sigma_px,
        "frames": estimate.n_frames, "frames_left_out": estimate.n_left_out,
    }
    return "ok", f"{_text(camera)}, {_taught(camera, estimate, relative)}", values


def _text(camera: Camera) -> str:
    return f"field of view {camera.fov_deg:.4g} deg over {camera.width_px} px"


def _taught(camera: Camera, estimate: CameraEstimate, relative: float) -> str:
    return (
        f"focal length {camera.focal_length_px:.2f} +- {relative * camera.focal_length_px:.2f} px "
        f"from {estimate.n_frames} frames"
    )
