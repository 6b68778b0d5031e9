"""What stands beside the picture of a frame: legend, north and east, scales."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from star_tracker.figures.field_symbols import (
    BORESIGHT,
    CENTROIDS,
    GUIDE,
    MISSING,
    Symbols,
    round_down,
)
from star_tracker.figures.style import VERMILION
from star_tracker.geometry.spherical import tangent_basis
from star_tracker.identification.labels import StarState

#: Inches: size of the panel, where its drawings lie, length of the arrows north and east.
_WIDTH, _HEIGHT = 1.55, 1.75
_COMPASS, _ARROW = np.array([0.75, 1.1]), 0.42
_RESIDUAL_Y, _SCALE_Y, _BAR = 0.42, 0.12, 0.75


def draw_side_panel(
    figure: Figure, top_left: tuple[float, float], inch_per_px: float, symbols: Symbols
) -> None:
    """Draw the panel below a place, in fractions of the figure; it is as large as it needs."""
    figure.legend(
        handles=list(_handles(symbols)), loc="upper left", bbox_to_anchor=top_left,
        borderaxespad=0, fontsize=7, frameon=False, handletextpad=0.5, labelspacing=0.75,
    )
    rotation = symbols.view.rotation
    if rotation is None:
        return
    wide, high = figure.get_size_inches()
    panel = figure.add_axes((top_left[0], 0.3 / high, _WIDTH / wide, _HEIGHT / high))
    panel.set(xlim=(0, _WIDTH), ylim=(0, _HEIGHT))
    panel.axis("off")
    for name, direction in zip("EN", tangent_basis(rotation[:, 2]), strict=True):
        # Upwards in the picture is -y of the camera, of either parity.
        along = (rotation.T @ direction)[:2] * (1, -1)
        _draw_arrow(panel, *_COMPASS, *(_COMPASS + _ARROW * along))
        x, y = _COMPASS + (_ARROW + 0.12) * along
        panel.text(x, y, name, ha="center", va="center")
    _draw_scales(panel, inch_per_px, symbols)


def _handles(symbols: Symbols) -> Iterator[Line2D]:
    """Yield what the legend shows: only what the picture does."""
    view = symbols.view
    for state, looks in CENTROIDS.items():
        n = len(view.of_state(state))
        if n:
            yield Line2D([], [], label=f"{state.name.lower()} ({n})", **symbols.scaled(looks))
        if n and state is StarState.DISPLACED:
            yield Line2D([], [], color=VERMILION, marker=">", markersize=4, linewidth=1.2,
                         label="should be → was seen")
    if view.rotation is None:
        return
    n = int(view.missing.sum())
    if n:
        looks = MISSING | {"markersize": 5.0 * symbols.size}
        yield Line2D([], [], label=f"guide star missing ({n})", **looks)
    faintest = int(np.floor(np.max(view.catalog.v_mag)))
    for v in range(faintest - 4, faintest + 1, 2):
        looks = GUIDE | {"markersize": float(symbols.disc_pt(np.array([v]))[0])}
        yield Line2D([], [], label=f"guide star, V = {v}", **looks)
    yield Line2D([], [], label="principal point", **BORESIGHT)


def _draw_arrow(panel: Axes, x: float, y: float, to_x: float, to_y: float) -> None:
    panel.annotate(
        "", (to_x, to_y), (x, y),
        arrowprops={"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0},
    )


def _draw_scales(panel: Axes, inch_per_px: float, symbols: Symbols) -> None:
    """Draw a residual of round length as exaggerated as those of the stars, and an angle."""
    if symbols.residual_scale > 0:
        exaggerated = inch_per_px * symbols.residual_scale
        residual = round_down(_BAR / exaggerated)
        _draw_arrow(panel, 0, _RESIDUAL_Y, residual * exaggerated, _RESIDUAL_Y)
        text = f"residual of {residual:g} px, × {symbols.residual_scale:g}"
        panel.text(0, _RESIDUAL_Y - 0.1, text, va="center", fontsize=7)
    inch_per_deg = inch_per_px * symbols.view.optics.focal_length_px * np.radians(1)
    angle = round_down(_BAR / inch_per_deg)
    panel.plot([0, angle * inch_per_deg], [_SCALE_Y] * 2, "k|-", linewidth=1, clip_on=False)
    panel.text(0, _SCALE_Y - 0.11, f"{angle:g}° at the boresight", va="center", fontsize=7)
