"""What the commands that work on one star map have in common: options and units."""

import argparse
import json
import math
from pathlib import Path

#: One answer as plain values, units in the names.
Record = dict[str, object]


def add_map_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the map and the form of the output."""
    parser.add_argument(
        "map", metavar="MAP",
        help="number of a map, 1 to 8, or a star map file; a file without star numbers is "
        "identified first",
    )
    add_json_argument(parser)


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the output for machines, which every command has."""
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def add_values(
    group: argparse._ActionsContainer, *values: tuple[str, float | str, str, str]
) -> None:
    """Declare options that have a default: name, default, metavar and what the help says."""
    for option, default, metavar, text in values:
        group.add_argument(
            option, type=type(default), default=default, metavar=metavar,
            help=f"{text} (%(default)s)",
        )


def add_focal_length_argument(parser: argparse._ActionsContainer, purpose: str) -> None:
    """Declare another focal length than that of the map."""
    parser.add_argument(
        "--focal-length-px", type=float, metavar="PX", help=f"{purpose}, px (that of the map)"
    )


def add_sigma_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the noise that predicted errors are for."""
    parser.add_argument(
        "--sigma-px", type=float, default=0.1, metavar="PX",
        help="noise of a centroid along each axis, for the predicted errors, px (%(default)s)",
    )


def check_positive(options: argparse.Namespace, *names: str) -> None:
    """Raise ValueError for an option that is given but not a finite number above 0."""
    for name in names:
        value = getattr(options, name)
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"--{name.replace('_', '-')} must be a number greater than 0")


def check_writable(path: Path | None) -> None:
    """Raise ValueError for a file that cannot be written, before there is anything to write."""
    if path is None:
        return
    if path.is_dir():
        raise ValueError(f"{path} is a folder: name a file")
    if not path.parent.is_dir():
        raise ValueError(f"{path} cannot be written: there is no folder {path.parent}")


def json_text(record: Record, indent: int | None = None) -> str:
    """Return a record as JSON; a number that is not finite becomes null, as JSON has none."""
    return json.dumps(_finite(record), indent=indent, allow_nan=False)


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
