"""The curves: rates and CPU time against each quantity, for each camera."""

import base64
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from PIL import Image  # matplotlib needs it, too

from star_tracker.figures.style import BLUE, VERMILION, house_style
from star_tracker.study.quantities import Quantity, Value
from star_tracker.study.records import Record
from star_tracker.study.tables import axis_of

#: Of Okabe and Ito's palette, too.
_GREEN, _PURPLE, _BLACK = "#009E73", "#CC79A7", "#000000"
#: Colour, marker, line and filling of the contestants in turn: all have a marker of their own, so
#: that grey prints can be read, too.
_STYLES = (
    (BLUE, "o", "-", BLUE), (BLUE, "s", "--", "white"), (VERMILION, "^", "-", VERMILION),
    (VERMILION, "D", ":", "white"), (_GREEN, "v", "-.", _GREEN), (_PURPLE, "P", "--", _PURPLE),
    (_BLACK, "X", "-", _BLACK), (_BLACK, "*", ":", "white"),
)
#: Any, as matplotlib's types for it differ from version to version.
_SETTINGS: Any = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "axes.grid.axis": "y", "grid.color": "0.88", "svg.fonttype": "path",
}
#: Markers at the same value stand side by side, so far apart as a fraction of the axis.
_DODGE = 0.012
#: Heights of the panels: identified, wrong, CPU time.
_HEIGHTS = (3, 1.4, 1.6)
#: The overview: sweeps side by side, colours of the file.
_COLUMNS, _COLOURS = 3, 64


def curves_svg(records: list[Record]) -> str:
    """Return a data URI with the rates of one sweep at one camera as an SVG picture."""
    with house_style(), mpl.rc_context(_SETTINGS):
        figure = Figure(figsize=(4.6, 5.4), layout="constrained")
        axes = figure.subplots(len(_HEIGHTS), 1, sharex=True, height_ratios=_HEIGHTS)
        _draw(axes, records)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        picture = BytesIO()
        figure.savefig(picture, format="svg", metadata={"Date": None, "Creator": None})
    return "data:image/svg+xml;base64," + base64.b64encode(picture.getvalue()).decode("ascii")


def write_overview(curves: Sequence[list[Record]], path: Path) -> None:
    """Write several curves, each of one sweep at one camera, as one PNG picture."""
    n_rows, n_panels = -(-len(curves) // _COLUMNS), len(_HEIGHTS)
    with house_style(), mpl.rc_context(_SETTINGS):
        figure = Figure(figsize=(3.3 * _COLUMNS, 3.6 * n_rows), layout="constrained")
        grid = figure.subplots(
            n_panels * n_rows, _COLUMNS, squeeze=False, height_ratios=_HEIGHTS * n_rows
        )
        for at in range(n_rows * _COLUMNS):
            row, column = divmod(at, _COLUMNS)
            axes = grid[n_panels * row : n_panels * (row + 1), column]
            if at < len(curves):
                first = _draw(axes, curves[at])
                axes[0].set_title(f"{axis_of(first.sweep).title}, {first.camera}")
                for ax in axes[:-1]:
                    ax.tick_params(labelbottom=False)
            else:
                for ax in axes:
                    ax.set_axis_off()
        handles = grid[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper center", ncols=4)
        picture = BytesIO()
        figure.savefig(picture, format="png", dpi=100)
    # So few colours need a palette only: a quarter of the size.
    Image.open(picture).convert("RGB").quantize(_COLOURS).save(path, optimize=True)


def _draw(axes: Any, records: list[Record]) -> Record:
    """Draw one sweep at one camera: identified, wrong, CPU time; return its first record."""
    above, below, times = axes
    quantity = axis_of(records[0].sweep)
    place = _places(list(dict.fromkeys(record.value for record in records)), quantity)
    apart = _DODGE * (max(place.values()) - min(place.values()) or 1.0)
    names = list(dict.fromkeys(record.contestant for record in records))
    for i, name in enumerate(names):
        mine = [record for record in records if record.contestant == name]
        at = [place[record.value] + (i - (len(names) - 1) / 2) * apart for record in mine]
        colour, marker, line, filling = _STYLES[i % len(_STYLES)]
        looks: Any = {
            "color": colour, "marker": marker, "markersize": 5, "markerfacecolor": filling,
            "linewidth": 1.2, "label": name,
            "linestyle": "none" if isinstance(mine[0].value, str) else line,
        }
        for ax, rate in ((above, "identified"), (below, "wrong")):
            ax.errorbar(at, *_with_bounds(mine, rate), elinewidth=0.9, capsize=0, **looks)
        times.plot(at, [record.median_cpu_ms for record in mine], **looks)
    above.set(ylabel="identified, %", ylim=(-3, 103))
    most = max(record.wrong_high_percent for record in records)
    below.set(ylabel="wrong, %", ylim=(-0.04 * most, 1.05 * most))
    times.set(ylabel="CPU, ms", yscale="log", xlabel=quantity.axis)
    for ax in axes:
        ax.set_xticks(list(place.values()), [quantity.tick(value) for value in place])
    return records[0]


def _with_bounds(records: list[Record], rate: str) -> tuple[list[float], list[list[float]]]:
    """Return a rate and how far its 95 % interval reaches below and above."""
    middle, low, high = (
        [getattr(record, f"{rate}{bound}_percent") for record in records]
        for bound in ("", "_low", "_high")
    )
    return middle, [
        [m - lo for m, lo in zip(middle, low, strict=True)],
        [hi - m for m, hi in zip(middle, high, strict=True)],
    ]


def _places(values: list[Value], quantity: Quantity) -> dict[Value, float]:
    """Return where values stand on the axis: numbers to scale, then words side by side."""
    numbers = [value * quantity.scale for value in values if not isinstance(value, str)]
    step = (max(numbers) - min(numbers)) / max(len(numbers) - 1, 1) if numbers else 1.0
    place, word_at = {}, max(numbers, default=-1.0)
    for value in values:
        if isinstance(value, str):
            word_at += step or 1.0
        place[value] = word_at if isinstance(value, str) else value * quantity.scale
    return place


def alternative(records: list[Record]) -> str:
    """Return in words what the curves of one sweep at one camera show."""
    quantity = axis_of(records[0].sweep)
    parts = []
    for name in dict.fromkeys(record.contestant for record in records):
        mine = [record for record in records if record.contestant == name]
        rates = ", ".join(f"{quantity.tick(r.value)}: {r.identified_percent:.3g}" for r in mine)
        most = max(r.wrong_percent for r in mine)
        parts.append(f"{name} identifies (%) {rates}, and is wrong in at most {most:.2g} %")
    return (
        f"{quantity.title} at {records[0].camera}, rates against {quantity.axis}: "
        + "; ".join(parts) + "."
    )
