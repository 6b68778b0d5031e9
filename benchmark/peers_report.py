"""What `peers_benchmark.py` writes: Markdown tables, a plot and the page of results."""

import datetime
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from peers import Entry
from star_tracker.study.scoring import Score
from star_tracker.maps.simulation import CORRECT_DEG

_PACKAGES = ("numpy", "scipy", "numba", "tetra3rs", "ruststartracker")
#: A shade of grey, a marker and a line for each contestant: told apart without colours.
_STYLES = (
    ("0.0", "o", "-"), ("0.6", "v", ":"), ("0.45", "s", "--"), ("0.25", "D", "-."),
    ("0.6", "^", "--"), ("0.35", "x", ":"), ("0.0", "*", "--"),
)
_LEGEND = (
    "Cells: correct % / wrong % / median ms / 95th percentile ms. Correct: the boresight is "
    f"within {CORRECT_DEG:g} deg of the true one, at any noise (at 3 px and more the right stars, "
    "if few, can give a wrong boresight); wrong: any other solution that was returned. Times: CPU "
    "time of the contestant's own call, from pixels to attitude, over all frames, solved or not. "
    "Bound: frames that show four true stars or more, %."
)


@dataclass(frozen=True)
class Row:
    """One condition seen by one camera.

    Attributes:
        camera: the camera's name.
        condition: the condition's full name.
        bound_percent: share of the frames that show at least four true stars.
        scores: the scores by the entries' names.
    """

    camera: str
    condition: str
    bound_percent: float
    scores: dict[str, Score]

    @property
    def short_condition(self) -> str:
        """The condition's short name."""
        return self.condition.split(":")[0]


def number(value: float) -> str:
    """Return a time or a ratio with three significant digits, or whole."""
    digits = 2 - int(np.floor(np.log10(value))) if value > 0 else 0
    return f"{value:.{max(0, digits)}f}"


def cell(score: Score) -> str:
    """Return correct % / wrong % / median ms / p95 ms."""
    return (
        f"{score.correct_percent:.1f} / {score.wrong_percent:.1f} / "
        f"{number(score.median_ms)} / {number(score.p95_ms)}"
    )


def ratio(row: Row, ours: Entry, peer: Entry) -> str:
    """Return our median time over the peer's, on the frames that the peer has seen."""
    our_ms = row.scores[ours.name].cpu_ms[:: peer.every]
    return number(float(np.median(our_ms)) / row.scores[peer.name].median_ms)


def markdown(head: list[str], body: list[list[str]]) -> str:
    """Return a Markdown table; all columns but the first are numbers."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, rule, *body])


def tables(rows: list[Row], entries: list[Entry]) -> str:
    """Return two Markdown tables for each camera: the scores, and the ratios of times."""
    parts = []
    for camera in dict.fromkeys(row.camera for row in rows):
        mine = [row for row in rows if row.camera == camera]
        heads = [f"{entry.name}<br>{mine[0].scores[entry.name].n} frames" for entry in entries]
        body = [
            [row.condition, f"{row.bound_percent:.1f}",
             *(cell(row.scores[entry.name]) for entry in entries)]
            for row in mine
        ]
        parts += [f"## {camera}", _LEGEND, markdown(["condition", "bound", *heads], body)]
        ours, *peers = entries
        if peers:
            body = [[row.condition, *(ratio(row, ours, peer) for peer in peers)] for row in mine]
            parts += [
                f"Median time of {ours.name} divided by the median time of the peer, on the "
                "frames that the peer has seen (below 1: the peer is slower):",
                markdown(["condition", *(peer.name for peer in peers)], body),
            ]
    return "\n\n".join(parts)


def processor() -> str:
    """Return the processor's name, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def version_of(package: str) -> str:
    """Return a package's name and version."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} not installed"


def versions() -> str:
    """Return the versions of Python and of the packages that matter."""
    return ", ".join([f"Python {platform.python_version()}", *map(version_of, _PACKAGES)])


def results_page(rows: list[Row], entries: list[Entry], seed: int) -> str:
    """Return the page of results: how it was measured, by whom, and the tables."""
    settings = "\n".join(f"- **{entry.name}**: {entry.settings}." for entry in entries)
    date = datetime.datetime.now(tz=datetime.timezone.utc).date()
    return f"""# star_tracker and its peers

Written by `python benchmark/peers_benchmark.py --write-results` on {date}.
{versions()}; {processor()}; one BLAS thread.

Random attitudes, seed {seed} for each condition; all databases are built of the same 4908 stars.
A true star's magnitude is the catalogue's with a noise of 0.1 mag, that of a false star is drawn
from the catalogue; without brightness means that a contestant is not told them.

{settings}

{tables(rows, entries)}
"""


def write_plot(rows: list[Row], entries: list[Entry], path: Path) -> None:
    """Draw correct % and median ms over the conditions. Raises ImportError without matplotlib."""
    import matplotlib as mpl  # noqa: PLC0415  only for the plot

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    cameras = list(dict.fromkeys(row.camera for row in rows))
    figure, axes = plt.subplots(
        2, len(cameras), squeeze=False, sharex="col", figsize=(7.5 * len(cameras), 8),
        layout="constrained",
    )
    for (above, below), camera in zip(axes.T, cameras, strict=True):
        mine = [row for row in rows if row.camera == camera]
        at = np.arange(len(mine))
        above.bar(at, [row.bound_percent for row in mine], color="0.93", label="bound")
        for entry, (shade, marker, line) in zip(entries, _STYLES, strict=False):
            scores = [row.scores[entry.name] for row in mine]
            style = {"color": shade, "marker": marker, "linestyle": line, "label": entry.name}
            above.plot(at, [score.correct_percent for score in scores], **style)
            below.plot(at, [score.median_ms for score in scores], **style)
        above.set(title=camera, ylabel="correct, %", ylim=(0, 103))
        below.set(ylabel="median CPU time, ms", yscale="log")
        below.set_xticks(at, [row.short_condition for row in mine], rotation=60)
        below.grid(axis="y", color="0.85")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=110)
    plt.close(figure)
