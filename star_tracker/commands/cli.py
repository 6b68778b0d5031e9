"""The console command `star_tracker`. Only `watch` needs ROS.

The commands are modules of `star_tracker.commands`, each with `add_arguments` and `execute`; a
dash in a command's name is an underscore in its module's. Only the one that is asked for is
imported, so that no command waits for the libraries of another.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

from star_tracker.resources import package_version

#: Exit codes: what cannot be used; the reader of the output is gone; Ctrl-C, as shells have it.
UNUSABLE, NO_READER, INTERRUPTED = 2, 1, 130


class Command(NamedTuple):
    """What a command says of itself.

    Attributes:
        summary: its line in the list of commands.
        description: what it does and needs.
        example: a line to copy.
    """

    summary: str
    description: str
    example: str


#: The commands by name.
COMMANDS = {
    "solve": Command(
        "attitudes of images, lists of centroids, star maps and bags",
        "Detect the stars of each file, identify them and tell where the camera points. Nothing "
        "has to be known of the camera; what one file tells of it is used for the others. A bag "
        "is solved frame by frame, with its CameraInfo, as identify_node does.",
        "star_tracker solve 1",
    ),
    "evaluate": Command(
        "robustness of both methods and their paper forms",
        "Robustness of both methods, each also in the paper's form: on the eight maps, and "
        "against noise, missing and false stars, brightness errors, a wrong camera and a mirrored "
        "sky. Writes report.html and results.csv; a run that was ended resumes.",
        "star_tracker evaluate --quick --output evaluation",
    ),
    "boresight": Command(
        "boresight of a star map from three stars",
        "Boresight from three stars and their distances from the image's centre, with known "
        "focal length by two methods and with unknown focal length (docs/boresight.md).",
        "star_tracker boresight 1 --stars A01,A02,A03",
    ),
    "calibrate": Command(
        "focal length and lens from a camera's frames, or a star map",
        "Focal length and distortion of one camera by joint least squares over the stars of all "
        "frames that it took, of which nothing has to be known; or of one star map, with the "
        "terms that its data support.",
        "star_tracker calibrate 7 --terms k1",
    ),
    "compile": Command(
        "compile the solver ahead of the first start",
        "Compile all that a node runs and keep it, for a Dockerfile, a flight image or systemd's "
        "ExecStartPre: about a minute, once for each installation. NUMBA_CACHE_DIR says where.",
        "star_tracker compile",
    ),
    "geometry": Command(
        "which stars of a star map fix the boresight best",
        "Error factor K, tetrahedron volume and predicted boresight error of all triples of a "
        "star map, and the predicted errors of the attitude from all stars.",
        "star_tracker geometry 1 --by k --top 3",
    ),
    "make-bag": Command(
        "the eight star maps as a bag for ros2 bag play",
        "Write the maps as centroids with camera_info, or images rendered of their sky, to an "
        "MCAP or sqlite3 bag. Needs rosbags, not ROS.",
        "star_tracker make-bag maps.mcap",
    ),
    "plot": Command(
        "picture of a star map or of your own frame with its stars",
        "Solve one frame and draw it: guide stars, centroids with their numbers, displaced and "
        "missing stars, residuals, right ascension and declination. Needs matplotlib.",
        "star_tracker plot 6 --output map6.png",
    ),
    "render": Command(
        "image that a camera would take of the sky, with its truth",
        "Render the stars that a camera sees at an attitude: lens, exposure, sky, clouds, noise, "
        "hot pixels, saturation, streaks, a planet. --json prints where the stars stand. The same "
        "seed gives the same image.",
        "star_tracker render sky.png --ra-deg 84 --dec-deg 2",
    ),
    "watch": Command(
        "live view of a running identify_node (needs ROS)",
        "Attitude with its errors, how the last frame ended, health and identified stars of a "
        "running identify_node, until Ctrl-C. Where standard output is no terminal it needs "
        "--once or --json.",
        "star_tracker watch --namespace /left --once",
    ),
}


class _Formatter(argparse.HelpFormatter):
    """Room for the options' names in one column."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32)
        # argparse forgets that the commands' names are indented twice, and breaks their lines.
        self._action_max_length = max(map(len, COMMANDS)) + 2 * self._indent_increment


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as all of the command's are."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_Formatter, **options)

    def error(self, message: str) -> NoReturn:
        """Say in one line what cannot be used, and where help is; end with exit code 2."""
        _complain(self.prog, f"{message} (see {self.prog} --help)")
        self.exit(UNUSABLE)


def make_parser(asked_for: str | None) -> Parser:
    """Return the parser, with the options of the command that is asked for, if there is one."""
    parser = Parser(
        prog="star_tracker", description="Star identification and attitude determination.",
        epilog="example: star_tracker boresight 1",
    )
    parser.add_argument(
        "--version", action="version", version=f"%(prog)s {package_version()}",
        help="print the version and exit",
    )
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", title="commands"
    )
    for name, command in COMMANDS.items():
        one = commands.add_parser(
            name, help=command.summary, description=command.description,
            epilog=f"example: {command.example}",
        )
        if name == asked_for:
            _module(name).add_arguments(one)
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; return the exit code: 2, with one line, for what cannot be used."""
    args = sys.argv[1:] if args is None else args
    # No option before the command takes a value, so that the first word is the command.
    name = next((word for word in args if not word.startswith("-")), None)
    try:
        options = make_parser(name).parse_args(args)
        _module(options.command).execute(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # As `| head -1` does. What is left to print goes nowhere, also at Python's own end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return NO_READER
    except (ValueError, OSError) as error:
        _complain(f"star_tracker {name}", str(error))
        return UNUSABLE
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0


def _module(name: str) -> Any:
    return import_module(f"star_tracker.commands.{name.replace('-', '_')}")


def _complain(who: str, message: str) -> None:
    print(f"{who}: {' '.join(message.split())}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
