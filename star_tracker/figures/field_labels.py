"""The names beside the stars of a picture, placed so that they can be read."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Annotation

from star_tracker.figures.field_symbols import Symbols
from star_tracker.figures.field_view import FieldView
from star_tracker.figures.placement import place_labels
from star_tracker.figures.style import HALO, Looks, text_box
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import StarState

#: What the labels of stars are called among the artists of a figure.
STAR_LABEL = "star label"
#: Type size, points, for few and for many labels.
_FONT_PT, _SMALL_PT, _MANY = 7.0, 5.5, 70
#: Space between symbol and label, and around a label, points.
_GAP_PT, _PADDING_PT = 1.0, 0.7


def label_stars(axes: Axes, view: FieldView, symbols: Symbols, taken: Floats) -> None:
    """Write the names; boxes (k, 4) in display units are taken already.

    A label that finds no room is left out, not written over another; the picture says how many.
    """
    points, texts, gaps = _labels(view, symbols)
    if not texts:
        return
    labels = [
        _text(axes, point, text, _SMALL_PT if len(texts) > _MANY else _FONT_PT, style)
        for point, (text, style) in zip(points, texts, strict=True)
    ]
    per_pt = axes.figure.dpi / 72
    extents = np.array([text_box(label) for label in labels])
    sizes = extents[:, 2:] - extents[:, :2] + 2 * _PADDING_PT * per_pt
    obstacles = np.concatenate([symbols.boxes(axes), taken])
    display = axes.transData.transform(points)
    gaps = (gaps + _GAP_PT) * per_pt
    placed = place_labels(display, sizes, gaps, obstacles, np.array(axes.bbox.extents))
    for i, label in enumerate(labels):
        label.set_visible(bool(placed.shown[i]))
        x, y = (placed.centre[i] - display[i]) / per_pt
        label.set_position((x, y))
        if placed.shown[i] and placed.far[i]:
            ends = axes.transData.inverted().transform([display[i], placed.centre[i]])
            axes.plot(*ends.T, color="0.45", linewidth=0.6, zorder=2.5)
    left_out = int(np.sum(~placed.shown))
    if left_out:
        axes.annotate(
            f"{left_out} names left out for want of room", (1, 0), (0, -19), ha="right", va="top",
            xycoords="axes fraction", textcoords="offset points", fontsize=7,
        )


def _labels(
    view: FieldView, symbols: Symbols
) -> tuple[Floats, list[tuple[str, Looks]], Floats]:
    """Return places (k, 2), px, texts with their styles, and how far the symbols reach (k,)."""
    shown = view.drawn
    texts = [_name(view, int(i)) for i in shown]
    index, places = view.guide_stars
    discs = symbols.disc_pt(view.catalog.v_mag[index[view.missing]]) / 2
    faint: Looks = {"style": "italic", "color": "0.3"}
    texts += [(view.guide_star_name(int(guide)), faint) for guide in index[view.missing]]
    return (
        np.concatenate([view.xy_px[shown], places[view.missing]]), texts,
        np.concatenate([symbols.reach_pt(shown), discs]),
    )


def _name(view: FieldView, i: int) -> tuple[str, Looks]:
    """Return what to write beside a centroid, and how."""
    found = view.solution.identification
    state = StarState(found.state[i])
    if state is StarState.UNIDENTIFIED:
        return view.labels[i], {}
    text = f"{view.labels[i]}: {view.guide_star_name(int(found.catalog_index[i]))}"
    if state is StarState.IDENTIFIED:
        return text, {}
    return f"{text}\n{found.residual_px[i]:.1f} px off", {"weight": "bold"}


def _text(
    axes: Axes, point: Floats, text: str, size_pt: float, style: Looks
) -> Annotation:
    label = axes.annotate(
        text, (point[0], point[1]), (0, 0), textcoords="offset points", ha="center", va="center",
        fontsize=size_pt, zorder=6, linespacing=1.05, annotation_clip=False,
        path_effects=HALO, **style,
    )
    label.set_label(STAR_LABEL)
    return label
