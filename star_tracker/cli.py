"""The console command `star_tracker`. No ROS is needed for it."""

import argparse
import sys
from collections.abc import Sequence

from star_tracker import compare


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; return the exit code: 2, with one line, for what cannot be used."""
    parser = argparse.ArgumentParser(
        prog="star_tracker", description="Star identification and attitude determination."
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    command = commands.add_parser(
        "compare", help="compare both methods and their paper forms",
        description="Compare both methods, each also in the paper's form, on the eight maps and "
        "under noise, missing and false stars.",
    )
    compare.add_arguments(command)
    options = parser.parse_args(args)
    try:
        compare.execute(options)
    except (ValueError, FileNotFoundError) as error:
        print(f"star_tracker {options.command}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
