"""The picture of one frame: what was seen, what it was identified as, and what is missing.

The sky is drawn as the camera shows it. Where parity is mirrored the y axis points up, as the
star maps of the paper have it: east is then to the left of north, as everywhere on the sky.
"""

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from star_tracker.figures.field_labels import label_stars
from star_tracker.figures.field_symbols import Symbols
from star_tracker.figures.field_view import FieldView
from star_tracker.figures.grid_plot import draw_grid
from star_tracker.figures.side_panel import draw_side_panel
from star_tracker.figures.style import HALO, new_figure

#: Inches: the image's longer side, its margins, the column beside it; the smallest picture.
_LONG_SIDE, _LEFT, _BOTTOM, _TOP, _GAP, _SIDE = 6.0, 0.52, 0.42, 0.85, 0.5, 1.62
_NARROWEST, _LOWEST = 6.2, 3.9
#: Characters of the title to an inch.
_PER_INCH = 13.5
#: Percentiles of an image that become the lightest and the darkest grey, and how dark that is.
_STRETCH, _DARKEST = (25.0, 99.8), 0.6
#: Text is measured at this resolution.
_DPI = 144.0


def draw_field(view: FieldView, image: NDArray[Any] | None = None) -> Figure:
    """Return the figure of a frame, over its image (h, w) or (h, w, colours) where there is one.

    The image is drawn dark on light, as the symbols are.
    """
    width, height = view.camera.width_px, view.camera.height_px
    inch_per_px = _LONG_SIDE / max(width, height)
    wide, high = width * inch_per_px, height * inch_per_px
    size = max(_LEFT + wide + _GAP + _SIDE, _NARROWEST), max(_BOTTOM + high + _TOP, _LOWEST)
    figure = new_figure(*size, dpi=_DPI)
    low = size[1] - _TOP - high
    axes = figure.add_axes((_LEFT / size[0], low / size[1], wide / size[0], high / size[1]))
    if image is not None:
        _draw_image(axes, image)
    _prepare(axes, view)
    symbols = Symbols.of(view)
    taken = np.zeros((0, 4))
    if view.rotation is not None:
        taken = draw_grid(axes, view.optics, view.rotation, symbols.boxes(axes))
    symbols.draw(axes)
    label_stars(axes, symbols, taken)
    _write_title(figure, view)
    side = (_LEFT + wide + _GAP) / size[0]
    draw_side_panel(figure, (side, 1 - _TOP / size[1]), inch_per_px, symbols)
    return figure


def _draw_image(axes: Axes, image: NDArray[Any]) -> None:
    """Draw an image as a ground for symbols: light, with the faint things of the sky in it."""
    grey = np.asarray(image, float)
    grey = grey[..., :3].mean(axis=2) if grey.ndim == 3 else grey
    shown = grey[np.isfinite(grey)]
    low, high = np.percentile(shown, _STRETCH) if shown.size else (0.0, 1.0)
    part = np.clip((np.nan_to_num(grey) - low) / max(high - low, 1e-12), 0.0, 1.0)
    height, width = part.shape
    axes.imshow(
        1.0 - _DARKEST * part, cmap="gray", vmin=0.0, vmax=1.0, aspect="auto", zorder=-1,
        extent=(0, width, height, 0), interpolation="antialiased",
    )


def _prepare(axes: Axes, view: FieldView) -> None:
    """Give the axes the image's borders."""
    camera = view.optics
    up = camera.parity == "mirrored"
    axes.set(xlim=(0, camera.width_px))
    axes.set_ylim(*((0, camera.height_px) if up else (camera.height_px, 0)))
    axes.set_xlabel("x, px", labelpad=1)
    axes.set_ylabel("y, px", labelpad=1)
    axes.tick_params(labelsize=7, length=3)
    for axis in (axes.xaxis, axes.yaxis):  # above the arrows of stars at the border
        axis.set_zorder(7)
        for label in axis.get_ticklabels():
            label.set_path_effects(list(HALO))


def _write_title(figure: Figure, view: FieldView) -> None:
    """Write how the frame ended, in bold, and below it where the camera points."""
    wide, high = figure.get_size_inches()
    width = int((wide - _LEFT) * _PER_INCH)
    head = textwrap.wrap(f"{view.name}: {view.summary}", width, max_lines=3)
    for lines, above, weight in ((head, 0, "bold"), (_pose_and_field(view), len(head), "normal")):
        figure.text(
            _LEFT / wide, 1 - (0.09 + 0.16 * above) / high, "\n".join(lines), va="top",
            linespacing=1.4, fontsize=8, weight=weight,
        )


def _pose_and_field(view: FieldView) -> list[str]:
    solution, camera = view.solution, view.optics
    high_deg = np.degrees(2 * np.arctan(camera.height_px / 2 / camera.fy_px))
    field = (
        f"field {camera.fov_deg:.4g}° × {high_deg:.4g}°, "
        f"{camera.width_px} × {camera.height_px} px, parity {solution.parity or 'unknown'}"
    )
    boresight = view.boresight_deg
    if boresight is None:
        return [field]
    pose = "boresight α {:.4f}°, δ {:+.4f}°, roll {:.4f}°".format(*boresight).replace("-", "−")
    # A probability of 0 is one too small for a number.
    wrong = f"{solution.wrong_probability:.1g}" if solution.wrong_probability else "< 1e-300"
    return [
        f"{pose}; wrong with probability {wrong}",
        f"{field}; residuals {solution.rms_px:.3f} px rms",
    ]
