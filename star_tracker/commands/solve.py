"""`star_tracker solve`: images, centroids, star maps and bags in, attitudes out. No ROS."""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from glob import glob
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from star_tracker.bags.reading import DamagedBagError, Wanted, is_bag, open_bag
from star_tracker.bags.writing import STORAGES
from star_tracker.calibration.camera_file import read_camera
from star_tracker.commands.options import add_json_argument
from star_tracker.commands.solve_output import Output
from star_tracker.detection.centroids import DetectSettings
from star_tracker.maps.star_map import PAPER_MAPS, STAR_MAPS_FOLDER
from star_tracker.offline.solving import Asked, Result, frames_of, solve_frames
from star_tracker.offline.spreading import Spread
from star_tracker.optics.camera import PARITIES
from star_tracker.resources import resource_path
from star_tracker.solution import SolveSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the files, what is known of the camera, and what is written."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE",
        help="image, list of centroids, star map or bag; a number from 1 to 8 is a shipped map",
    )
    add_json_argument(parser)
    _add_written(parser)
    _add_camera_arguments(parser.add_argument_group("camera (found out where it is not told)"))
    _add_bag_arguments(parser.add_argument_group("bags"))
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
        "--scheduler", metavar="ADDRESS",
        help="detect on the Dask cluster of this scheduler, for instance tcp://host:8786 (this "
        "machine's processes)",
    )
    more.add_argument(
        "--independent", action="store_true", help="learn nothing from one file for another"
    )


def _add_written(parser: argparse.ArgumentParser) -> None:
    """Declare what is written besides what is printed."""
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
    parser.add_argument(
        "--annotate", type=Path, metavar="DIR",
        help="where each solved image goes with its stars drawn over it, PNG (none)",
    )


def _add_bag_arguments(bags: argparse._ArgumentGroup) -> None:
    """Declare what is read of a bag, and the bag that is written."""
    bags.add_argument(
        "--topic", metavar="NAME", help="of images or centroids (the only one that there is)"
    )
    bags.add_argument(
        "--camera-info-topic", metavar="NAME", help="of CameraInfo (camera_info beside the topic)"
    )
    bags.add_argument(
        "--output-bag", type=Path, metavar="FILE",
        help="where a bag with attitudes and identified stars goes; a name in .mcap or .db3 is "
        "one file, any other a folder (none)",
    )
    bags.add_argument(
        "--storage", choices=tuple(STORAGES), help="of a bag that is a folder (mcap)"
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
    """Solve files and bags. Ends with exit code 1 where one of them could not be used at all."""
    asked = _asked(options)
    spread = Spread(options.jobs, options.scheduler or "")
    named = {word: _paths(word) for word in options.files}
    paths = [path for found in named.values() for path in found]
    bags = [path for path in paths if is_bag(path)]
    files = [path for path in paths if not is_bag(path)]
    _check(options, bags)
    output = Output(options)
    for word in (word for word, found in named.items() if not found):
        text = f"no file fits {word}: check the folder and the ending"
        output.take(Result(Path(word), None, None, text))
    console = Console(stderr=True)
    # What is printed meanwhile goes around the bar only where it goes to the terminal, too.
    with Progress(
        console=console, transient=True, disable=not console.is_terminal,
        redirect_stdout=sys.stdout.isatty(),
    ) as progress:
        bar = progress.add_task("solving", total=len(files))
        if len(files) == 1 and not spread.scheduler:
            spread = replace(spread, jobs=1)  # a process would start for longer than it works
        frames = frames_of(files, asked, spread)
        for result in solve_frames(files, frames, asked, done=lambda: progress.advance(bar)):
            output.take(result)
        for path in bags:
            _solve_bag(path, asked, options, output, progress)
    output.finish()
    if output.failed:
        sys.exit(1)


def _solve_bag(
    path: Path, asked: Asked, options: argparse.Namespace, output: Output, progress: Progress
) -> None:
    """Solve the frames of a bag; what is wrong with it becomes its result."""
    from star_tracker.bags.output import declare_topics, write_result
    from star_tracker.bags.solving import BagSolver
    from star_tracker.bags.writing import new_bag

    wanted = Wanted(options.topic or "", options.camera_info_topic or "", asked.parity)
    spread = Spread(options.jobs, options.scheduler or "")
    with ExitStack() as stack:
        try:
            bag = stack.enter_context(open_bag(path, wanted))
            solver = BagSolver(bag, asked)
        except ValueError as error:
            output.take(Result(path, None, None, str(error)))
            return
        if solver.note:
            print(f"star_tracker solve: {solver.note}", file=sys.stderr)
        writer = None
        if options.output_bag is not None:
            writer = stack.enter_context(new_bag(options.output_bag, options.storage))
            declare_topics(writer)
        bar = progress.add_task(path.name, total=bag.n_frames)
        try:
            for frame, result in solver.results(spread):
                output.take(result)
                if writer is not None:
                    write_result(writer, frame, result)
                progress.advance(bar)
        except DamagedBagError as error:
            output.take(Result(path, None, None, str(error)))


def _paths(word: str) -> list[Path]:
    """Return the files that a word names: one, a shipped star map by its number, or a pattern's.

    A pattern that the shell has left as it is fits none, unless it was quoted.
    """
    if word in {str(number) for number in PAPER_MAPS} and not Path(word).exists():
        return [resource_path(f"{STAR_MAPS_FOLDER}/map{word}.csv")]
    if set(word) & set("*?[") and not Path(word).exists():
        return [Path(one) for one in sorted(glob(word, recursive=True))]
    return [Path(word)]


def _check(options: argparse.Namespace, bags: Sequence[Path]) -> None:
    """Raise ValueError for options that do not fit the files."""
    if options.output_bag is not None and len(bags) != 1:
        raise ValueError("--output-bag takes what comes of one bag: name one at a time")
    if options.annotate is not None:
        if bags:
            raise ValueError("--annotate draws over image files: leave it out for bags")
        if find_spec("matplotlib") is None:
            raise ValueError("pictures need matplotlib: pip install 'star_tracker[plot]'")


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
