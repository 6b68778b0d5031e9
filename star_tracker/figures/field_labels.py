"""The names beside the stars of a picture, placed so that they can be read."""

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation

from star_tracker.figures.field_symbols import Symbols
from star_tracker.figures.field_view import FieldView
from star_tracker.figures.placement import place_labels
from star_tracker.labels import StarState
from star_tracker.spherical import Floats

#: What the labels of stars are called among the artists of a figure.
STAR_LABEL = "star label"
#: Type size, points, for few and for many labels.
_FONT_PT, _SMALL_PT, _MANY = 7.0, 5.5, 70
#: Space between symbol and label, and around a label, points.
_GAP_PT, _PADDING_PT = 1.0, 0.7


def label_stars(axes: Axes, view: FieldView, symbols: Symbols, taken: Floats) -> None:
    """Write the names; boxes (k, 4) in display units are taken already.

    A label that finds no room is left out, not written over another.
    """
    points, texts, gaps = _labels(view, symbols)
    if not texts:
        return
    small = len(texts) > _MANY
    labels = [
        _text(axes, tuple(point), text, _SMALL_PT if small else _FONT_PT, style)
        for point, (text, style) in zip(points, texts, strict=True)
    ]
    canvas = axes.figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    per_pt = axes.figure.dpi / 72
    renderer = canvas.get_renderer()
    extents = [label.get_window_extent(renderer) for label in labels]
    sizes = np.array([(box.width, box.height) for box in extents]) + 2 * _PADDING_PT * per_pt
    covered, half = symbols.covered_px()
    at, half = axes.transData.transform(covered), half[:, None] * per_pt
    obstacles = np.concatenate([np.hstack([at - half, at + half]), taken])
    display = axes.transData.transform(points)
    gaps = (gaps + _GAP_PT) * per_pt
    placed = place_labels(display, sizes, gaps, obstacles, np.array(axes.bbox.extents))
    for i, label in enumerate(labels):
        label.set_visible(bool(placed.shown[i]))
        label.set_position(tuple((placed.centre[i] - display[i]) / per_pt))
        if placed.shown[i] and placed.far[i]:
            ends = axes.transData.inverted().transform([display[i], placed.centre[i]])
            axes.plot(*ends.T, color="0.45", linewidth=0.6, zorder=2.5)


def _labels(
    view: FieldView, symbols: Symbols
) -> tuple[Floats, list[tuple[str, dict[str, object]]], Floats]:
    """Return places (k, 2), px, texts with their styles, and how far the symbols reach (k,)."""
    found = view.solution.identification
    texts: list[tuple[str, dict[str, object]]] = []
    for i, label in enumerate(view.labels):
        state = StarState(found.state[i])
        if state is StarState.UNIDENTIFIED:
            texts.append((label, {}))
            continue
        text = f"{label}: {view.guide_star_name(int(found.catalog_index[i]))}"
        if state is StarState.DISPLACED:
            text += f"\n{found.residual_px[i]:.1f} px off"
        texts.append((text, {"weight": "bold"} if state is StarState.DISPLACED else {}))
    index, places = view.guide_stars
    discs = symbols.disc_pt(view.catalog.v_mag[index[view.missing]]) / 2
    for guide in index[view.missing]:
        texts.append((view.guide_star_name(int(guide)), {"style": "italic", "color": "0.3"}))
    return (
        np.concatenate([view.xy_px, places[view.missing]]), texts,
        np.concatenate([symbols.reach_pt(), discs]),
    )


def _text(
    axes: Axes, point: tuple[float, ...], text: str, size_pt: float, style: dict[str, object]
) -> Annotation:
    label = axes.annotate(
        text, point, (0, 0), textcoords="offset points", ha="center", va="center",
        fontsize=size_pt, zorder=6, linespacing=1.05, annotation_clip=True,
        path_effects=[patheffects.withStroke(linewidth=1.8, foreground="white")], **style,
    )
    label.set_label(STAR_LABEL)
    return label
