"""The view of `star_tracker watch`, word by word at a fixed width, and where it goes."""

import io

import numpy as np
import pytest
from rich.console import Console
from watch_helpers import (
    HEALTH,
    SOLVED,
    STARS,
    hear_solved,
    hear_unsolved,
    watched_at,
)

from star_tracker.nodes.watch.model import Report, Watched
from star_tracker.nodes.watch.outputs import Lines, Once, Screen
from star_tracker.nodes.watch.record import plain_line
from star_tracker.nodes.watch.view import View


def console_of(width=80, height=24, terminal=False):
    return Console(
        record=True, width=width, height=height, file=io.StringIO(), force_terminal=terminal,
        color_system=None, legacy_windows=False, _environ={"TERM": "xterm"},
    )


def lines_of(view, width=80, height=24):
    """Return the lines of a view, without the blanks at their ends."""
    console = console_of(width, height)
    console.print(view)
    return [line.rstrip() for line in console.export_text().splitlines()]


def text_of(watched, now_s, **options):
    return "\n".join(lines_of(View(watched, now_s, 20), **options))


FACTS = """\
RA, Dec, roll   109.6000, -34.5000, 0.2500 deg
camera 1 sigma  x 2.00, y 3.00, z 40.00 arcsec
quaternion      x +0.00000000, y +0.00000000
                z +0.70710678, w +0.70710678
status          SOLVED: identified
stars           2 of 4 identified, 1 displaced
found by        match_group, tracking, mirrored
fit             rms 0.198 px, p(wrong) 1.5e-09
solve time      0.161 ms
diagnostics     OK: 100 % of 80 frames solved
solved          8.0 of 8.0 frames/s, ratio 1.000
latency         p50 0.9, p95 1.2, max n/a ms
input age       0.002 s
frames          81, 80 solved, 3 dropped
rejected        2 bad_centroids
focal length    2435.817 +- 0.133 px, +0.0057 %"""
TABLE = """\
star         x px   y px   RA deg  Dec deg    V res px state
HIP 32246 1011.12 278.06 100.9830  -5.1311 3.06  0.125 identified
HIP 35846    7.50  40.25 110.8688 +25.0505 5.04  0.250 identified
star 77    300.00 400.00 359.9999 +89.5000 6.00 12.500 displaced"""


def test_view_at_80_columns():
    heading, *rest = lines_of(View(watched_at(10.0), 10.1, 20))
    assert heading == "/left/identify_node" + " " * 41 + "last frame 0.1 s ago"
    assert rest == [*FACTS.splitlines(), *TABLE.splitlines()]


def test_view_at_120_columns_has_the_stars_beside_the_rest():
    heading, *rest = lines_of(View(watched_at(10.0), 10.1, 20), width=120)
    assert heading.endswith("last frame 0.1 s ago")
    assert len(heading) == 120
    facts, table = FACTS.splitlines(), TABLE.splitlines()
    table += [""] * (len(facts) - len(table))
    assert rest == [
        f"{fact:<52}{star}".rstrip() for fact, star in zip(facts, table, strict=True)
    ]


@pytest.mark.parametrize("width", [80, 120])
def test_no_number_of_a_large_and_busy_node_is_cut(width):
    watched = watched_at(10.0, "/a_long_namespace/of_a_camera")
    big = STARS.copy()
    big["x"], big["y"], big["residual_px"], big["hip"] = 4095.12, 4095.34, 39.999, 118322
    watched.on_solution(7, "identify_node", {**SOLVED, "reason": "a reason " * 12}, 10.0)
    watched.on_stars(7, big, 10.0)
    watched.take(11.0)
    text = text_of(watched, 11.0, width=width)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    assert "HIP 118322" in text
    assert "4095.34" in text


def test_the_age_of_a_frame_that_is_missed():
    watched = watched_at(10.0)
    assert "no frame for 3.2 s" in lines_of(View(watched, 13.2, 1))[0]


def test_an_unsolved_frame_shows_reason_hint_and_the_attitude_before():
    watched = watched_at(10.0)
    hear_unsolved(watched, 12.0)
    text = text_of(watched, 12.5)
    assert "status          NO_MATCH: nothing fits" in text
    assert "hint            image looks mirrored: parity mirrored solves it" in text
    assert "of 2.5 s ago" in text
    assert "stars           0 of 4 identified, 0 displaced, 1 ignored" in text
    assert "found by" not in text
    assert "no star identified" in text


def test_a_node_that_has_said_nothing():
    text = text_of(Watched(), 1.0)
    assert text.splitlines()[0].endswith("no frame yet")
    assert "attitude     none yet" in text
    assert "diagnostics  no report heard yet" in text
    assert "no stars heard" in text


def test_a_node_that_falls_silent():
    watched = watched_at(10.0)
    text = text_of(watched, 17.25)
    assert "silent for 7.2 s, before that OK: 100 % of 80 frames solved" in text


def test_a_message_that_cannot_be_read_and_a_focal_length_without_frames():
    watched = watched_at(10.0)
    watched.trouble = "identified_stars: PointCloud2 has no field hip"
    watched.on_report("/left/identify_node: focal length", Report("WARN", "none yet", {
        "frames": "0",
    }), 10.0)
    text = text_of(watched, 10.0)
    assert "not readable    identified_stars: PointCloud2 has no field hip" in text
    assert "focal length    none yet" in text


def test_without_focal_length_and_rejects():
    watched = Watched()
    watched.on_report("/identify_node: health", Report("WARN", "no frame", {}), 1.0)
    text = text_of(watched, 1.0)
    assert "focal length  not followed" in text
    assert "rejected      none" in text
    assert "solved        - of - frames/s, ratio -" in text


def many_stars(n):
    watched = Watched()
    stars = np.zeros(n, STARS.dtype)
    stars["state"], stars["hip"] = 1, np.arange(1, n + 1)
    stars["magnitude"] = np.linspace(6, 2, n)
    watched.on_solution(1, "identify_node", {**SOLVED, "total": str(n)}, 1.0)
    watched.on_stars(1, stars, 1.0)
    watched.take(2.0)
    return watched


def test_the_brightest_stars_come_first_and_the_rest_is_counted():
    lines = lines_of(View(many_stars(30), 2.0, 3))
    assert [line.split()[1] for line in lines[-4:-1]] == ["30", "29", "28"]
    assert lines[-1] == "27 more"


@pytest.mark.parametrize(("width", "height"), [(80, 24), (80, 40), (120, 24), (120, 14)])
def test_a_view_that_has_to_fit_does(width, height):
    lines = lines_of(View(many_stars(200), 2.0, 1000, fits=True), width, height)
    assert len(lines) == height
    assert lines[-1].endswith("more")


# ---- outputs ---------------------------------------------------------------------------------


def test_lines_tell_each_frame_once(capsys):
    watched, output = Watched(), Lines(plain_line)
    for now_s, stamp in ((1.0, 10**9), (2.0, 2 * 10**9)):
        for frame in hear_solved(watched, now_s, stamp):
            output.frame(watched, frame)
        assert output.look(watched, now_s)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["1.000", "2.000"]


def test_screen_shows_the_view_and_leaves_its_last_state():
    console = console_of(terminal=True)
    watched = watched_at(10.0)
    with Screen(console, 5) as screen:
        screen.frame(watched, watched.frame)
        assert screen.look(watched, 10.1)
        assert screen.look(watched, 14.0)
    written = console.file.getvalue()
    enter, leave = "\x1b[?1049h", "\x1b[?1049l"
    assert written.startswith(enter)
    alternate, after = written.split(leave)
    assert "last frame 0.1 s ago" in alternate
    assert "no frame for 4.0 s" in after
    assert "\x1b[?25h" in written  # the cursor is back


def test_screen_that_never_drew_leaves_nothing():
    console = console_of(terminal=True)
    with Screen(console, 5):
        pass
    assert console.file.getvalue().split("\x1b[?1049l")[1] == ""


def once(console, as_json=False):
    return Once(console, 5, as_json, timeout_s=2.0)


def test_once_waits_for_a_frame_and_a_report():
    console, watched = console_of(), Watched()
    output = once(console)
    assert output.look(watched, 10.0)
    hear_solved(watched, 10.5)
    output.frame(watched, watched.frame)
    assert output.look(watched, 10.5)
    assert console.export_text(clear=False) == ""
    watched.on_report("/identify_node: health", HEALTH, 11.0)
    assert not output.look(watched, 11.0)
    assert "RA, Dec, roll   109.6000" in console.export_text()
    assert not output.silent


def test_once_makes_do_with_what_came_in_time(capsys):
    watched = Watched()
    output = once(console_of(), as_json=True)
    assert output.look(watched, 10.0)
    watched.on_report("/identify_node: health", HEALTH, 11.0)
    assert output.look(watched, 11.9)
    assert not output.look(watched, 12.0)
    assert not output.silent
    assert capsys.readouterr().out.count("\n") == 1


def test_once_says_when_there_was_nothing():
    console = console_of()
    output = once(console)
    assert output.look(Watched(), 10.0)
    assert not output.look(Watched(), 12.0)
    assert output.silent
    assert console.export_text() == ""
