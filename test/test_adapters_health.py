"""Health -> diagnostic status."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from msg_adapters.health import health_from_diagnostics, status_from_health

VALUES = {"ratio": 0.25, "frames": 7, "age": None, "mode": "tracking"}


@pytest.mark.parametrize(("level", "code"), [
    ("ok", DiagnosticStatus.OK), ("warn", DiagnosticStatus.WARN),
    ("error", DiagnosticStatus.ERROR),
])
def test_level(level, code):
    assert status_from_health("n", level, "m", {}).level == code


def test_values_round_trip():
    status = status_from_health("/left/node: health", "ok", "fine", VALUES)
    assert (status.name, status.message) == ("/left/node: health", "fine")
    message = DiagnosticArray(status=[DiagnosticStatus(name="other"), status])
    assert health_from_diagnostics(message, "/left/node: health") == {
        "ratio": "0.250", "frames": "7", "age": "n/a", "mode": "tracking",
    }


def test_a_missing_status_is_said_so():
    with pytest.raises(KeyError, match="no status /right"):
        health_from_diagnostics(DiagnosticArray(), "/right")
