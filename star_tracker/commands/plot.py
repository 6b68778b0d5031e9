"""`star_tracker plot`: a picture of one field with its stars (paper, figures 5-10 to 5-17)."""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from star_tracker.catalogue.catalog import CATALOGS, StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.commands.options import Record, add_json_argument, check_positive
from star_tracker.commands.printing import print_result
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.searcher import METHODS
from star_tracker.maps.frame_file import read_frame
from star_tracker.maps.star_map import StarMap, paper_maps, read_star_map
from star_tracker.optics.camera import PARITIES, Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

#: A picture can wait longer for its frame than a spacecraft.
_DEADLINE_MS = 10_000.0
_CAMERA = ("fov_deg", "width_px", "height_px")
_MOST_DPI = 1200.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "map", metavar="MAP|FILE",
        help="number of a map, 1 to 8, a star map file, or a CSV file of your own frame with "
        "columns x,y or x,y,intensity and the options of the camera",
    )
    parser.add_argument(
        "--fov-deg", type=float, metavar="DEG",
        help="field of view across your frame's width, deg (that of the map)",
    )
    parser.add_argument(
        "--width-px", type=int, metavar="PX", help="your frame's width, px (that of the map)"
    )
    parser.add_argument(
        "--height-px", type=int, metavar="PX", help="your frame's height, px (that of the map)"
    )
    parser.add_argument(
        "--parity", choices=PARITIES, help="your frame's parity (that of the map, else auto)"
    )
    parser.add_argument(
        "--catalog", choices=CATALOGS, default="paper", help="the guide stars (%(default)s)"
    )
    parser.add_argument(
        "--limiting-magnitude", type=float, default=6.0, metavar="MAG",
        help="faintest guide stars of catalog hipparcos, V mag (%(default)s)",
    )
    parser.add_argument(
        "--epoch", type=float, default=2000.0, metavar="YEAR",
        help="epoch of the guide stars, Julian year (%(default)s)",
    )
    parser.add_argument(
        "--method", choices=("auto", *METHODS), default="auto",
        help="how to identify the stars (%(default)s)",
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE",
        help="where to write the picture, as .png, .svg or .pdf (map1.png or FILE.png)",
    )
    parser.add_argument(
        "--dpi", type=float, default=130.0, metavar="N",
        help="resolution of a .png, dots per inch (%(default)s)",
    )
    add_json_argument(parser)


def execute(options: argparse.Namespace) -> None:
    """Solve one frame and draw it. Raises ValueError for what cannot be used."""
    if find_spec("matplotlib") is None:
        raise ValueError(
            "pictures need matplotlib: apt install python3-matplotlib, or pip install "
            "matplotlib"
        )
    from star_tracker.figures import style
    from star_tracker.figures.field_plot import draw_field
    from star_tracker.figures.field_view import FieldView

    check_positive(options, *_CAMERA, "dpi")
    if options.dpi > _MOST_DPI:
        raise ValueError(f"--dpi must be at most {_MOST_DPI:g}")
    frame, intensity = _frame(options)
    stem = f"map{int(options.map)}" if options.map.isdecimal() else Path(options.map).stem
    output = options.output or Path(f"{stem}.png")
    style.check_format(output)
    catalog = StarCatalog.named(
        options.catalog, limiting_magnitude=options.limiting_magnitude, epoch=options.epoch
    )
    settings = SolveSettings(options.method, deadline_ms=_DEADLINE_MS)
    tracker = StarTracker(FeatureDatabase.cached(catalog), frame.camera, settings)
    solution = tracker.solve(frame.xy_px, intensity)
    view = FieldView(frame.name, frame.camera, frame.labels, frame.xy_px, solution, catalog)
    with style.house_style():
        style.save(draw_field(view), output, options.dpi)
    record: Record = {"map": frame.name, "output": str(output), **view.record()}
    if options.json:
        print_result(record, [], as_json=True)
    else:
        print(f"{output}: {view.summary}")


def _frame(options: argparse.Namespace) -> tuple[StarMap, Floats | None]:
    """Return map 1 to 8, a star map file, or a plain file with the camera that the options tell.

    The second value is the brightness (n,), where the file has it. Raises ValueError for a file
    that cannot be read, and a camera given twice or not at all.
    """
    given = [name for name in (*_CAMERA, "parity") if getattr(options, name) is not None]
    path = Path(options.map)
    if options.map.isdecimal():
        (star_map,) = paper_maps((int(options.map),))
        if given:
            raise ValueError(f"{star_map.name} has its own camera: leave out {_option(given[0])}")
        return star_map, None
    if given:
        return _plain_frame(path, options)
    try:
        return read_star_map(path), None
    except ValueError as error:
        if not path.is_file():
            raise
        raise ValueError(
            f"{error}; a plain file of x,y needs --fov-deg, --width-px and --height-px"
        ) from error


def _plain_frame(path: Path, options: argparse.Namespace) -> tuple[StarMap, Floats | None]:
    for name in _CAMERA:
        if getattr(options, name) is None:
            raise ValueError(f"the camera of {path.name} is not known: give {_option(name)}")
    camera = Camera.from_fov(
        options.fov_deg, options.width_px, options.height_px, parity=options.parity or "auto"
    )
    xy_px, intensity = read_frame(path)
    n = len(xy_px)
    labels = tuple(str(i + 1) for i in range(n))
    return StarMap(path.name, camera, labels, xy_px, np.zeros(n, int), np.zeros(n)), intensity


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
