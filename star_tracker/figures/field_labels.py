"""The names beside the stars of a picture, placed so that they can be read."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Annotation

from star_tracker.figures.field_symbols import Symbols
from star_tracker.figures.placement import Placed, place_labels
from star_tracker.figures.style import HALO, Looks, text_box
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import StarState

#: What the labels of stars are called among the artists of a figure.
STAR_LABEL = "star label"
#: Type size, points, for few and for many labels.
_FONT_PT, _SMALL_PT, _MANY = 7.0, 5.5, 70
#: Space between symbol and label, and around a label, points.
_GAP_PT, _PADDING_PT = 1.0, 0.7
_GUIDE: Looks = {"style": "italic", "color": "0.3"}


def label_stars(axes: Axes, symbols: Symbols, taken: Floats) -> None:
    """Write the names; boxes (k, 4) in display units are taken already.

    A label that finds no room is left out, not written over another; the picture says how many.
    """
    view = symbols.view
    index, places = view.guide_stars
    index, places = index[view.missing], places[view.missing]
    texts = [_name(symbols, int(i)) for i in view.drawn]
    texts += [(view.guide_star_name(int(guide)), _GUIDE) for guide in index]
    points = np.concatenate([view.xy_px[view.drawn], places])
    reach = np.concatenate([
        symbols.reach_pt(view.drawn), symbols.disc_pt(view.catalog.v_mag[index]) / 2
    ])
    size_pt = _SMALL_PT if len(texts) > _MANY else _FONT_PT
    common: Looks = {
        "fontsize": size_pt, "zorder": 6, "linespacing": 1.05, "path_effects": HALO,
        "label": STAR_LABEL,
    }
    labels = [
        annotation(axes, point, text, common | looks)
        for point, (text, looks) in zip(points, texts, strict=True)
    ]
    obstacles = np.concatenate([symbols.boxes(axes), taken])
    placed = put_labels(axes, labels, reach + _GAP_PT, obstacles)
    for i in np.flatnonzero(placed.shown & placed.far):
        ends = axes.transData.inverted().transform(placed.centre[i])
        axes.plot(*zip(points[i], ends, strict=True), color="0.45", linewidth=0.6, zorder=2.5)
    left_out = int(np.sum(~placed.shown))
    if left_out:
        axes.annotate(
            f"{left_out} names left out: there is no room", (1, 0), (0, -19), ha="right", va="top",
            xycoords="axes fraction", textcoords="offset points", fontsize=7,
        )


def annotation(axes: Axes, point: Floats, text: str, looks: Looks) -> Annotation:
    """Return a label for a point (2,) of the axes, to be placed by `put_labels`."""
    return axes.annotate(
        text, (point[0], point[1]), (0, 0), textcoords="offset points", ha="center", va="center",
        annotation_clip=False, **looks,
    )


def put_labels(
    axes: Axes, labels: Sequence[Annotation], gaps_pt: Floats, obstacles: Floats
) -> Placed:
    """Move labels beside their points, at least `gaps_pt` (n,) away; hide those without room.

    Returns where they are, as `obstacles` (m, 4), boxes, are given: in display units.
    """
    per_pt = axes.figure.dpi / 72
    points = np.array([label.xy for label in labels], float).reshape(-1, 2)
    extents = np.array([text_box(label) for label in labels]).reshape(-1, 4)
    sizes = extents[:, 2:] - extents[:, :2] + 2 * _PADDING_PT * per_pt
    display = axes.transData.transform(points)
    placed = place_labels(display, sizes, gaps_pt * per_pt, obstacles, np.array(axes.bbox.extents))
    for label, shown, offset in zip(labels, placed.shown, placed.centre - display, strict=True):
        label.set_visible(bool(shown))
        label.set_position(tuple(offset / per_pt))
    return placed


def _name(symbols: Symbols, i: int) -> tuple[str, Looks]:
    """Return what to write beside a centroid, and how."""
    view = symbols.view
    found = view.solution.identification
    state = StarState(found.state[i])
    if state is StarState.UNIDENTIFIED:
        return view.labels[i], {}
    text = f"{view.labels[i]}: {view.guide_star_name(int(found.catalog_index[i]))}"
    if state is StarState.IDENTIFIED:
        return text, {}
    return f"{text}\n{found.residual_px[i]:.1f} px off", {"weight": "bold"}
