"""Focal length -> diagnostic status, and the sentence of the service `calibrate`."""

from typing import TYPE_CHECKING

from star_tracker.calibration.focal_length import FocalLength

if TYPE_CHECKING:
    import diagnostic_msgs.msg


def status_from_focal_length(
    focal_length: FocalLength, name: str
) -> "diagnostic_msgs.msg.DiagnosticStatus":
    """Write an estimate: level OK once a frame has gone in, else WARN."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    f = focal_length
    values = {
        "nominal_px": f"{f.nominal_px:.3f}",
        "focal_length_px": f"{f.value_px:.3f}",
        "standard_error_px": f"{f.standard_error_px:.3f}",
        "drift_percent": f"{100 * f.drift:.4f}",
        "drift_standard_error_percent": f"{100 * f.standard_error_px / f.nominal_px:.4f}",
        "frames": f.n_frames,
        "frames_left_out": f.n_left_out,
    }
    return DiagnosticStatus(
        level=DiagnosticStatus.OK if f.n_frames else DiagnosticStatus.WARN,
        name=f"{name}: focal length", message=sentence_from_focal_length(f),
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def sentence_from_focal_length(focal_length: FocalLength) -> str:
    """Say an estimate in one line, with its standard error."""
    f = focal_length
    if not f.n_frames:
        return f"no frame has gone into the estimate yet, {f.n_left_out} were left out"
    return (
        f"focal length {f.value_px:.3f} +- {f.standard_error_px:.3f} px, "
        f"{100 * f.drift:+.4f} +- {100 * f.standard_error_px / f.nominal_px:.4f} % from the "
        f"nominal {f.nominal_px:.3f} px, {f.n_frames} frames, {f.n_left_out} left out"
    )
