"""What the log says of a stream of frames, and how often. Needs no ROS."""

import numpy as np
import pytest

from star_tracker.attitude.attitude import Attitude
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.identification.labels import Identification, StarState
from star_tracker.nodes.identify.announcements import Announcements, Throttle, frame_line
from star_tracker.solution import Solution, Status

STATES = [StarState.IDENTIFIED] * 15 + [StarState.DISPLACED, StarState.UNIDENTIFIED]
SOLVED = Solution(
    Status.SOLVED, "identified",
    Identification(np.zeros(17, np.int64), np.array(STATES, np.uint8), np.zeros(17)),
    Attitude.from_rotation(rotation_from_boresight(*np.radians([109.6, 34.5, 10.0])), np.eye(3)),
    rms_px=0.25, solve_ms=0.5,
)
UNSOLVED = Solution(Status.NO_MATCH, "nothing fits", Identification.empty(9))
FIX = "RA 109.600 Dec +34.500, 15 of 17 stars"
HINT = "image looks mirrored: parity mirrored solves it"


def said(frames, hints=(), per_s=10.0):
    """Return (frame, text, warns) of all that is said of a stream; s = solved, u = unsolved."""
    announcements, lines = Announcements(), []
    for i, kind in enumerate(frames):
        line = announcements.on_frame(
            SOLVED if kind == "s" else UNSOLVED, dict(hints).get(i, ""), i / per_s
        )
        if line is not None:
            lines.append((i, line.text, line.warns))
    return lines


def test_the_first_fix_is_said_once():
    assert said("s" * 1000) == [(0, f"first fix: {FIX}", False)]


def test_a_fix_that_comes_late_is_still_the_first():
    assert said("us")[-1] == (1, f"first fix: {FIX}", False)


def test_lost_and_found_again():
    assert said("s" * 40 + "u" * 50 + "s" * 20)[1:] == [
        (42, "lost after 40 solved frames: NO_MATCH: nothing fits", True),
        (90, f"found again after 50 frames: {FIX}", False),
    ]


def test_a_frame_or_two_are_not_lost():
    assert len(said("s" * 40 + "uu" + "s" * 40 + "u" + "s" * 20)) == 1


def test_frames_solved_between_two_that_are_not_count_on():
    (_, lost, _) = said("s" * 40 + "uu" + "s" * 40 + "uuu")[1]
    assert lost.startswith("lost after 80 solved frames: ")


def test_while_nothing_is_solved_there_is_a_line_every_ten_seconds():
    lines = said("u" * 400)
    assert [i for i, _, _ in lines] == [2, 102, 202, 302]
    assert lines[0] == (2, "no fix in 3 frames: NO_MATCH: nothing fits", True)
    assert lines[1][1] == "no fix in 103 frames: NO_MATCH: nothing fits"


def test_a_fix_that_stays_lost_is_told_now_and_then():
    lines = said("s" * 10 + "u" * 300)
    assert [i for i, _, _ in lines] == [0, 12, 112, 212]
    assert lines[2][1] == "still no fix, for 103 frames: NO_MATCH: nothing fits"


def test_a_fix_that_comes_and_goes_does_not_flood_the_log():
    lines = said(("s" * 5 + "u" * 5) * 100)  # 100 s
    assert len(lines) <= 2 * 10 + 1


def test_what_would_help_is_part_of_the_line():
    lines = said("u" * 250, {5: HINT, 40: HINT})
    assert HINT not in lines[0][1]
    assert lines[1][1].endswith(f"nothing fits; {HINT}")
    assert HINT not in lines[2][1]  # not known for ten seconds


def test_what_would_help_frames_that_are_solved_is_said_once_a_minute():
    improves = "improves if fov_deg is 12.00 instead of 12.50"
    lines = said("s" * 700, dict.fromkeys(range(700), improves))
    assert [i for i, _, _ in lines] == [0, 1, 601]
    assert lines[1] == (1, f"solved, but {improves}", True)


@pytest.mark.parametrize(("solution", "text"), [
    (SOLVED, f"SOLVED: {FIX}, rms 0.25 px, 0.50 ms"),
    (UNSOLVED, "NO_MATCH: nothing fits"),
])
def test_a_frame_in_one_line(solution, text):
    assert frame_line(solution) == text


def test_input_that_cannot_be_used_is_for_a_complaint_but_counts():
    announcements = Announcements()
    bad = Solution(Status.BAD_INPUT, "no field x", Identification.empty(0))
    assert [announcements.on_frame(bad, "", i / 10) for i in range(50)] == [None] * 50
    line = announcements.on_frame(UNSOLVED, "", 5.0)
    assert line.text == "no fix in 51 frames: NO_MATCH: nothing fits"


# ---- complaints ------------------------------------------------------------------------------


def test_each_kind_of_complaint_has_its_own_time():
    throttle = Throttle()
    assert throttle.passed("camera_info", "K is zero", 0.0) == "K is zero"
    assert throttle.passed("malformed_cloud", "no field x", 0.1) == "no field x"
    assert throttle.passed("camera_info", "K is zero", 9.9) == ""


def test_complaints_that_were_held_back_are_counted():
    throttle = Throttle()
    found = [throttle.passed("kind", "text", i / 10) for i in range(250)]
    assert {i: text for i, text in enumerate(found) if text} == {
        0: "text", 100: "text (99 more of this kind)", 200: "text (99 more of this kind)",
    }
