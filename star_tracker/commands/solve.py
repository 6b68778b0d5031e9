"""`star_tracker solve`: images, centroids, star maps and bags in, attitudes out. No ROS."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from rich.progress import Progress

from star_tracker.bags.reading import DamagedBagError, Wanted, is_bag, open_bag
from star_tracker.bags.writing import STORAGES
from star_tracker.commands.frame_options import (
    add_camera_arguments,
    add_sky_arguments,
    asked_of,
    paths_of,
)
from star_tracker.commands.options import add_json_argument
from star_tracker.commands.printing import bar_console
from star_tracker.commands.solve_output import Output
from star_tracker.offline.solving import Asked, Result, frames_of, solve_frames
from star_tracker.offline.spreading import Spread


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the files, what is known of the camera, and what is written."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE",
        help="image, list of centroids, star map or bag; a number from 1 to 8 is a shipped map",
    )
    add_json_argument(parser)
    _add_written(parser)
    add_camera_arguments(parser.add_argument_group("camera (found out where it is not told)"))
    _add_bag_arguments(parser.add_argument_group("bags"))
    more = parser.add_argument_group("sky and work")
    add_sky_arguments(more)
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


def execute(options: argparse.Namespace) -> None:
    """Solve files and bags. Ends with exit code 1 where one of them could not be used at all."""
    asked = replace(asked_of(options), independent=options.independent)
    spread = Spread(options.jobs, options.scheduler or "")
    named = {word: paths_of(word) for word in options.files}
    paths = [path for found in named.values() for path in found]
    bags = [path for path in paths if is_bag(path)]
    files = [path for path in paths if not is_bag(path)]
    _check(options, bags)
    if options.stars or options.wcs or options.annotate:
        _require_names_of_their_own(paths)
    output = Output(options)
    for word in (word for word, found in named.items() if not found):
        text = f"no file fits {word}: check the folder and the ending"
        output.take(Result(Path(word), None, None, text))
    console = bar_console()
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


def _require_names_of_their_own(paths: Sequence[Path]) -> None:
    """Raise ValueError for two files of one name, as what is written is called after them."""
    named: dict[str, Path] = {}
    for path in paths:
        other = named.setdefault(path.name, path)
        if other != path:
            raise ValueError(
                f"{other} and {path} have one name, and so would what is written of them: solve "
                "them one after the other, or rename one"
            )


def _check(options: argparse.Namespace, bags: Sequence[Path]) -> None:
    """Raise ValueError for options that do not fit the files."""
    if options.output_bag is not None and len(bags) != 1:
        raise ValueError("--output-bag takes what comes of one bag: name one at a time")
    if options.storage is not None and options.output_bag is None:
        raise ValueError("--storage is that of --output-bag: name one")
    if options.annotate is not None:
        if bags:
            raise ValueError("--annotate draws over image files: leave it out for bags")
        if find_spec("matplotlib") is None:
            raise ValueError(
                "pictures need matplotlib: apt install python3-matplotlib, or pip install "
                "matplotlib"
            )
