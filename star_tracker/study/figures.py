"""The curves: rates against each quantity, for each camera."""

import base64
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image  # matplotlib needs it, too

from star_tracker.study.records import Record
from star_tracker.study.troubles import QUANTITIES, Quantity

#: Colour (Okabe and Ito's, told apart by colour-blind eyes), marker, line and filling: all have a
#: marker of their own, so that grey prints can be read, too.
_STYLES = {
    "match_group": ("#0072B2", "o", "-", "#0072B2"),
    "match_group, paper": ("#0072B2", "s", "--", "white"),
    "radial_cyclic": ("#D55E00", "^", "-", "#D55E00"),
    "radial_cyclic, paper": ("#D55E00", "D", ":", "white"),
    "auto": ("#000000", "v", "-.", "#000000"),
}
#: Any, as matplotlib's types for it differ from version to version.
_SETTINGS: Any = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "axes.grid.axis": "y", "grid.color": "0.88", "svg.fonttype": "path",
    "svg.hashsalt": "star_tracker",
}
#: Markers at the same value stand side by side, so far apart as a fraction of the axis.
_DODGE = 0.012
#: The overview: sweeps side by side, colours of the file.
_COLUMNS, _COLOURS = 3, 64


def curves_svg(records: list[Record]) -> str:
    """Return a data URI with the rates of one sweep at one camera as an SVG picture."""
    with mpl.rc_context(_SETTINGS):
        figure = Figure(figsize=(4.6, 4.4), layout="constrained")
        axes = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.4))
        _draw(axes, records)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        picture = BytesIO()
        figure.savefig(picture, format="svg", metadata={"Date": None, "Creator": None})
    return "data:image/svg+xml;base64," + base64.b64encode(picture.getvalue()).decode("ascii")


def write_overview(records: list[Record], path: Path) -> None:
    """Write the rates of all numeric sweeps and cameras as one PNG picture."""
    panels: dict[str, dict[str, list[Record]]] = {}
    for record in records:
        if record.sweep in QUANTITIES and not isinstance(record.value, str):
            panels.setdefault(record.sweep, {}).setdefault(record.camera, []).append(record)
    sweeps, cameras = list(panels), list(next(iter(panels.values())))
    # Below each row of sweeps at one camera the same sweeps at the next.
    rows = [
        [panels[sweep][camera] for sweep in sweeps[first : first + _COLUMNS]]
        for first in range(0, len(sweeps), _COLUMNS) for camera in cameras
    ]
    with mpl.rc_context(_SETTINGS):
        figure = Figure(figsize=(3.3 * _COLUMNS, 2.9 * len(rows)), layout="constrained")
        grid = figure.subplots(
            2 * len(rows), _COLUMNS, squeeze=False, height_ratios=(3, 1.4) * len(rows)
        )
        for at, row in enumerate(rows):
            for column, pair in enumerate(grid[2 * at : 2 * at + 2].T):
                if column < len(row):
                    _draw(pair, row[column])
                    title = f"{QUANTITIES[row[column][0].sweep].title}, {row[column][0].camera}"
                    pair[0].set_title(title, fontsize="medium")
                    pair[0].tick_params(labelbottom=False)
                else:
                    for ax in pair:
                        ax.set_axis_off()
        handles = grid[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper center", ncols=4)
        picture = BytesIO()
        figure.savefig(picture, format="png", dpi=100)
    # So few colours need a palette only: a quarter of the size.
    Image.open(picture).convert("RGB").quantize(_COLOURS).save(path, optimize=True)


def _draw(axes: Iterable[Axes], records: list[Record]) -> None:
    """Draw the rates of one sweep at one camera: identified above, wrong below."""
    above, below = axes
    quantity = QUANTITIES[records[0].sweep]
    values = list(dict.fromkeys(record.value for record in records))
    places = _places(values, quantity)
    apart = _DODGE * (max(places) - min(places) or 1.0)
    by_name: dict[str, list[Record]] = {}
    for record in records:
        by_name.setdefault(record.contestant.name, []).append(record)
    for i, mine in enumerate(by_name.values()):
        at = [place + (i - (len(by_name) - 1) / 2) * apart for place in places]
        for ax, rate in ((above, "identified"), (below, "wrong")):
            _draw_rate(ax, at, mine, rate, joined=not isinstance(values[0], str))
    above.set(ylabel="identified, %", ylim=(-3, 103))
    most = max(record.wrong_high_percent for record in records)
    below.set(ylabel="wrong, %", ylim=(-0.04 * most, 1.05 * most), xlabel=quantity.axis)
    for ax in (above, below):
        ax.set_xticks(places, [_tick(quantity.shown(value)) for value in values])


def _draw_rate(ax: Axes, at: list[float], records: list[Record], rate: str, joined: bool) -> None:
    """Draw one rate of one contestant with its 95 % interval."""
    name = records[0].contestant.name
    colour, marker, line, filling = _STYLES[name]
    middle, low, high = (
        [getattr(record, f"{rate}{bound}_percent") for record in records]
        for bound in ("", "_low", "_high")
    )
    ax.errorbar(
        at, middle,
        yerr=[
            [m - lo for m, lo in zip(middle, low, strict=True)],
            [hi - m for m, hi in zip(middle, high, strict=True)],
        ],
        color=colour, marker=marker, linestyle=line if joined else "none", markersize=5,
        markerfacecolor=filling, linewidth=1.2, elinewidth=0.9, capsize=0, label=name,
    )


def _places(values: list[float | str], quantity: Quantity) -> list[float]:
    """Return where values stand on the axis: numbers to scale, words side by side."""
    return [
        float(i) if isinstance(value, str) else float(quantity.shown(value))
        for i, value in enumerate(values)
    ]


def _tick(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def alternative(records: list[Record]) -> str:
    """Return in words what the curves of one sweep at one camera show."""
    first = records[0]
    quantity = QUANTITIES[first.sweep]
    parts = []
    for name in dict.fromkeys(record.contestant.name for record in records):
        mine = [record for record in records if record.contestant.name == name]
        rates = ", ".join(
            f"{_tick(quantity.shown(r.value))}: {r.identified_percent:.3g}" for r in mine
        )
        most = max(r.wrong_percent for r in mine)
        parts.append(f"{name} identifies (%) {rates}, and is wrong in at most {most:.2g} %")
    return (
        f"{quantity.title} at {first.camera}, rates against {quantity.axis}: "
        + "; ".join(parts) + "."
    )

