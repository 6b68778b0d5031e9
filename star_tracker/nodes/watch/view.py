"""What `star_tracker watch` shows of a node, as rich renderables. No ROS here.

Below `WIDE` columns the stars stand under the rest, else beside it; 80 columns are enough.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table
from rich.text import Text

from star_tracker.identification.labels import StarState
from star_tracker.nodes.watch.model import SILENT_S, Frame, Report, Watched, state_name

#: From this many columns on there is room for two parts side by side; that of the left one.
WIDE, _LEFT = 120, 50
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
        n_stars: how many stars to list at most.
        fits: whether the view has to fit the terminal's height, with fewer stars where it is low.
    """

    def __init__(
        self, watched: Watched, now_s: float, n_stars: int, *, fits: bool = False
    ) -> None:
        self._watched, self._now_s, self._n_stars, self._fits = watched, now_s, n_stars, fits

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> Iterator[RenderableType]:
        """Yield the parts, as rich asks for them."""
        yield heading(self._watched, self._now_s)
        facts = _facts(self._watched, self._now_s)
        wide = options.max_width >= WIDE
        n = self._n_stars
        if self._fits:
            used = 1 if wide else 1 + len(console.render_lines(facts, options.update(height=None)))
            # Head and tail of the table take a line each.
            n = max(0, min(n, options.max_height - used - 2))
        stars = stars_table(self._watched.frame, n)
        if not wide:
            yield facts
            yield stars
            return
        both = Table.grid(padding=(0, 2, 0, 0))
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
    table = Table(box=None, collapse_padding=True, pad_edge=False, header_style="bold")
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
    yield "camera 1 sigma", f"x {x:.2f}, y {y:.2f}, z {z:.2f} arcsec"
    x, y, z, w = pose.quaternion_xyzw
    yield "quaternion", f"x {x:+.8f}, y {y:+.8f}\nz {z:+.8f}, w {w:+.8f}"
    frame = watched.frame
    if frame is not None and frame.pose is None:
        yield "", Text(f"of {now_s - watched.pose_s:.1f} s ago", "yellow")


def _frame_rows(frame: Frame | None) -> Rows:
    if frame is None:
        return
    v = frame.values
    style = {"SOLVED": "green", "BAD_INPUT": "red"}.get(frame.status, "yellow")
    yield "status", Text(f"{frame.status}: {_text(v, 'reason')}", style)
    if v.get("hint"):
        yield "hint", Text(v["hint"], "yellow")
    n_ignored = v.get("ignored", "0")
    ignored = "" if n_ignored == "0" else f", {n_ignored} ignored"
    yield "stars", (
        f"{_text(v, 'matched')} of {_text(v, 'total')} identified, "
        f"{_text(v, 'displaced')} displaced{ignored}"
    )
    if frame.status == "SOLVED":
        yield "found by", ", ".join(_text(v, key) for key in ("method", "mode", "parity"))
        yield "fit", (
            f"rms {_text(v, 'rms_px', '.3f')} px, p(wrong) {_text(v, 'wrong_probability', '.1e')}"
        )
    yield "solve time", f"{_text(v, 'solve_ms')} ms"


def _health_rows(watched: Watched, now_s: float) -> Rows:
    report = watched.health
    if report is None:
        yield "diagnostics", Text("no report heard yet", "yellow")
        return
    v = report.values
    yield "diagnostics", _level(report, now_s - watched.health_s)
    yield "solved", (
        f"{_text(v, 'solved_per_s', '.1f')} of {_text(v, 'frames_per_s', '.1f')} frames/s, "
        f"ratio {_text(v, 'solve_ratio')}"
    )
    which = ("p50", "p95", "max")
    yield "latency", ", ".join(f"{w} {_text(v, f'latency_{w}_ms', '.1f')}" for w in which) + " ms"
    yield "input age", f"{_text(v, 'input_age_s')} s"
    yield "frames", (
        f"{_text(v, 'frames')}, {_text(v, 'solved')} solved, {_text(v, 'dropped')} dropped"
    )
    yield "rejected", ", ".join(f"{n} {kind}" for kind, n in rejected(v).items()) or "none"
    yield "focal length", _focal_length(watched.focal_length)


def _focal_length(report: Report | None) -> str:
    if report is None:
        return "not followed"
    if report.values.get("frames") == "0":
        return report.message
    v = report.values
    return (
        f"{_text(v, 'focal_length_px')} +- {_text(v, 'standard_error_px')} px, "
        f"{_text(v, 'drift_percent', '+.4f')} %"
    )


def rejected(values: Mapping[str, str]) -> dict[str, str]:
    """Return how often what was rejected, by reason."""
    prefix = "rejected_"
    return {k.removeprefix(prefix): n for k, n in values.items() if k.startswith(prefix)}


def _level(report: Report, age_s: float) -> Text:
    text = Text(f"{report.level}: {report.message}", _LEVEL_STYLES.get(report.level, "red"))
    if age_s > SILENT_S:
        return Text(f"silent for {age_s:.1f} s, before that ", "red") + text
    return text


def _text(values: Mapping[str, str], key: str, spec: str = "") -> str:
    """Return a value, as a number in this format where it is one."""
    value = values.get(key) or _ABSENT
    if not spec:
        return value
    try:
        return format(float(value), spec)
    except ValueError:
        return value
