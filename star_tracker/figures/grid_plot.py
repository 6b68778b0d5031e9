"""The grid of right ascension and declination in a picture, each line with its label."""

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes

from star_tracker.figures.placement import overlap_area
from star_tracker.figures.sky_grid import GridLine, grid_lines
from star_tracker.figures.style import text_box
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera

_COLOR = "0.72"
_LABEL_PT = 7.0
#: Where a line may end in a label: side of the image, direction from the border in points,
#: alignment. Outside at the top and at the right, where no pixels are numbered; else inside.
_SIDES = (
    ("top", (0, 4), "center", "bottom"), ("right", (4, 0), "left", "center"),
    ("bottom", (0, 4), "center", "bottom"), ("left", (4, 0), "left", "center"),
)


def draw_grid(axes: Axes, camera: Camera, rotation: Floats, symbols: Floats) -> Floats:
    """Draw the lines and return the boxes (k, 4) of their labels, display units.

    A line whose label would cover another one, or one of the `symbols` (m, 4), boxes, is drawn
    without.
    """
    taken = symbols
    for line in grid_lines(camera, rotation):
        axes.plot(
            *line.xy_px.T, color=_COLOR, linewidth=0.7, zorder=1,
            linestyle="-" if line.is_ra else (0, (4, 2)),
        )
        taken = _label(axes, line, taken)
    return taken[len(symbols):]


def _label(axes: Axes, line: GridLine, taken: Floats) -> Floats:
    """Write a line's label at the first of its ends that is free; return what is taken now."""
    ends = _ends(axes, line.xy_px)
    for side, offset, ha, va in _SIDES:
        for end in ends.get(side, []):
            text = axes.annotate(
                line.label, (end[0], end[1]), offset, xycoords="axes fraction",
                textcoords="offset points", ha=ha, va=va, fontsize=_LABEL_PT, color="0.3",
                zorder=1.2, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
            )
            box = text_box(text)
            if not np.any(overlap_area(box, taken) > 0):
                return np.vstack([taken, box])
            text.remove()
    return taken


def _ends(axes: Axes, xy_px: Floats) -> dict[str, list[Floats]]:
    """Return where a line crosses the sides of the image, in fractions of its size."""
    to_axes = axes.transData + axes.transAxes.inverted()
    path = np.full(xy_px.shape, np.nan)
    finite = np.isfinite(xy_px).all(axis=1)
    path[finite] = to_axes.transform(xy_px[finite])
    ends: dict[str, list[Floats]] = {}
    for a, b in pairwise(path):
        if not np.isfinite([a, b]).all():
            continue
        for side, axis, level in (
            ("top", 1, 1.0), ("right", 0, 1.0), ("bottom", 1, 0.0), ("left", 0, 0.0)
        ):
            if (a[axis] - level) * (b[axis] - level) < 0:
                crossing = a + (level - a[axis]) / (b[axis] - a[axis]) * (b - a)
                if 0 <= crossing[1 - axis] <= 1:
                    ends.setdefault(side, []).append(crossing)
    return ends
