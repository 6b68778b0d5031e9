"""What `star_tracker watch` shows of a node, as rich renderables. No ROS here."""

from collections import defaultdict
from collections.abc import Iterator, Mapping

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import star_name
from star_tracker.geometry.spherical import ARCSEC_PER_RAD
from star_tracker.identification.labels import StarState
from star_tracker.nodes.watch.state import Frame, Report, Watched

#: A node without a report for so long is said to be silent, s; it reports once a second.
SILENT_S = 3.0
#: A frame older than that is missed, s.
_FRESH_S = 1.0
_STYLES = {"SOLVED": "green", "OK": "green", "BAD_INPUT": "red", "ERROR": "red", "STALE": "red"}
_FRAME = {
    "stars": "{matched} of {total} identified, {displaced} displaced, {ignored} ignored",
    "solve time": "{solve_ms} ms",
}
_SOLVED = {
    "found by": "{method}, {mode}, {parity}",
    "fit": "rms {rms_px} px, p(wrong) {wrong_probability}",
}
_HEALTH = {
    "solved": "{solved_per_s} of {frames_per_s} frames/s, ratio {solve_ratio}",
    "latency": "p50 {latency_p50_ms}, p95 {latency_p95_ms}, max {latency_max_ms} ms",
    "frames": "{frames}, {solved} solved, {dropped} dropped",
}
_STAR_COLUMNS = ("star", "x px", "y px", "RA deg", "Dec deg", "V", "res px", "state")
Rows = Iterator[tuple[str, RenderableType]]


def view_of(watched: Watched, now_s: float, n_stars: int) -> RenderableType:
    """Return the node's name, what it says, and `n_stars` of its stars, the brightest first."""
    facts = Table.grid(padding=(0, 2, 0, 0))
    facts.add_column(style="cyan", no_wrap=True)
    facts.add_column()
    for label, value in _rows(watched, now_s):
        facts.add_row(label, value)
    return Group(_heading(watched, now_s), facts, *_stars(watched.frame, n_stars))


def pose_degrees(attitude: Attitude) -> tuple[list[float], list[float]]:
    """Return RA, declination, roll (deg) and 1 sigma about the camera's x, y, z (arcsec)."""
    boresight_deg = np.degrees([attitude.ra_rad, attitude.dec_rad, attitude.roll_rad])
    variances = np.maximum(np.diag(attitude.covariance_rad2), 0.0)
    return boresight_deg.tolist(), (np.sqrt(variances) * ARCSEC_PER_RAD).tolist()


def _heading(watched: Watched, now_s: float) -> RenderableType:
    line = Table.grid(expand=True)
    line.add_column()
    line.add_column(justify="right")
    freshness = Text("no frame yet", "yellow")
    if watched.frame is not None:
        age_s = now_s - watched.frame.since_s
        freshness = Text(f"last frame {age_s:.1f} s ago", "green" if age_s < _FRESH_S else "red")
    line.add_row(Text(watched.full_name, "bold"), freshness)
    return line


def _rows(watched: Watched, now_s: float) -> Rows:
    frame, solved = watched.frame, watched.solved
    if solved is not None and solved.attitude is not None:
        yield from _attitude_rows(solved.attitude)
        if solved is not frame:
            yield "", Text(f"of {now_s - solved.since_s:.1f} s ago", "yellow")
    if frame is not None:
        yield "status", _coloured(frame.status, frame.values.get("reason", ""))
        if frame.values.get("hint"):
            yield "hint", Text(frame.values["hint"], "yellow")
        yield from _filled(_FRAME | (_SOLVED if frame.status == "SOLVED" else {}), frame.values)
    for kind, report in watched.reports.items():
        yield kind, _report(report, now_s)
        if kind == "health":
            yield from _filled(_HEALTH, report.values)
    if watched.trouble:
        yield "not readable", Text(watched.trouble, "red")


def _attitude_rows(attitude: Attitude) -> Rows:
    (ra, dec, roll), (x, y, z) = pose_degrees(attitude)
    yield "RA, Dec, roll", Text(f"{ra:.4f}, {dec:+.4f}, {roll:.4f} deg", "bold")
    yield "camera 1 sigma", f"x {x:.2f}, y {y:.2f}, z {z:.2f} arcsec"
    yield "quaternion", "x {:+.6f}, y {:+.6f}, z {:+.6f}, w {:+.6f}".format(
        *attitude.quaternion_xyzw
    )


def _filled(templates: Mapping[str, str], values: Mapping[str, str]) -> Rows:
    """Yield rows with the values put in, `-` for one that the node does not tell."""
    known = defaultdict(lambda: "-", values)
    for label, template in templates.items():
        yield label, template.format_map(known)


def _report(report: Report, now_s: float) -> Text:
    age_s = now_s - report.heard_s
    silent = f"silent for {age_s:.1f} s, before that " if age_s > SILENT_S else ""
    return Text(silent, "red") + _coloured(report.level, report.message)


def _coloured(word: str, sentence: str) -> Text:
    return Text(f"{word}: {sentence}", _STYLES.get(word, "yellow"))


def _stars(frame: Frame | None, n_stars: int) -> Iterator[RenderableType]:
    if frame is None or frame.stars is None:
        return
    table = Table(box=None, collapse_padding=True, pad_edge=False, header_style="bold")
    for heading in _STAR_COLUMNS:
        justify = "left" if heading in ("star", "state") else "right"
        table.add_column(heading, justify=justify, no_wrap=True)
    stars = frame.stars[frame.stars["state"] != StarState.UNIDENTIFIED]
    for star in stars[np.argsort(stars["magnitude"], kind="stable")][:n_stars]:
        table.add_row(
            _name(star),
            f"{star['x']:.2f}", f"{star['y']:.2f}", f"{star['ra_deg']:.4f}",
            f"{star['dec_deg']:+.4f}", f"{star['magnitude']:.2f}", f"{star['residual_px']:.3f}",
            StarState(star["state"]).name.lower(),
        )
    yield table


def _name(star: np.void) -> str:
    """Return what a star is called; `-` for one of Gaia's: no field of a cloud holds 64 bits."""
    hip, number = int(star["hip"]), int(star["star_number"])
    return star_name(hip, number) if hip or number else "-"
