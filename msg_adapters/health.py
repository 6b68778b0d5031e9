"""Health of a node -> diagnostic status, and back to plain key-value text."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import diagnostic_msgs.msg

#: The levels of DiagnosticStatus, in the order of their numbers.
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
#: What stands where a number is not known.
NOT_KNOWN = "n/a"


def status_from_health(
    name: str, level: str, message: str, values: Mapping[str, object]
) -> "diagnostic_msgs.msg.DiagnosticStatus":
    """Write a status: level `ok`, `warn` or `error`; None among the values is not known."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=bytes([_LEVELS.index(level.upper())]), name=str(name), message=str(message),
        values=[KeyValue(key=str(key), value=_text(value)) for key, value in values.items()],
    )


def report_from_status(
    status: "diagnostic_msgs.msg.DiagnosticStatus",
) -> tuple[str, str, dict[str, str]]:
    """Read level (`OK`, `WARN`, `ERROR`, `STALE` or its number), sentence, keys and values."""
    # A single byte in rclpy, a number in what readers of bags make of it.
    number = status.level[0] if isinstance(status.level, bytes) else int(status.level)
    level = _LEVELS[number] if number < len(_LEVELS) else str(number)
    return level, str(status.message), {pair.key: pair.value for pair in status.values}


def _text(value: object) -> str:
    if value is None:
        return NOT_KNOWN
    return f"{value:.3f}" if isinstance(value, float) else str(value)
