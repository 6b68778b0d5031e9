"""One frame as a line of JSON. No ROS here."""

from collections.abc import Mapping

import numpy as np

from star_tracker.commands.options import Record, json_text
from star_tracker.identification.labels import StarState
from star_tracker.nodes.watch.state import Frame, Watched
from star_tracker.nodes.watch.view import pose_degrees

#: Values that are words even where they look like numbers.
_WORDS = {"configuration", "version"}


def json_line(watched: Watched, frame: Frame | None) -> str:
    """Return one line: the frame, if there is one, and the node's last reports."""
    record: Record = {"node": watched.full_name}
    if frame is not None:
        record |= {"stamp_ns": frame.stamp_ns, **_plain(frame.values), **_pose(frame)}
        stars = [] if frame.stars is None else frame.stars
        record["stars"] = [_star(star) for star in stars]
    for kind, report in watched.reports.items():
        record[kind.replace(" ", "_")] = {
            "level": report.level, "message": report.message, **_plain(report.values)
        }
    return json_text(record)


def _pose(frame: Frame) -> Record:
    names = ("ra_deg", "dec_deg", "roll_deg", "quaternion_xyzw", "sigma_camera_xyz_arcsec")
    attitude = frame.attitude
    if attitude is None:
        return dict.fromkeys(names)
    boresight_deg, sigma_arcsec = pose_degrees(attitude)
    values = (*boresight_deg, attitude.quaternion_xyzw.tolist(), sigma_arcsec)
    return dict(zip(names, values, strict=True))


def _star(star: np.void) -> Record:
    # The text of a float32 has no more digits than it knows.
    values = _plain({name: str(star[name]) for name in star.dtype.names or ()})
    return {**values, "state": StarState(star["state"]).name.lower()}


def _plain(values: Mapping[str, str]) -> Record:
    return {key: text if key in _WORDS else _value(text) for key, text in values.items()}


def _value(text: str) -> object:
    """Return the number that a text is, None for one that is not known, else the text."""
    if text in ("", "n/a"):
        return None
    try:
        return int(text) if text.isdecimal() else float(text)
    except ValueError:
        return text
