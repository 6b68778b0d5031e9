"""The grid of right ascension and declination in a picture, each line with its label."""

import numpy as np
from matplotlib.axes import Axes

from star_tracker.figures.placement import overlap_area
from star_tracker.figures.sky_grid import GridLine, grid_lines
from star_tracker.figures.style import text_box
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera

_LABEL_PT = 7.0
#: Where a line may end in a label: axis and fraction of it that is a side of the image, direction
#: from the border in points, alignment. Outside at the top and at the right, where no pixels are
#: numbered; else inside.
_SIDES = (
    (1, 1.0, (0, 4), "center", "bottom"), (0, 1.0, (4, 0), "left", "center"),
    (1, 0.0, (0, 4), "center", "bottom"), (0, 0.0, (4, 0), "left", "center"),
)


def draw_grid(axes: Axes, camera: Camera, rotation: Floats, symbols: Floats) -> Floats:
    """Draw the lines and return the boxes (k, 4) of their labels, display units.

    A line whose label would cover another one, or one of the `symbols` (m, 4), boxes, is drawn
    without.
    """
    taken = symbols
    for line in grid_lines(camera, rotation):
        for path in line.paths:
            axes.plot(
                *path.T, color="0.72", linewidth=0.7, zorder=1,
                linestyle="-" if line.is_ra else (0, (4, 2)),
            )
        taken = _label(axes, line, taken)
    return taken[len(symbols):]


def _label(axes: Axes, line: GridLine, taken: Floats) -> Floats:
    """Write a line's label at the first of its ends that is free; return what is taken now."""
    ends = np.array([path[i] for path in line.paths for i in (0, -1)])
    ends = (axes.transData + axes.transAxes.inverted()).transform(ends)
    for axis, side, offset, ha, va in _SIDES:
        for end in ends[np.abs(ends[:, axis] - side) < 1e-6]:
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
