"""Health -> diagnostic status."""

from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from star_tracker.msg_adapters.health import report_from_status, status_from_health

VALUES = {"ratio": 0.25, "frames": 7, "age": None, "mode": "tracking"}


@pytest.mark.parametrize(("level", "code"), [
    ("ok", DiagnosticStatus.OK), ("warn", DiagnosticStatus.WARN),
    ("error", DiagnosticStatus.ERROR),
])
def test_level(level, code):
    assert status_from_health("n", level, "m", {}).level == code


def test_name_and_message():
    status = status_from_health("/left/node: health", "ok", "fine", VALUES)
    assert (status.name, status.message) == ("/left/node: health", "fine")


@pytest.mark.parametrize("level", ["ok", "warn", "error"])
def test_report_round_trip(level):
    found, message, values = report_from_status(status_from_health("n", level, "fine", VALUES))
    assert (found, message) == (level.upper(), "fine")
    assert values == {"ratio": "0.250", "frames": "7", "age": "n/a", "mode": "tracking"}


@pytest.mark.parametrize(("code", "level"), [(DiagnosticStatus.STALE, "STALE"), (b"\x07", "7")])
def test_report_of_a_level_that_no_node_of_this_package_has(code, level):
    assert report_from_status(DiagnosticStatus(level=code))[0] == level


def test_a_level_is_a_number_for_readers_of_bags():
    status = SimpleNamespace(level=2, message="broken", values=[])
    assert report_from_status(status) == ("ERROR", "broken", {})
