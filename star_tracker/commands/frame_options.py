"""What the commands that take frames of a camera have in common: files, camera, sky."""

import argparse
import os
from glob import glob
from pathlib import Path

from star_tracker.calibration.camera_file import read_camera
from star_tracker.catalogue.catalog import DEFAULT_LIMITING_MAGNITUDE, StarCatalog
from star_tracker.commands.options import add_values
from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.image import BAYER_PATTERNS
from star_tracker.maps.star_map import PAPER_MAPS, STAR_MAPS_FOLDER
from star_tracker.offline.solving import Asked
from star_tracker.optics.camera import PARITIES, PIXEL_ORIGINS, Camera
from star_tracker.resources import resource_path
from star_tracker.solution import SolveSettings


def add_camera_arguments(camera: argparse._ArgumentGroup) -> None:
    """Declare what may be known of the camera."""
    add_values(
        camera,
        ("--fov-deg", 0.0, "DEG", "field of view across the width, deg; 0 = unknown"),
        ("--fov-tolerance-percent", 5.0, "PERCENT", "how far that may be off, percent"),
        ("--fov-min-deg", 4.0, "DEG", "least field where it is unknown, deg"),
        ("--fov-max-deg", 70.0, "DEG", "greatest field where it is unknown, deg"),
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
        "--pixel-origin", choices=tuple(PIXEL_ORIGINS), default="corner",
        help="of the first pixel, where a list's coordinates are counted from, and those of bags "
        "without CameraInfo (%(default)s)",
    )
    camera.add_argument(
        "--bayer", default=None, metavar="RGGB", help="colour pattern of raw images (none)"
    )


def add_sky_arguments(more: argparse._ArgumentGroup) -> None:
    """Declare the guide stars and how long is searched, with how many processes."""
    add_values(
        more,
        ("--epoch", 2000.0, "YEAR", "epoch of the stars' places, Julian year"),
        ("--limiting-magnitude", 0.0, "MAG", "faintest stars, mag; 0 = as suits"),
        ("--catalog", "hipparcos", "NAME", "catalogue of the stars"),
        ("--max-stars", DetectSettings().max_stars, "N", "brightest stars that are used"),
        ("--deadline-ms", 5000.0, "MS", "longest search of a file, ms"),
        ("--jobs", os.cpu_count() or 1, "N", "processes that detect stars"),
    )


def paths_of(word: str) -> list[Path]:
    """Return the files that a word names: one, a shipped star map by its number, or a pattern's.

    A pattern that the shell has left as it is fits none, unless it was quoted.
    """
    if word in {str(number) for number in PAPER_MAPS} and not Path(word).exists():
        return [resource_path(f"{STAR_MAPS_FOLDER}/map{word}.csv")]
    if set(word) & set("*?[") and not Path(word).exists():
        return [Path(one) for one in sorted(glob(word, recursive=True))]
    return [Path(word)]


def asked_of(options: argparse.Namespace) -> Asked:
    """Return what the options say. Raises ValueError for what cannot be or does not fit."""
    if (options.width_px is None) != (options.height_px is None):
        raise ValueError("--width-px and --height-px belong together")
    if not 0 < options.fov_min_deg <= options.fov_max_deg:
        raise ValueError(
            f"--fov-min-deg {options.fov_min_deg:g} is not below --fov-max-deg "
            f"{options.fov_max_deg:g}: give the narrowest and the widest field of view in question"
        )
    bayer = (options.bayer or "").lower()
    if bayer not in ("", *BAYER_PATTERNS):
        raise ValueError(f"--bayer {options.bayer} is unknown: use {', '.join(BAYER_PATTERNS)}")
    # Looked at here, so that no file is read for options that cannot be honoured.
    Camera.from_fov(
        options.fov_deg if options.fov_deg != 0 else options.fov_min_deg, 1, 1,
        tolerance_percent=options.fov_tolerance_percent,
    )
    StarCatalog.named(
        options.catalog, epoch=options.epoch,
        limiting_magnitude=options.limiting_magnitude or DEFAULT_LIMITING_MAGNITUDE,
    )
    return Asked(
        camera=None if options.camera is None else read_camera(options.camera),
        fov_deg=options.fov_deg, fov_tolerance_percent=options.fov_tolerance_percent,
        fov_range_deg=(options.fov_min_deg, options.fov_max_deg), parity=options.parity,
        size_px=None if options.width_px is None else (options.width_px, options.height_px),
        pixel_origin=options.pixel_origin,
        catalog=options.catalog, epoch=options.epoch,
        limiting_magnitude=options.limiting_magnitude,
        settings=SolveSettings(method="match_group", deadline_ms=options.deadline_ms),
        detect=DetectSettings(max_stars=options.max_stars), bayer=bayer,
    )
