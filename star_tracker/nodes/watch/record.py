"""One frame as a record for machines and as a line for people. No ROS here."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from star_tracker.geometry.spherical import Floats
from star_tracker.nodes.watch.model import Frame, Report, Watched, state_name

#: What `solution` tells in words; all else of it are numbers.
_WORDS = ("status", "reason", "hint", "method", "mode", "parity")
_NUMBERS = (
    "matched", "displaced", "total", "ignored", "wrong_probability", "log10_false_alarms",
    "rms_px", "hypotheses", "solve_ms",
)


def json_line(watched: Watched, frame: Frame | None) -> str:
    """Return one line of JSON: the frame, where there is one, and the node's last reports.

    Numbers that are not known, or not finite, are null.
    """
    record = {
        "node": watched.full_name, **_frame_record(frame),
        "health": _report_record(watched.health),
        "focal_length": _report_record(watched.focal_length),
    }
    return json.dumps(record, allow_nan=False)


def plain_line(_: Watched, frame: Frame) -> str:
    """Return how a frame ended in one line of text, its stamp in seconds first."""
    v = frame.values
    line = f"{frame.stamp_ns / 1e9:.3f} {frame.status} {v.get('matched')}/{v.get('total')}"
    if frame.pose is None:
        text = f"{line}: {v.get('reason')}"
        return f"{text}; {v['hint']}" if v.get("hint") else text
    ra, dec, roll = frame.pose.boresight_deg
    sigma = ", ".join(f"{value:.2f}" for value in frame.pose.sigma_arcsec)
    return (
        f"{line} RA {ra:.4f} Dec {dec:+.4f} roll {roll:.4f} deg, 1 sigma x, y, z {sigma} arcsec, "
        f"{v.get('solve_ms')} ms"
    )


def _frame_record(frame: Frame | None) -> dict[str, Any]:
    if frame is None:
        return {"stamp_ns": None, "status": None}
    pose = frame.pose
    names = ("ra_deg", "dec_deg", "roll_deg")
    boresight = [None] * 3 if pose is None else _list(pose.boresight_deg)
    return {
        "stamp_ns": frame.stamp_ns,
        **{key: frame.values.get(key) for key in _WORDS},
        **{key: _number(frame.values.get(key)) for key in _NUMBERS},
        **dict(zip(names, boresight, strict=True)),
        "quaternion_xyzw": None if pose is None else _list(pose.quaternion_xyzw),
        "sigma_camera_xyz_arcsec": None if pose is None else _list(pose.sigma_arcsec),
        "stars": None if frame.stars is None else [_star_record(star) for star in frame.stars],
    }


def _star_record(star: np.void) -> dict[str, Any]:
    # The text of a float32 has no more digits than it knows.
    record = {name: _number(str(star[name])) for name in star.dtype.names or ()}
    return {**record, "state": state_name(star)}


def _report_record(report: Report | None) -> dict[str, Any] | None:
    if report is None:
        return None
    return {
        "level": report.level, "message": report.message, **_numbers_where_they_are(report.values)
    }


def _numbers_where_they_are(values: Mapping[str, str]) -> dict[str, Any]:
    words = {"mode", "last_reason", "catalog", "configuration", "version"}
    return {k: v if k in words else _number(v) for k, v in values.items()}


def _number(text: str | None) -> float | int | None:
    """Return the number that a text holds; None where it holds none, or none that is finite."""
    try:
        value = float(text or "nan")
    except ValueError:
        return None
    return int(value) if value.is_integer() and "." not in (text or "") else _finite(value)


def _list(values: Floats) -> list[float | None]:
    return [_finite(value) for value in values.tolist()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
