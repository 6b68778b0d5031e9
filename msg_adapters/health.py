"""Health of a node -> diagnostic status, and back to plain key-value text."""

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

_LEVELS = {
    "ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR,
}
_NAMES = {
    DiagnosticStatus.OK: "OK", DiagnosticStatus.WARN: "WARN", DiagnosticStatus.ERROR: "ERROR",
    DiagnosticStatus.STALE: "STALE",
}
#: What stands where a number is not known.
NOT_KNOWN = "n/a"


def status_from_health(
    name: str, level: str, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    """Write a status: level `ok`, `warn` or `error`; None among the values is not known."""
    return DiagnosticStatus(
        level=_LEVELS[level], name=str(name), message=str(message),
        values=[KeyValue(key=str(key), value=_text(value)) for key, value in values.items()],
    )


def health_from_diagnostics(message: DiagnosticArray, name: str) -> dict[str, str]:
    """Read the keys and values of the status of this name. Raises KeyError where it is missing."""
    for status in message.status:
        if status.name == name:
            return {pair.key: pair.value for pair in status.values}
    raise KeyError(f"no status {name}")


def report_from_status(status: DiagnosticStatus) -> tuple[str, str, dict[str, str]]:
    """Read level (`OK`, `WARN`, `ERROR`, `STALE` or its number), sentence, keys and values."""
    level = _NAMES.get(status.level, str(status.level[0]))
    return level, str(status.message), {pair.key: pair.value for pair in status.values}


def _text(value: object) -> str:
    if value is None:
        return NOT_KNOWN
    return f"{value:.3f}" if isinstance(value, float) else str(value)
