"""What stands beside the picture of a frame: legend, north and east, scales."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from star_tracker.figures.field_symbols import (
    BORESIGHT,
    CROSS,
    DIAMOND,
    GUIDE,
    MISSING,
    RING,
    Symbols,
    round_down,
)
from star_tracker.figures.field_view import FieldView
from star_tracker.figures.style import VERMILION, Looks
from star_tracker.geometry.spherical import Floats, tangent_basis
from star_tracker.identification.labels import StarState

#: Inches: size of the panel, where its drawings lie, length of the arrows north and east.
_WIDTH, _HEIGHT = 1.55, 1.75
_COMPASS, _ARROW = (0.75, 1.1), 0.42
_RESIDUAL_Y, _SCALE_Y, _BAR = 0.42, 0.12, 0.75


def draw_side_panel(
    figure: Figure, top_left: tuple[float, float], inch_per_px: float, view: FieldView,
    symbols: Symbols,
) -> None:
    """Draw the panel below a place, in fractions of the figure; it is as large as it needs."""
    figure.legend(
        handles=list(_handles(view, symbols)), loc="upper left", bbox_to_anchor=top_left,
        borderaxespad=0, fontsize=7, frameon=False, handletextpad=0.5, labelspacing=0.75,
    )
    if view.rotation is None:
        return
    wide, high = figure.get_size_inches()
    panel = figure.add_axes((top_left[0], 0.3 / high, _WIDTH / wide, _HEIGHT / high))
    panel.set_xlim(0, _WIDTH)
    panel.set_ylim(0, _HEIGHT)
    panel.axis("off")
    _draw_compass(panel, view.rotation)
    _draw_scales(panel, inch_per_px, view, symbols)


def _handles(view: FieldView, symbols: Symbols) -> Iterator[Line2D]:
    """Yield what the legend shows: only what the picture does."""
    for state, name, style in (
        (StarState.IDENTIFIED, "identified", RING), (StarState.DISPLACED, "displaced", DIAMOND),
        (StarState.UNIDENTIFIED, "unidentified", CROSS),
    ):
        n = len(view.of_state(state))
        if n:
            yield _handle(symbols.scaled(style), f"{name} ({n})")
        if n and state is StarState.DISPLACED:
            yield Line2D([], [], color=VERMILION, marker=">", markersize=4, linewidth=1.2,
                         label="should be → was seen")
    if view.rotation is None:
        return
    n = int(view.missing.sum())
    if n:
        yield _handle(MISSING | {"markersize": 5.0 * symbols.size}, f"guide star missing ({n})")
    faintest = int(np.floor(np.max(view.catalog.v_mag)))
    for v in range(faintest - 4, faintest + 1, 2):
        size = float(symbols.disc_pt(np.array([v]))[0])
        yield _handle(GUIDE | {"markersize": size}, f"guide star, V = {v}")
    yield _handle(BORESIGHT, "principal point")


def _handle(style: Looks, label: str) -> Line2D:
    return Line2D([], [], label=label, **style)


def _draw_compass(panel: Axes, rotation: Floats) -> None:
    """Draw arrows to north and east as they are at the boresight."""
    east, north = tangent_basis(rotation[:, 2])
    for name, direction in (("N", north), ("E", east)):
        # Upwards in the picture is -y of the camera, of either parity.
        along = (rotation.T @ direction)[:2] * (1, -1)
        tip = _COMPASS + _ARROW * along
        panel.annotate(
            "", tuple(tip), _COMPASS,
            arrowprops={"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0},
        )
        x, y = _COMPASS + (_ARROW + 0.12) * along
        panel.text(x, y, name, ha="center", va="center")


def _draw_scales(
    panel: Axes, inch_per_px: float, view: FieldView, symbols: Symbols
) -> None:
    """Draw a residual of round length as exaggerated as those of the stars, and an angle."""
    if symbols.residual_scale > 0:
        exaggerated = inch_per_px * symbols.residual_scale
        residual = round_down(_BAR / exaggerated)
        panel.annotate(
            "", (residual * exaggerated, _RESIDUAL_Y), (0, _RESIDUAL_Y),
            arrowprops={"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0},
        )
        text = f"residual of {residual:g} px, × {symbols.residual_scale:g}"
        panel.text(0, _RESIDUAL_Y - 0.1, text, va="center", fontsize=7)
    inch_per_deg = inch_per_px * view.optics.focal_length_px * np.radians(1)
    angle = round_down(_BAR / inch_per_deg)
    panel.plot([0, angle * inch_per_deg], [_SCALE_Y] * 2, "k|-", linewidth=1, clip_on=False)
    panel.text(0, _SCALE_Y - 0.11, f"{angle:g}° at the boresight", va="center", fontsize=7)
