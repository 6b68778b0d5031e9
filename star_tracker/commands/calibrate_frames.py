"""`star_tracker calibrate FRAME...`: one camera from all frames that it took."""

import argparse
import sys
from collections import Counter

from rich.table import Table

from star_tracker.calibration.camera_file import write_camera
from star_tracker.calibration.camera_model import CENTER, PARAMETERS
from star_tracker.calibration.many_frames import CalibratedFrames, Sighting, calibrate_frames
from star_tracker.commands.frame_options import asked_of, paths_of
from star_tracker.commands.options import Record, check_writable
from star_tracker.commands.printing import cell, print_result
from star_tracker.offline.frame_file import FileFrame
from star_tracker.offline.solving import frames_of
from star_tracker.offline.spreading import Spread
from star_tracker.optics.camera import Camera


def calibrate_files(options: argparse.Namespace) -> None:
    """Fit one camera to files and print it; write it where that is asked for.

    A file that cannot be read is named and left out, and the exit code is then 1. Raises
    ValueError where nothing is left, and for images of several sizes.
    """
    asked = asked_of(options)
    check_writable(options.output)
    # Each once: a frame that is named twice tells no more of the camera.
    paths = list(dict.fromkeys(path for word in options.files for path in paths_of(word)))
    read = list(frames_of(paths, asked, Spread(min(options.jobs, len(paths) or 1))))
    frames = [frame for frame in read if isinstance(frame, FileFrame)]
    errors = [str(error) for error in read if isinstance(error, ValueError)]
    for error in errors:
        print(f"star_tracker calibrate: {error}", file=sys.stderr)
    if not frames:
        raise ValueError("no frame can be used: name images or lists of centroids of one camera")
    size = _size_of(frames)
    found = calibrate_frames(
        asked.tracker(size, asked.told(size)),
        [Sighting(frame.xy_px, frame.intensity) for frame in frames],
        principal_point=options.principal_point,
    )
    record = _record(found, frames)
    if options.output is not None:
        write_camera(found.estimate.camera, options.output)
        record["written_to"] = str(options.output)
    print_result(record, [_table(found, record)], options.json)
    if errors:
        sys.exit(1)


def _size_of(frames: list[FileFrame]) -> tuple[int, int]:
    """Return the size of all frames. Raises ValueError where they differ."""
    sizes = Counter(frame.size_px for frame in frames)
    if len(sizes) > 1:
        text = ", ".join(f"{n} of {w} x {h} px" for (w, h), n in sizes.most_common())
        raise ValueError(f"these are images of several cameras ({text}): name those of one")
    return frames[0].size_px


def _record(found: CalibratedFrames, frames: list[FileFrame]) -> Record:
    camera, estimate = found.estimate.camera, found.estimate
    return {
        "frames": len(frames), "frames_used": int(found.used.sum()), "stars": found.n_stars,
        "left_out": [
            str(frame.path) for frame, used in zip(frames, found.used, strict=True) if not used
        ],
        "width_px": camera.width_px, "height_px": camera.height_px, "parity": camera.parity,
        "rms_before_px": found.rms_before_px, "rms_after_px": found.rms_after_px,
        "sigma_px": estimate.sigma_px, "parameters": _rows(found),
    }


def _rows(found: CalibratedFrames) -> list[Record]:
    """Return a row for each value: before, fitted and its standard error."""
    camera, before = found.estimate.camera, found.before
    errors = dict(
        zip(found.estimate.names, found.estimate.standard_errors.tolist(), strict=True)
    )
    of_focal_length = errors["log_focal_length"]
    rows: list[Record] = [
        {
            "parameter": "focal_length_px", "before": before.focal_length_px,
            "fitted": camera.focal_length_px,
            "standard_error": of_focal_length * camera.focal_length_px,
        },
        {
            "parameter": "fov_deg", "before": before.fov_deg, "fitted": camera.fov_deg,
            "standard_error": abs(camera.scaled(1 + of_focal_length).fov_deg - camera.fov_deg),
        },
    ]
    was, now = _lens(before), _lens(camera)
    for i, name in enumerate(PARAMETERS[1:]):
        rows.append({
            "parameter": name, "before": was[i], "fitted": now[i], "standard_error": errors[name],
        })
    rows.extend(
        {
            "parameter": name, "before": getattr(before, name), "fitted": getattr(camera, name),
            "standard_error": errors[name],
        }
        for name in CENTER if name in errors
    )
    return rows


def _lens(camera: Camera) -> tuple[float, ...]:
    """Return k1, k2, p1 and p2; zeros for another model, which is kept."""
    lens = camera.distortion
    if lens is None or lens.model != "plumb_bob":
        return (0.0,) * 4
    return lens.coefficients[:4]


def _about_center(found: CalibratedFrames) -> str:
    """Return what is to be said of the principal point, empty where it was fitted."""
    stays = "; the principal point stays where it was told"
    if found.center_error_px is None:
        return stays
    if CENTER[0] in found.estimate.names:
        return ""
    x, y = found.center_error_px
    return f"{stays}: the stars, which tell it to {x:.1f} and {y:.1f} px, show no other"


def _table(found: CalibratedFrames, record: Record) -> Table:
    caption = (
        f"residuals {found.rms_before_px:.3f} px before, {found.rms_after_px:.3f} px after (rms "
        f"of the same stars); noise {found.estimate.sigma_px:.3f} px along each axis"
        f"{_about_center(found)}"
    )
    table = Table(
        title=f"camera from {record['stars']} stars in {record['frames_used']} of "
        f"{record['frames']} frames", caption=caption,
    )
    table.add_column("parameter")
    for heading in ("before", "fitted", "+/-"):
        table.add_column(heading, justify="right")
    for row in _rows(found):
        table.add_row(
            str(row["parameter"]), cell(row["before"], ".5g"), cell(row["fitted"], ".7g"),
            cell(row["standard_error"], ".2g"),
        )
    return table
