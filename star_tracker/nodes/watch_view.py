"""What `star_tracker watch` shows of a node, as rich renderables. No ROS here.

Below `WIDE` columns the stars stand under the rest, from there on beside it; 80 columns are enough.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table
from rich.text import Text

from star_tracker.labels import StarState
from star_tracker.nodes.watch_model import SILENT_S, Frame, Pose, Report, Watched, state_name

#: From this many columns on there is room for two parts side by side; that of the left one.
WIDE, _LEFT = 112, 54
#: A frame older than that is missed, s.
_FRESH_S = 1.0
_LEVEL_STYLES = {"OK": "green", "WARN": "yellow", "ERROR": "red", "STALE": "red"}
_STAR_COLUMNS = ("star", "x px", "y px", "RA deg", "Dec deg", "V", "res px", "state")
_ABSENT = "-"


class View:
    """The view of a node at one moment; it takes the width that there is.

    Args:
        watched: the node.
        now_s: the moment.
        n_stars: how many stars to list at most; fewer where the terminal is low.
    """

    def __init__(self, watched: Watched, now_s: float, n_stars: int) -> None:
        self._watched, self._now_s, self._n_stars = watched, now_s, n_stars

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Yield the parts, as rich asks for them."""
        yield heading(self._watched, self._now_s)
        facts = _facts(self._watched, self._now_s)
        wide = options.max_width >= WIDE
        used = 1 if wide else 1 + len(console.render_lines(facts, options.update(height=None)))
        n = self._n_stars
        if options.height is not None:  # of a whole screen; head and tail of the table take two
            n = max(0, min(n, options.height - used - 2))
        stars = stars_table(self._watched.frame, n)
        if not wide:
            yield facts
            yield stars
            return
        both = Table.grid(padding=(0, 3, 0, 0))
        both.add_column(width=_LEFT)
        both.add_column()
        both.add_row(facts, stars)
        yield both


def heading(watched: Watched, now_s: float) -> RenderableType:
    """Return the line that names the node and says how fresh all of it is."""
    line = Table.grid(expand=True)
    line.add_column()
    line.add_column(justify="right")
    line.add_row(Text(watched.full_name, "bold"), _freshness(watched, now_s))
    return line


def stars_table(frame: Frame | None, n_stars: int) -> RenderableType:
    """Return the recognised stars of a frame, the brightest first, `n_stars` at most."""
    if frame is None or frame.stars is None:
        return Text("no stars heard", "dim")
    stars = frame.stars[frame.stars["state"] != StarState.UNIDENTIFIED]
    if not len(stars):
        return Text("no star identified", "dim")
    table = Table(box=None, padding=(0, 1), pad_edge=False, header_style="bold")
    for heading_ in _STAR_COLUMNS:
        justify = "left" if heading_ in ("star", "state") else "right"
        table.add_column(heading_, justify=justify, no_wrap=True)
    shown = stars[np.argsort(stars["magnitude"], kind="stable")][:n_stars]
    for star in shown:
        table.add_row(*_star_cells(star))
    left = len(stars) - len(shown)
    if left:
        table.add_row(Text(f"{left} more", "dim"))
    return table


def star_name(star: np.void) -> str:
    """Return the Hipparcos number where a star has one, else its number in the catalogue."""
    return f"HIP {star['hip']}" if star["hip"] else f"star {star['star_number']}"


def _star_cells(star: np.void) -> tuple[str, ...]:
    return (
        star_name(star), f"{star['x']:.2f}", f"{star['y']:.2f}", f"{star['ra_deg']:.4f}",
        f"{star['dec_deg']:+.4f}", f"{star['magnitude']:.2f}", f"{star['residual_px']:.3f}",
        state_name(star),
    )


def _freshness(watched: Watched, now_s: float) -> Text:
    if watched.frame is None:
        return Text("no frame yet", "yellow")
    age_s = now_s - watched.frame_s
    if age_s < _FRESH_S:
        return Text(f"last frame {age_s:.1f} s ago", "green")
    return Text(f"no frame for {age_s:.1f} s", "red" if age_s > SILENT_S else "yellow")


def _facts(watched: Watched, now_s: float) -> Table:
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(style="cyan", no_wrap=True)
    grid.add_column()
    rows = [
        *_attitude_rows(watched, now_s), *_frame_rows(watched.frame),
        *_health_rows(watched, now_s),
    ]
    if watched.trouble:
        rows.append(("not readable", Text(watched.trouble, "red")))
    for label, value in rows:
        grid.add_row(label, value)
    return grid


Rows = Iterator[tuple[str, RenderableType]]


def _attitude_rows(watched: Watched, now_s: float) -> Rows:
    pose = watched.pose
    if pose is None:
        yield "attitude", Text("none yet", "dim")
        return
    ra, dec, roll = pose.boresight_deg
    yield "RA, Dec, roll", Text(f"{ra:.4f}, {dec:+.4f}, {roll:.4f} deg", "bold")
    x, y, z = pose.sigma_arcsec
    yield "1 sigma x, y, z", f"{x:.2f}, {y:.2f}, {z:.2f} arcsec, camera axes"
    for names, values in zip(("x, y", "z, w"), _halves(pose), strict=True):
        yield f"quaternion {names}", values
    frame = watched.frame
    if frame is not None and frame.pose is None:
        yield "", Text(f"of {now_s - watched.pose_s:.1f} s ago", "yellow")


def _halves(pose: Pose) -> tuple[str, str]:
    x, y, z, w = pose.quaternion_xyzw
    return f"{x:+.8f}, {y:+.8f}", f"{z:+.8f}, {w:+.8f}"


def _frame_rows(frame: Frame | None) -> Rows:
    if frame is None:
        return
    values = {key: value or _ABSENT for key, value in frame.values.items()}
    style = {"SOLVED": "green", "BAD_INPUT": "red"}.get(frame.status, "yellow")
    yield "status", Text(frame.status, style)
    yield "reason", _value(values, "reason")
    if values.get("hint", _ABSENT) != _ABSENT:
        yield "hint", Text(values["hint"], "yellow")
    yield "stars", (
        f"{_value(values, 'matched')} of {_value(values, 'total')} identified, "
        f"{_value(values, 'displaced')} displaced, {_value(values, 'ignored')} ignored"
    )
    if frame.status == "SOLVED":
        yield "found by", ", ".join(_value(values, key) for key in ("method", "mode", "parity"))
        yield "fit", (
            f"rms {_value(values, 'rms_px')} px, wrong with p {_value(values, 'wrong_probability')}"
        )
    yield "solve time", f"{_value(values, 'solve_ms')} ms"


def _health_rows(watched: Watched, now_s: float) -> Rows:
    report = watched.health
    if report is None:
        yield "diagnostics", Text("no report heard yet", "yellow")
        return
    yield "diagnostics", _level(report, now_s - watched.health_s)
    v = report.values
    yield "rates", (
        f"{_value(v, 'frames_per_s')} frames/s, {_value(v, 'solved_per_s')} solved/s, "
        f"ratio {_value(v, 'solve_ratio')}"
    )
    latencies = ", ".join(_value(v, f"latency_{which}_ms") for which in ("p50", "p95", "max"))
    yield "latency", f"p50, p95, max {latencies} ms"
    yield "input age", f"{_value(v, 'input_age_s')} s"
    yield "counts", (
        f"{_value(v, 'frames')} frames, {_value(v, 'solved')} solved, "
        f"{_value(v, 'dropped')} dropped"
    )
    rejects = rejected(v)
    yield "rejected", ", ".join(f"{n} {kind}" for kind, n in rejects.items()) or "none"
    focal_length = watched.focal_length
    yield "focal length", "not followed" if focal_length is None else focal_length.message


def rejected(values: Mapping[str, str]) -> dict[str, str]:
    """Return how often what was rejected, by reason."""
    prefix = "rejected_"
    return {k.removeprefix(prefix): n for k, n in values.items() if k.startswith(prefix)}


def _level(report: Report, age_s: float) -> Text:
    text = Text(f"{report.level}: {report.message}", _LEVEL_STYLES.get(report.level, "red"))
    if age_s > SILENT_S:
        return Text(f"silent for {age_s:.1f} s, before that ", "red") + text
    return text


def _value(values: Mapping[str, str], key: str) -> str:
    return values.get(key, _ABSENT)
