"""`star_tracker calibrate`: focal length and lens from a star map, or from a camera's frames."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.table import Table

from star_tracker.calibration.error_propagation import boresight_covariance
from star_tracker.calibration.lens import TERMS, Calibration, calibrate
from star_tracker.commands import matched_map
from star_tracker.commands.calibrate_frames import calibrate_files
from star_tracker.commands.frame_options import add_camera_arguments, add_sky_arguments
from star_tracker.commands.matched_map import MatchedMap
from star_tracker.commands.options import (
    Record,
    add_focal_length_argument,
    add_json_argument,
    check_positive,
)
from star_tracker.commands.printing import cell, print_result
from star_tracker.offline.frame_file import is_star_map
from star_tracker.optics.camera import Camera

_UNITS = {"focal_length_px": "px", "cx_px": "px", "cy_px": "px", "k1": "", "k2": ""}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE",
        help="one star map, or its number from 1 to 8; or images and lists of centroids of one "
        "camera, which are identified first",
    )
    add_json_argument(parser)
    one = parser.add_argument_group("one star map")
    one.add_argument(
        "--terms", metavar="T,T",
        help=f"what to fit beside attitude and focal length: {', '.join(TERMS)}, or none "
        "(what the data support)",
    )
    add_focal_length_argument(one, "the focal length to start from")
    frames = parser.add_argument_group("frames")
    frames.add_argument(
        "--output", type=Path, metavar="FILE",
        help="where the camera goes, YAML of ROS's camera_calibration (none)",
    )
    frames.add_argument(
        "--principal-point", action="store_true",
        help="fit the principal point too, through which the boresight goes (it stays where it "
        "was told, or in the middle of the image)",
    )
    add_camera_arguments(parser.add_argument_group("camera of the frames (found out)"))
    add_sky_arguments(parser.add_argument_group("sky and work for frames"))


def execute(options: argparse.Namespace) -> None:
    """Fit and print the camera. Raises ValueError for what cannot be used."""
    check_positive(options, "focal_length_px")
    word = options.files[0]
    if len(options.files) == 1 and (word.isdecimal() or is_star_map(Path(word))):
        if options.output is not None:
            raise ValueError("--output is for frames: one star map is no camera's calibration")
        if options.principal_point:
            raise ValueError(
                "--principal-point is for frames: for one star map use --terms principal_point"
            )
        _calibrate_map(options, word)
        return
    if options.terms is not None or options.focal_length_px is not None:
        raise ValueError("--terms and --focal-length-px are for one star map, not for frames")
    calibrate_files(options)


def _calibrate_map(options: argparse.Namespace, word: str) -> None:
    terms = None
    if options.terms is not None:
        terms = tuple(t.strip() for t in options.terms.split(",") if t.strip() != "none")
    matched = matched_map.load(word)
    camera = matched.camera
    if options.focal_length_px is not None:
        camera = replace(camera, fx_px=options.focal_length_px, fy_px=options.focal_length_px)
    fitted = calibrate(camera, matched.xy_px, matched.star_vectors, terms=terms)
    parameters = _parameters(camera, fitted)
    record: Record = {
        "map": matched.name, "source": matched.source, "stars": len(matched.labels),
        "terms": list(fitted.terms), "terms_given": terms is not None,
        "sigma_px": fitted.sigma_px, "degrees_of_freedom": fitted.degrees_of_freedom,
        "rms_px": float(np.sqrt(np.mean(np.sum(fitted.residuals_px**2, axis=1)))),
        "parameters": parameters,
    }
    print_result(record, [_table(matched, record, fitted, parameters)], options.json)


def _parameters(given: Camera, fitted: Calibration) -> list[Record]:
    """Return a row for each fitted value, and those that follow from them."""
    start = {
        "focal_length_px": given.focal_length_px, "cx_px": given.cx_px, "cy_px": given.cy_px,
        "k1": 0.0, "k2": 0.0,
    }
    rows = [
        _row(name, start[name], float(value), float(error), _UNITS[name])
        for name, value, error in zip(
            fitted.names, fitted.values, fitted.standard_errors, strict=True
        )
    ]
    half_width = given.width_px / 2
    by_focal_length = 2 * half_width / (half_width**2 + fitted.camera.fx_px**2)
    fov_error = float(np.degrees(by_focal_length * fitted.standard_errors[0]))
    rows.append(_row("fov_deg", given.fov_deg, fitted.camera.fov_deg, fov_error, "deg"))
    attitude = fitted.attitude
    boresight = boresight_covariance(attitude.rotation, attitude.covariance_rad2)
    east, north = np.sqrt(np.diag(boresight))
    for name, angle, error in (
        ("ra_deg", attitude.ra_rad, east / np.cos(attitude.dec_rad)),
        ("dec_deg", attitude.dec_rad, north),
        ("roll_deg", attitude.roll_rad, np.sqrt(attitude.covariance_rad2[2, 2])),
    ):
        degrees = float(np.degrees(angle)), float(np.degrees(error))
        rows.append(_row(name, None, *degrees, "deg"))
    return rows


def _row(
    name: str, given: float | None, value: float, error: float, unit: str
) -> Record:
    return {
        "parameter": name, "given": given, "fitted": value, "standard_error": error, "unit": unit
    }


def _table(
    matched: MatchedMap, record: Record, fitted: Calibration, parameters: list[Record]
) -> Table:
    left_out = [term for term in TERMS if term not in fitted.terms]
    chosen = "asked for" if record["terms_given"] else "supported by the data"
    caption = (
        f"{record['source']}; beside attitude and focal length, {chosen}: "
        f"{', '.join(fitted.terms) or 'none'}; not fitted: {', '.join(left_out) or 'none'}; "
        f"noise {fitted.sigma_px:.4f} px along each axis, {fitted.degrees_of_freedom} degrees "
        "of freedom"
    )
    table = Table(title=f"{matched.name}: camera from {record['stars']} stars", caption=caption)
    table.add_column("parameter")
    for heading in ("given", "fitted", "+/-"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for row in parameters:
        name = str(row["parameter"]).removesuffix("_px").removesuffix("_deg")
        table.add_row(
            name.replace("_", " "), cell(row["given"], ".6f"),
            cell(row["fitted"], ".6f"), cell(row["standard_error"], ".2g"), str(row["unit"]),
        )
    return table
