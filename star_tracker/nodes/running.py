"""How every node of this package starts and ends."""

import signal
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node

from star_tracker.nodes.parameters import ParameterError

_LONGEST_WAIT_S = 0.5
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run(name: str, make: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Spin the node that `make` returns until it is told to stop; return the exit code.

    SIGINT, SIGTERM and a shutdown by the node itself end with 0, a configuration that cannot be
    used with 2 and one line that says what to change.
    """
    # rclpy's handlers shut the context down and then call ours, so that both signals also end
    # what does not look at the context: a node's constructor, above all while it compiles.
    for number in _SIGNALS:
        signal.signal(number, _interrupt_once)
    try:
        try:
            rclpy.init(args=args)
            # Made at once: a signal in the middle of its making would end in a traceback.
            executor = SingleThreadedExecutor()
        except (RCLError, UnknownROSArgsError) as error:
            return _refuse(name, error)
        return _spin(name, make, executor)
    except KeyboardInterrupt:  # before the node or at its end
        return 0


def _interrupt_once(*_: Any) -> None:
    """Interrupt what runs, but not the ending that follows: Ctrl-C below launch comes twice."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _spin(name: str, make: Callable[[], Node], executor: SingleThreadedExecutor) -> int:
    """Make the node, spin it to its end and clean up; return the exit code."""
    node: Node | None = None
    try:
        node = make()
        executor.add_node(node)
        # In bounded waits: rclpy's handler of SIGTERM wakes the executor before it shuts the
        # context down, and an executor that waits again by then would wait for ever.
        while rclpy.ok():
            executor.spin_once(timeout_sec=_LONGEST_WAIT_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except ParameterError as error:
        return _refuse(name, error)
    except RCLError:
        # A signal during the start takes the context away from under the node's constructor.
        if rclpy.ok():
            raise
        return 0
    finally:
        if node is not None:
            node.destroy_node()
        _shut_down()
    return 0


def _shut_down() -> None:
    """Shut down rclpy, unless its handler of signals has done so or does so just now."""
    try:
        rclpy.try_shutdown()
    except RCLError:
        # The handler's thread came between rclpy's question and its act.
        if rclpy.ok():
            raise


def _refuse(name: str, error: Exception) -> int:
    """Say in one line what cannot be used; return the exit code."""
    get_logger(name).fatal(" ".join(str(error).split()))
    return 2
