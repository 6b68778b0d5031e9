"""What `star_tracker watch` makes of plain values, without ROS: state, view and JSON."""

import io
import itertools
import json

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from star_tracker.nodes.watch.outputs import Once, print_lines, screen
from star_tracker.nodes.watch.record import json_line
from star_tracker.nodes.watch.state import PATIENCE_S, Report, Watched, attitude_from_orientation
from star_tracker.nodes.watch.view import view_of

#: The dtype of `identified_stars`, as its topic's fields are named.
STARS = np.array([
    (7.5, 40.25, 1572, 35846, 110.8688, 25.0505, 5.04, 0.25, 1),
    (100.0, 200.5, 0, 0, np.nan, np.nan, np.nan, np.nan, 0),
    (1011.125, 278.0625, 1387, 32246, 100.9830, -5.1311, 3.06, 0.125, 1),
    (300.0, 400.0, 77, 0, 359.9999, 89.5, 6.0, 12.5, 2),
], [
    ("x", "<f4"), ("y", "<f4"), ("star_number", "<u4"), ("hip", "<u4"), ("ra_deg", "<f8"),
    ("dec_deg", "<f8"), ("magnitude", "<f4"), ("residual_px", "<f4"), ("state", "<u1"),
])
SOLVED = {
    "status": "SOLVED", "reason": "identified", "hint": "", "method": "match_group",
    "mode": "tracking", "parity": "mirrored", "matched": "2", "displaced": "1", "total": "4",
    "ignored": "0", "wrong_probability": "1.5e-09", "rms_px": "0.1976", "solve_ms": "0.161",
}
UNSOLVED = {
    **SOLVED, "status": "NO_MATCH", "reason": "nothing fits", "method": "", "parity": "",
    "hint": "image looks mirrored: parity mirrored solves it", "matched": "0", "rms_px": "nan",
}
ARCSEC = np.pi / 180 / 3600
#: Boresight at right ascension 0, declination 0: the camera's x, y, z are ICRS' -y, -z, x.
ATTITUDE = attitude_from_orientation(
    np.array([-0.5, 0.5, -0.5, 0.5]), np.diag(np.square([40.0, 2.0, 3.0])) * ARCSEC**2
)
HEALTH = {
    "frames_per_s": "8.000", "solved_per_s": "7.500", "solve_ratio": "0.938",
    "latency_p50_ms": "0.900", "latency_p95_ms": "1.250", "latency_max_ms": "n/a", "frames": "81",
    "solved": "80", "dropped": "3", "mode": "tracking", "configuration": "123456789012",
}


def hear(watched, now_s, stamp_ns=1_500_000_000, values=SOLVED, stars=STARS):
    """Tell of a frame, all of it, and return the frames that are complete then."""
    frame = watched.arriving(stamp_ns, now_s)
    frame.values, frame.stars = values, stars
    frame.attitude = ATTITUDE if values["status"] == "SOLVED" else None
    return watched.take(now_s)


def report(watched, now_s, name="/left/identify_node: health", level="OK", values=HEALTH):
    watched.on_report(name, Report(level, "93 % of 80 frames solved", values, now_s))


def watched_at(now_s):
    """Return a node that has said all there is to say."""
    watched = Watched("/left")
    hear(watched, now_s)
    report(watched, now_s)
    report(watched, now_s, "/left/identify_node: camera", "WARN", {})
    return watched


def console_of(terminal=False):
    return Console(
        record=True, width=80, height=24, file=io.StringIO(), force_terminal=terminal,
        color_system=None, legacy_windows=False, _environ={"TERM": "xterm"},
    )


def lines_of(watched, now_s, n_stars=20):
    """Return the lines of the view, without the blanks at their ends."""
    console = console_of()
    console.print(view_of(watched, now_s, n_stars))
    return [line.rstrip() for line in console.export_text().splitlines()]


# State


@pytest.mark.parametrize("order", itertools.permutations(("values", "attitude", "stars")))
def test_a_solved_frame_is_complete_with_its_last_message_in_whatever_order(order):
    watched, parts = Watched(), {"values": SOLVED, "attitude": ATTITUDE, "stars": STARS}
    for part in order:
        assert watched.take(1.0) == []
        setattr(watched.arriving(7, 1.0), part, parts[part])
    (frame,) = watched.take(1.0)
    assert (frame.stamp_ns, frame.status, frame.attitude) == (7, "SOLVED", ATTITUDE)
    assert watched.frame is watched.solved is frame
    assert watched.take(1.0) == []


def test_an_unsolved_frame_has_no_attitude_and_the_last_one_stays():
    watched = Watched()
    (solved,) = hear(watched, 1.0)
    (frame,) = hear(watched, 3.0, values=UNSOLVED)
    assert (frame.attitude, watched.frame, watched.solved) == (None, frame, solved)


def test_a_frame_that_could_not_be_read_comes_without_stars():
    values = {**UNSOLVED, "status": "BAD_INPUT", "total": "0"}
    (frame,) = hear(Watched(), 1.0, values=values, stars=None)
    assert (frame.status, frame.stars) == ("BAD_INPUT", None)


def test_a_frame_whose_messages_are_lost_is_told_as_far_as_it_came():
    watched = Watched()
    watched.arriving(1, 1.0).values = SOLVED
    watched.arriving(2, 1.0).attitude = ATTITUDE  # from before the first `solution`
    assert watched.take(1.0 + PATIENCE_S) == []
    (frame,) = watched.take(1.01 + PATIENCE_S)
    assert (frame.stamp_ns, frame.attitude, frame.stars) == (1, None, None)
    assert watched.take(100.0) == []


def test_frames_with_one_and_the_same_stamp_are_told_apart_and_stay_in_order():
    watched = Watched()
    for values in (SOLVED, UNSOLVED, SOLVED):
        frame = watched.arriving(0, 1.0)
        frame.stars, frame.values = STARS, values
        frame.attitude = ATTITUDE if values is SOLVED else None
    assert [frame.status for frame in watched.take(1.0)] == ["SOLVED", "NO_MATCH", "SOLVED"]


@pytest.mark.parametrize("seed", range(5))
def test_errors_come_back_from_the_frame_that_imu_has_them_in(seed):
    about_camera = np.diag([1.0, 4.0, 900.0]) * ARCSEC**2
    rotation = Rotation.from_quat(np.random.default_rng(seed).normal(size=4))
    r = rotation.as_matrix()
    found = attitude_from_orientation(rotation.as_quat(), r @ about_camera @ r.T)
    np.testing.assert_allclose(found.rotation, r, atol=1e-12)
    np.testing.assert_allclose(found.covariance_rad2, about_camera, atol=1e-9 * ARCSEC**2)


@pytest.mark.parametrize("quaternion", [[0.0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_an_orientation_that_is_no_rotation_is_refused(quaternion):
    with pytest.raises(ValueError, match="the orientation is no rotation"):
        attitude_from_orientation(np.array(quaternion), np.zeros((3, 3)))


def test_only_the_nodes_own_reports_count():
    watched = Watched("/left")
    for name in ("/right/identify_node", "/identify_node", "/left/inner/identify_node"):
        report(watched, 1.0, f"{name}: health")
    report(watched, 1.0, "/left/no kind")
    assert (watched.reports, watched.full_name) == ({}, "/left/identify_node")
    report(watched, 2.0, "/left/second: health")
    report(watched, 3.0, "/left/third: health")
    assert (watched.full_name, watched.reports["health"].heard_s) == ("/left/second", 2.0)
    assert Watched("/").full_name == "/identify_node"


# View


VIEW = """\
/left/identify_node                                         last frame 0.1 s ago
RA, Dec, roll   0.0000, +0.0000, 0.0000 deg
camera 1 sigma  x 2.00, y 3.00, z 40.00 arcsec
quaternion      x -0.500000, y +0.500000, z -0.500000, w +0.500000
status          SOLVED: identified
stars           2 of 4 identified, 1 displaced, 0 ignored
solve time      0.161 ms
found by        match_group, tracking, mirrored
fit             rms 0.1976 px, p(wrong) 1.5e-09
health          OK: 93 % of 80 frames solved
solved          7.500 of 8.000 frames/s, ratio 0.938
latency         p50 0.900, p95 1.250, max n/a ms
frames          81, 80 solved, 3 dropped
camera          WARN: 93 % of 80 frames solved
star         x px   y px   RA deg  Dec deg    V res px state
HIP 32246 1011.12 278.06 100.9830  -5.1311 3.06  0.125 identified
HIP 35846    7.50  40.25 110.8688 +25.0505 5.04  0.250 identified
star 77    300.00 400.00 359.9999 +89.5000 6.00 12.500 displaced"""


def test_the_whole_view_at_80_columns():
    assert lines_of(watched_at(10.0), 10.1) == VIEW.splitlines()


def test_the_brightest_stars_come_first():
    _, brightest, next_one, _ = [line.split()[1] for line in VIEW.splitlines()[-4:]]
    for n_stars, names in ((1, [brightest]), (2, [brightest, next_one])):
        stars = lines_of(watched_at(10.0), 10.1, n_stars)[-n_stars:]
        assert [line.split()[1] for line in stars] == names


def test_a_star_without_a_number_is_named_by_its_place_alone():
    stars = STARS[-1:].copy()
    stars["star_number"] = 0
    watched = Watched("/left")
    hear(watched, 10.0, stars=stars)
    assert lines_of(watched, 10.1)[-1].split()[:2] == ["-", "300.00"]


def test_an_unsolved_frame_shows_reason_hint_and_the_attitude_before():
    watched = watched_at(10.0)
    watched.trouble = "imu: the orientation is no rotation"
    hear(watched, 12.0, values=UNSOLVED, stars=STARS[:0])
    text = "\n".join(lines_of(watched, 17.25))
    for part in (
        "last frame 5.2 s ago", "RA, Dec, roll   0.0000", "of 7.2 s ago",
        "status          NO_MATCH: nothing fits", "hint            image looks mirrored: parity",
        "health          silent for 7.2 s, before that OK: 93 %",
        "not readable    imu: the orientation is no rotation",
    ):
        assert part in text
    assert "found by" not in text


def test_a_node_that_has_said_nothing_or_little():
    (line,) = lines_of(Watched(), 1.0)
    assert line.startswith("/identify_node")
    assert line.endswith("no frame yet")
    watched = Watched("/left")
    report(watched, 1.0, values={})
    assert "latency  p50 -, p95 -, max - ms" in lines_of(watched, 1.0)


# JSON


def test_record_of_a_solved_frame_has_numbers_with_units():
    watched = watched_at(1.0)
    record = json.loads(json_line(watched, watched.frame))
    assert (record["node"], record["stamp_ns"]) == ("/left/identify_node", 1_500_000_000)
    assert (record["status"], record["hint"], record["matched"]) == ("SOLVED", None, 2)
    assert (record["ra_deg"], record["dec_deg"], record["roll_deg"]) == pytest.approx((0, 0, 0))
    assert record["quaternion_xyzw"] == pytest.approx([-0.5, 0.5, -0.5, 0.5])
    assert record["sigma_camera_xyz_arcsec"] == pytest.approx([2.0, 3.0, 40.0])
    assert record["stars"][1] == {
        "x": 100.0, "y": 200.5, "star_number": 0, "hip": 0, "ra_deg": None, "dec_deg": None,
        "magnitude": None, "residual_px": None, "state": "unidentified",
    }
    assert [star["state"] for star in record["stars"][2:]] == ["identified", "displaced"]
    assert (record["stars"][0]["magnitude"], record["health"]["latency_p95_ms"]) == (5.04, 1.25)
    assert (record["health"]["latency_max_ms"], record["health"]["level"]) == (None, "OK")
    assert record["health"]["configuration"] == "123456789012"
    assert record["camera"]["level"] == "WARN"


def test_record_without_attitude_stars_or_frame_has_null_or_nothing():
    watched = Watched()
    (frame,) = hear(watched, 1.0, values=UNSOLVED | {"total": "0"}, stars=None)
    record = json.loads(json_line(watched, frame))
    assert (record["ra_deg"], record["quaternion_xyzw"], record["rms_px"]) == (None, None, None)
    assert record["stars"] == []
    assert json.loads(json_line(Watched(), None)) == {"node": "/identify_node"}


# Where it goes


def test_lines_tell_each_frame_once(capsys):
    watched = Watched()
    for stamp_ns in (1, 2):
        assert print_lines(watched, hear(watched, 1.0, stamp_ns), 1.0)
    assert print_lines(watched, [], 2.0)
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line)["stamp_ns"] for line in lines] == [1, 2]


def test_the_screen_shows_the_view_and_leaves_its_last_state():
    console, watched = console_of(terminal=True), watched_at(10.0)
    with screen(console, 5) as draw:
        assert draw(watched, [], 10.1)
        assert draw(watched, [], 14.0)
    written = console.file.getvalue()
    enter, leave = "\x1b[?1049h", "\x1b[?1049l"
    assert written.startswith(enter)
    alternate, after = written.split(leave)
    assert "last frame 0.1 s ago" in alternate
    assert "last frame 4.0 s ago" in after
    assert "\x1b[?25h" in written  # the cursor is back


def test_once_waits_for_a_frame_and_a_report():
    shown, watched = [], Watched("/left")
    once = Once(lambda *state: shown.append(state), 2.0)
    hear(watched, 10.5)
    assert once(watched, [], 10.0)
    report(watched, 11.0)
    assert not once(watched, [], 11.0)
    assert (shown, once.silent) == ([(watched, 11.0)], False)


@pytest.mark.parametrize("whole_at_last", [True, False])
def test_once_waits_for_a_frame_that_is_whole(whole_at_last):
    """On a busy machine the first frame that was heard had come before its stars' topic was."""
    shown, watched = [], Watched("/left")
    once = Once(lambda *state: shown.append(state), 2.0)
    report(watched, 10.0)
    hear(watched, 10.0)
    watched.frame.stars = None
    assert once(watched, [], 10.0)
    if whole_at_last:
        hear(watched, 10.2)
    assert once(watched, [], 10.2) is not whole_at_last
    if not whole_at_last:
        assert not once(watched, [], 12.0)
    assert len(shown) == 1


@pytest.mark.parametrize("heard", [True, False])
def test_once_makes_do_with_what_came_in_time(heard):
    shown, watched = [], Watched("/left")
    once = Once(lambda *state: shown.append(state), 2.0)
    if heard:
        report(watched, 11.0)
    assert once(watched, [], 10.0)
    assert once(watched, [], 11.9)
    assert not once(watched, [], 12.0)
    assert (len(shown), once.silent) == (int(heard), not heard)
