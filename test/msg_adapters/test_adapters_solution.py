"""Solution -> diagnostics."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header

from star_tracker.attitude.attitude import Attitude
from star_tracker.identification.labels import Identification
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.solution import (
    QUALITIES,
    diagnostics_from_solution,
    name_from_diagnostics,
    quality_from_solution,
    values_from_diagnostics,
)
from star_tracker.solution import Solution, Status

HEADER = Header(frame_id="camera")
HEADER.stamp.sec = 77


def solution_of(status, **changes):
    return Solution(status, "a reason", Identification.empty(2), **changes)


def values_of(solution):
    return values_from_diagnostics(diagnostics_from_solution(solution, "tracker", HEADER))


@pytest.mark.parametrize(("status", "level"), [
    (Status.SOLVED, DiagnosticStatus.OK),
    (Status.TOO_FEW_STARS, DiagnosticStatus.WARN),
    (Status.NO_MATCH, DiagnosticStatus.WARN),
    (Status.AMBIGUOUS, DiagnosticStatus.WARN),
    (Status.TIMEOUT, DiagnosticStatus.WARN),
    (Status.BAD_INPUT, DiagnosticStatus.ERROR),
])
def test_level_says_whether_the_frame_was_used(status, level):
    message = diagnostics_from_solution(solution_of(status), "tracker", HEADER)
    assert message.status[0].level == level


def test_message_names_status_and_reason():
    message = diagnostics_from_solution(solution_of(Status.NO_MATCH), "tracker", HEADER)
    assert message.status[0].message == "NO_MATCH: a reason"
    assert message.status[0].name == "tracker"


def test_name_round_trip():
    message = diagnostics_from_solution(solution_of(Status.SOLVED), "tracker", HEADER)
    assert name_from_diagnostics(message) == "tracker"


def test_a_message_without_a_status_has_no_name():
    with pytest.raises(MessageError, match="holds no status"):
        name_from_diagnostics(DiagnosticArray())


def test_header_is_the_callers():
    assert diagnostics_from_solution(solution_of(Status.SOLVED), "t", HEADER).header == HEADER


def test_values_round_trip():
    identification = Identification(
        np.array([5, -1, 7, 9]), np.array([1, 0, 2, 1], np.uint8), np.array([0.1, np.nan, 9, 0.2])
    )
    solution = Solution(
        Status.SOLVED, "identified", identification, method="match_group", parity="mirrored",
        wrong_probability=4.52e-13, log10_false_alarms=-12.345, rms_px=0.15811,
        n_hypotheses=4711, n_ignored=3, solve_ms=2.5, mode="tracking",
    )
    assert values_of(solution) == {
        "status": "SOLVED", "reason": "identified", "hint": "", "method": "match_group",
        "mode": "tracking", "parity": "mirrored",
        "matched": "2", "displaced": "1", "total": "4", "ignored": "3",
        "wrong_probability": "4.52e-13", "log10_false_alarms": "-12.35", "rms_px": "0.1581",
        "hypotheses": "4711", "solve_ms": "2.500",
    }


def test_a_solved_frame_has_all_numbers_for_plots():
    identification = Identification(
        np.array([5, -1, 7]), np.array([1, 0, 2], np.uint8), np.array([0.1, np.nan, 9])
    )
    quality = quality_from_solution(Solution(
        Status.SOLVED, "identified", identification,
        Attitude.from_rotation(np.eye(3), np.eye(3) * 1e-9), log10_false_alarms=-12.345,
        rms_px=0.15811, solve_ms=2.5,
    ))
    assert {name: message.data for name, message in quality.items()} == {
        "matched": 1.0, "rms_px": 0.15811, "log10_false_alarms": -12.345, "solve_ms": 2.5,
    }
    assert set(quality) == set(QUALITIES)


def test_an_unsolved_frame_has_no_residual_to_plot():
    quality = quality_from_solution(solution_of(Status.NO_MATCH, solve_ms=7.0))
    assert {name: message.data for name, message in quality.items()} == {
        "matched": 0.0, "solve_ms": 7.0,
    }


def test_unsolved_frame_has_wrong_probability_one():
    values = values_of(solution_of(Status.NO_MATCH, log10_false_alarms=-1.0))
    assert values["wrong_probability"] == "1"


def test_hint_of_an_unsolved_frame_is_written():
    solution = solution_of(Status.NO_MATCH)
    message = diagnostics_from_solution(solution, "t", HEADER, "image looks mirrored")
    assert values_from_diagnostics(message)["hint"] == "image looks mirrored"


def test_numbers_that_are_missing_are_said_so_in_words():
    values = values_of(solution_of(Status.NO_MATCH))
    assert (values["rms_px"], values["log10_false_alarms"]) == ("nan", "inf")
    assert (values["method"], values["parity"]) == ("", "")
