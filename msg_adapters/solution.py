"""Solution -> DiagnosticArray of one status and back to plain key-value text; and for plots."""

from typing import TYPE_CHECKING

from star_tracker.identification.labels import StarState
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.message_class import message_class
from star_tracker.solution import Solution, Status

if TYPE_CHECKING:
    import diagnostic_msgs.msg
    import std_msgs.msg

#: What `quality_from_solution` may give.
QUALITIES = ("log10_false_alarms", "matched", "rms_px", "solve_ms")


def diagnostics_from_solution(
    solution: Solution, name: str, header: "std_msgs.msg.Header", hint: str = ""
) -> "diagnostic_msgs.msg.DiagnosticArray":
    """Write how a frame ended: level OK where solved, ERROR for bad input, else WARN.

    A hint says what would solve a frame that was not solved, where that is known.
    """
    status_class = message_class("diagnostic_msgs/DiagnosticStatus")
    pair_class = message_class("diagnostic_msgs/KeyValue")

    level = {Status.SOLVED: status_class.OK, Status.BAD_INPUT: status_class.ERROR}.get(
        solution.status, status_class.WARN
    )
    state = solution.identification.state
    values = {
        "status": solution.status.value,
        "reason": solution.reason,
        "hint": hint,
        "method": solution.method,
        "mode": solution.mode,
        "parity": solution.parity,
        "matched": _n_matched(solution),
        "displaced": int((state == StarState.DISPLACED).sum()),
        "total": len(state),
        "ignored": solution.n_ignored,
        "wrong_probability": f"{solution.wrong_probability:.3g}",
        "log10_false_alarms": f"{solution.log10_false_alarms:.2f}",
        "rms_px": f"{solution.rms_px:.4f}",
        "hypotheses": solution.n_hypotheses,
        "solve_ms": f"{solution.solve_ms:.3f}",
    }
    status = status_class(
        level=level, name=name, message=f"{solution.status.value}: {solution.reason}",
        values=[pair_class(key=key, value=str(value)) for key, value in values.items()],
    )
    return message_class("diagnostic_msgs/DiagnosticArray")(header=header, status=[status])


def quality_from_solution(solution: Solution) -> dict[str, "std_msgs.msg.Float64"]:
    """Write the numbers of a frame by their names, each as a message that any plot can draw.

    A frame without an attitude has matched 0 stars and has its time; there is no residual and no
    evidence of it.
    """
    values = {"matched": _n_matched(solution), "solve_ms": solution.solve_ms}
    if solution.attitude is not None:
        values["rms_px"] = solution.rms_px
        values["log10_false_alarms"] = solution.log10_false_alarms
    number_class = message_class("std_msgs/Float64")
    return {name: number_class(data=float(value)) for name, value in values.items()}


def _n_matched(solution: Solution) -> int:
    return int((solution.identification.state == StarState.IDENTIFIED).sum())


def values_from_diagnostics(message: "diagnostic_msgs.msg.DiagnosticArray") -> dict[str, str]:
    """Read the keys and values of the message's only status."""
    return {pair.key: pair.value for pair in message.status[0].values}


def name_from_diagnostics(message: "diagnostic_msgs.msg.DiagnosticArray") -> str:
    """Read the name of the node that answers. Raises MessageError where there is no status."""
    if not message.status:
        raise MessageError("DiagnosticArray holds no status: a solution has one")
    return str(message.status[0].name)
