"""The console command `star_tracker`. No ROS is needed for it."""

import argparse
import sys
from collections.abc import Sequence

from star_tracker.commands import boresight, calibrate, compare, geometry, plot

#: Each command: its module, its line of help and what it says of itself.
COMMANDS = {
    "compare": (
        compare, "compare both methods and their paper forms",
        "Compare both methods, each also in the paper's form, on the eight maps and under noise, "
        "missing and false stars.",
    ),
    "boresight": (
        boresight, "boresight of a star map from three stars",
        "Boresight from three stars and their distances from the image's centre, with known "
        "focal length by two methods and with unknown focal length (docs/boresight.md).",
    ),
    "calibrate": (
        calibrate, "focal length and lens from the stars of a star map",
        "Focal length, and where the data support them principal point and radial distortion, "
        "by joint least squares over all matched stars of a star map.",
    ),
    "geometry": (
        geometry, "which stars of a star map fix the boresight best",
        "Error factor K, tetrahedron volume and predicted boresight error of all triples of a "
        "star map, and the predicted errors of the attitude from all stars.",
    ),
    "plot": (
        plot, "picture of a star map or of your own frame with its stars",
        "Solve one frame and draw it: guide stars, centroids with their numbers, displaced and "
        "missing stars, residuals, right ascension and declination. Needs matplotlib.",
    ),
}


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; return the exit code: 2, with one line, for what cannot be used."""
    parser = argparse.ArgumentParser(
        prog="star_tracker", description="Star identification and attitude determination."
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (module, summary, description) in COMMANDS.items():
        module.add_arguments(commands.add_parser(name, help=summary, description=description))
    options = parser.parse_args(args)
    try:
        COMMANDS[options.command][0].execute(options)
    except (ValueError, FileNotFoundError) as error:
        print(f"star_tracker {options.command}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
