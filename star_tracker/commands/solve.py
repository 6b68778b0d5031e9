"""`star_tracker solve`: images, lists of centroids and star maps in, attitudes out. No ROS."""

import argparse
import csv
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from star_tracker.calibration.camera_file import read_camera
from star_tracker.commands.options import Record, add_json_argument, json_text
from star_tracker.detection.centroids import DetectSettings
from star_tracker.geometry.spherical import ra_dec
from star_tracker.maps.star_map import PAPER_MAPS, STAR_MAPS_FOLDER
from star_tracker.offline.solving import Asked, Result, frames_of, solve_frames
from star_tracker.offline.wcs import header_text
from star_tracker.optics.camera import PARITIES
from star_tracker.resources import resource_path, write_whole
from star_tracker.solution import SolveSettings

_COLUMNS = (
    "file", "status", "ra_deg", "dec_deg", "roll_deg", "fov_deg", "parity", "n_detected",
    "n_identified", "wrong_probability", "rms_px", "detect_ms", "solve_ms", "reason",
)
_STAR_COLUMNS = (
    "x_px", "y_px", "hip", "v_mag", "ra_deg", "dec_deg", "residual_px", "state",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the files, what is known of the camera, and what is written."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE",
        help="image, list of centroids or star map; a number from 1 to 8 is a shipped map",
    )
    add_json_argument(parser)
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="where a table of all results goes (none)"
    )
    parser.add_argument(
        "--stars", type=Path, metavar="DIR", help="where the stars of each image go, CSV (none)"
    )
    parser.add_argument(
        "--wcs", type=Path, metavar="DIR",
        help="where a FITS header of each solved image goes (none)",
    )
    _add_camera_arguments(parser.add_argument_group("camera (found out where it is not told)"))
    more = parser.add_argument_group("sky and work")
    for option, kind, default, metavar, text in (
        ("--epoch", float, 2000.0, "YEAR", "epoch of the stars' places, Julian year"),
        ("--limiting-magnitude", float, 0.0, "MAG", "faintest stars, mag; 0 = as suits"),
        ("--catalog", str, "hipparcos", "NAME", "catalogue of the stars"),
        ("--max-stars", int, DetectSettings().max_stars, "N", "brightest stars that are used"),
        ("--deadline-ms", float, 5000.0, "MS", "longest search of a file, ms"),
        ("--jobs", int, os.cpu_count() or 1, "N", "processes that detect stars"),
    ):
        more.add_argument(
            option, type=kind, default=default, metavar=metavar, help=f"{text} (%(default)s)"
        )
    more.add_argument(
        "--independent", action="store_true", help="learn nothing from one file for another"
    )


def _add_camera_arguments(camera: argparse._ArgumentGroup) -> None:
    """Declare what may be known of the camera."""
    for option, kind, default, metavar, text in (
        ("--fov-deg", float, 0.0, "DEG", "field of view across the width, deg; 0 = unknown"),
        ("--fov-tolerance-percent", float, 5.0, "PERCENT", "how far that may be off, percent"),
        ("--fov-min-deg", float, 4.0, "DEG", "least field where it is unknown, deg"),
        ("--fov-max-deg", float, 70.0, "DEG", "greatest field where it is unknown, deg"),
    ):
        camera.add_argument(
            option, type=kind, default=default, metavar=metavar, help=f"{text} (%(default)s)"
        )
    camera.add_argument(
        "--camera", type=Path, metavar="FILE", help="camera calibration of ROS, YAML (none)"
    )
    camera.add_argument(
        "--parity", choices=PARITIES, default="auto", help="of the image (%(default)s)"
    )
    camera.add_argument(
        "--width-px", type=int, metavar="PX", help="width of the image of a list, px (none)"
    )
    camera.add_argument(
        "--height-px", type=int, metavar="PX", help="its height, px (none)"
    )
    camera.add_argument(
        "--bayer", default=None, metavar="RGGB", help="colour pattern of raw images (none)"
    )


def execute(options: argparse.Namespace) -> None:
    """Solve the files. Ends with exit code 1 where one of them could not be used at all."""
    asked = _asked(options)
    for folder in (options.stars, options.wcs):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    files = [_path(word) for word in options.files]
    frames = frames_of(files, asked, max(1, options.jobs))
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("solving", total=len(files))
        results = solve_frames(files, frames, asked, done=lambda: progress.advance(bar))
    for result in results:
        _print(result, as_json=options.json)
    _write(results, options)
    if any(result.error for result in results):
        sys.exit(1)


def _path(word: str) -> Path:
    """Return the file that a word names: a shipped star map, where it is its number."""
    if word in {str(number) for number in PAPER_MAPS} and not Path(word).exists():
        return resource_path(f"{STAR_MAPS_FOLDER}/map{word}.csv")
    return Path(word)


def _asked(options: argparse.Namespace) -> Asked:
    """Return what the options say. Raises ValueError for what does not fit together."""
    if (options.width_px is None) != (options.height_px is None):
        raise ValueError("--width-px and --height-px belong together")
    if not 0 < options.fov_min_deg <= options.fov_max_deg:
        raise ValueError(
            f"--fov-min-deg {options.fov_min_deg:g} is not below --fov-max-deg "
            f"{options.fov_max_deg:g}: give the narrowest and the widest field of view in question"
        )
    return Asked(
        camera=None if options.camera is None else read_camera(options.camera),
        fov_deg=options.fov_deg, fov_tolerance_percent=options.fov_tolerance_percent,
        fov_range_deg=(options.fov_min_deg, options.fov_max_deg), parity=options.parity,
        size_px=None if options.width_px is None else (options.width_px, options.height_px),
        catalog=options.catalog, epoch=options.epoch,
        limiting_magnitude=options.limiting_magnitude, independent=options.independent,
        settings=SolveSettings(method="match_group", deadline_ms=options.deadline_ms),
        detect=DetectSettings(max_stars=options.max_stars), bayer=options.bayer or "",
    )


def record_of(result: Result) -> Record:
    """Return a result as plain values."""
    solution, frame = result.solution, result.frame
    if solution is None or frame is None:
        return {"file": str(result.path), "status": "UNUSABLE", "reason": result.error}
    attitude, camera = solution.attitude, solution.camera
    record: Record = {
        "file": str(result.path), "status": solution.status.value, "ra_deg": None,
        "dec_deg": None, "roll_deg": None, "fov_deg": None, "parity": solution.parity,
        "n_detected": len(frame.xy_px), "n_identified": len(solution.identification.identified),
        "wrong_probability": solution.wrong_probability, "rms_px": solution.rms_px,
        "detect_ms": frame.detect_ms, "solve_ms": solution.solve_ms, "reason": solution.reason,
    }
    if attitude is not None and camera is not None:
        record |= {
            "ra_deg": float(np.degrees(attitude.ra_rad)),
            "dec_deg": float(np.degrees(attitude.dec_rad)),
            "roll_deg": float(np.degrees(attitude.roll_rad)), "fov_deg": camera.fov_deg,
        }
    return record


def _print(result: Result, *, as_json: bool) -> None:
    record: dict[str, Any] = record_of(result)
    if as_json:
        print(json_text(record))
    elif result.error:
        print(f"UNUSABLE  {result.error}")
    elif result.is_solved:
        print(
            "SOLVED    {file}  RA {ra_deg:.4f} Dec {dec_deg:+.4f} roll {roll_deg:.2f} deg  "
            "field {fov_deg:.4g} deg {parity}  {n_identified} of {n_detected} stars  "
            "p(wrong) {wrong_probability:.0e}  rms {rms_px:.2f} px".format(**record)
        )
    else:
        print(
            f"{record['status']!s:9} {record['file']}  {record['n_detected']} stars: "
            f"{record['reason']}"
        )


def _write(results: Sequence[Result], options: argparse.Namespace) -> None:
    """Write the files that are asked for."""
    if options.csv is not None:
        _write_table(options.csv, _COLUMNS, [record_of(result) for result in results])
    for result in results:
        if not result.is_solved or result.solution is None:
            continue
        if options.stars is not None:
            _write_table(
                options.stars / f"{result.path.name}.stars.csv", _STAR_COLUMNS, _stars(result)
            )
        if options.wcs is not None:
            write_whole(
                options.wcs / f"{result.path.name}.wcs", header_text(result.solution)
            )


def _stars(result: Result) -> list[Record]:
    """Return a row for each centroid of a solved file."""
    solution, frame = result.solution, result.frame
    if solution is None or frame is None or solution.catalog is None:
        return []
    found, catalog = solution.identification, solution.catalog
    rows: list[Record] = []
    for i, (x, y) in enumerate(frame.xy_px.tolist()):
        row: Record = {"x_px": x, "y_px": y, "state": int(found.state[i])}
        star = int(found.catalog_index[i])
        if star >= 0:
            ra, dec = np.degrees(ra_dec(catalog.vectors[star]))
            row |= {
                "hip": int(catalog.hip[star]), "v_mag": float(catalog.v_mag[star]),
                "ra_deg": float(ra), "dec_deg": float(dec),
                "residual_px": float(found.residual_px[i]),
            }
        rows.append(row)
    return rows


def _write_table(path: Path, columns: Sequence[str], rows: Sequence[Record]) -> None:
    """Write rows as CSV; raises ValueError where the place does not take it."""
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, restval="")
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror}") from error
