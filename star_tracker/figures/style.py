"""What all pictures share: colours, type, and how a figure becomes a file.

A picture is made without a screen and without pyplot's global state; the same input gives the
same bytes. What a symbol means shows in its shape and its lightness first, in its colour second.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import patheffects, style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from star_tracker.geometry.spherical import Floats

#: Of Okabe and Ito's palette, which colour-blind eyes can tell apart (jfly.uni-koeln.de/color).
BLUE, VERMILION = "#0072B2", "#D55E00"
#: The sequential colour map: its lightness grows steadily, for colour-blind eyes and in grey.
SEQUENTIAL = "cividis"
#: Makes the names inside of an SVG file the same in each run: matplotlib's `svg.hashsalt`.
SVG_SALT = "star_tracker"
#: Arguments of matplotlib that give a symbol its looks.
Looks = dict[str, Any]
#: Around text that lies on something: text can be read on any ground.
HALO = (patheffects.withStroke(linewidth=1.8, foreground="white"),)
FORMATS = (".png", ".svg", ".pdf")
#: What matplotlib would write of time and version into a file, left out.
_METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None},
}
_SETTINGS = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.linewidth": 0.8,
    "svg.hashsalt": SVG_SALT,
    "path.simplify": False,
    # A name with dollar signs in it is no formula.
    "text.parse_math": False,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw as the project does, whatever the user's own settings of matplotlib are."""
    with style.context(["default", _SETTINGS]):
        yield


def new_figure(width_in: float, height_in: float, dpi: float = 100.0) -> Figure:
    """Return an empty figure with a canvas that can measure text."""
    figure = Figure(figsize=(width_in, height_in), dpi=dpi)
    FigureCanvasAgg(figure)
    return figure


def text_box(text: Text) -> Floats:
    """Return the box (4,) that a text takes: left, bottom, right, top, in display units."""
    assert text.figure is not None
    canvas: Any = text.figure.canvas
    return np.array(text.get_window_extent(canvas.get_renderer()).extents, float)


def check_format(path: Path) -> None:
    """Raise ValueError for a file name that does not say one of the formats."""
    if path.suffix.lower() not in FORMATS:
        raise ValueError(
            f"a picture cannot be written as {path.name!r}: give a name that ends in "
            f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        )


def save(figure: Figure, path: Path, dpi: float) -> None:
    """Write a figure. Raises ValueError where the file's format or place cannot be used."""
    check_format(path)
    try:
        figure.savefig(path, dpi=dpi, metadata=_METADATA[path.suffix.lower()])
    except OSError as error:
        raise ValueError(
            f"the picture {path} cannot be written: {error.strerror or error}"
        ) from error


