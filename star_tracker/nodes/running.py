"""How every node of this package starts and ends, as a console command too.

A node's imports take half a second, and several on a busy machine. A console command takes signals
before that: what it imports with this module is light, and all else comes when a node is made.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LONGEST_WAIT_S = 0.5
#: The longest that a node takes to end after a signal, whatever it is doing.
_LONGEST_END_S = 1.0


def identify_node() -> int:
    """Run identify_node; return the exit code."""
    return _command("identify_node")


def replay_node() -> int:
    """Run replay_node; return the exit code."""
    return _command("replay_node")


def relay_node() -> int:
    """Run relay_node; return the exit code."""
    return _command("relay_node")


def centroid_node() -> int:
    """Run centroid_node; return the exit code."""
    return _command("centroid_node")


def sky_image_node() -> int:
    """Run sky_image_node; return the exit code."""
    return _command("sky_image_node")


def camera_to_attitude() -> int:
    """Run centroid_node and identify_node in one process; return the exit code."""
    return _command("camera_to_attitude")


def _command(module: str) -> int:
    """Run the node of a module, which a signal ends quietly from the first moment."""
    for number in _SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))
    main: Any = import_module(f"star_tracker.nodes.{module}").main
    return int(main(sys.argv))


def run(
    name: str, make: Callable[[], "Node | Sequence[Node]"], args: Sequence[str] | None = None
) -> int:
    """Spin the nodes that `make` returns until they are told to stop; return the exit code.

    SIGINT, SIGTERM and a shutdown by the node itself end with 0, a configuration that cannot be
    used with 2 and one line that says what to change.

    Args:
        name: of the node, for that line.
        make: makes the node, or the nodes in the order in which they end. Raises ParameterError
            for a configuration that cannot be used.
        args: the command line's, None for that of the process.
    """
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
    from rclpy.executors import SingleThreadedExecutor

    from star_tracker.nodes.declaring import unheard_files

    def make_and_warn() -> "Sequence[Node]":
        made = make()
        nodes = made if isinstance(made, Sequence) else [made]
        for sentence in unheard_files(nodes, sys.argv if args is None else args):
            nodes[0].get_logger().warning(sentence)
        return nodes

    with _ending_soon_when_told() as told:
        try:
            rclpy.init(args=args)
            executor = SingleThreadedExecutor()
        except (RCLError, UnknownROSArgsError) as error:
            return 0 if told.is_set() else _refuse(name, error)
        return _spin(name, make_and_warn, executor, told)


@contextmanager
def _ending_soon_when_told() -> Iterator[threading.Event]:
    """Take SIGINT and SIGTERM; the event tells of the first one.

    rclpy's handlers, which come on top, shut the context down, and the node ends at its next look
    at it. Nothing is raised: an exception out of nowhere is printed and lost in a callback of C,
    and one in the middle of exec() ends Python by the signal even where it is caught. What does
    not look at the context, a node that still compiles or a frame that takes long, is ended too.
    """
    told = threading.Event()
    watchdog = threading.Timer(_LONGEST_END_S, os._exit, [0])
    watchdog.daemon = True

    def on_signal(*_: Any) -> None:
        if not told.is_set():  # Ctrl-C below launch comes twice
            told.set()
            watchdog.start()

    for number in _SIGNALS:
        signal.signal(number, on_signal)
    try:
        yield told
    finally:
        watchdog.cancel()
        if told.is_set():  # Python's own end would take a second signal's default action back
            for number in _SIGNALS:
                signal.signal(number, signal.SIG_IGN)


def _spin(
    name: str, make: Callable[[], "Sequence[Node]"], executor: "SingleThreadedExecutor",
    told: threading.Event,
) -> int:
    """Make the nodes, spin them to their end and clean up; return the exit code."""
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.exceptions import NotInitializedException
    from rclpy.executors import ExternalShutdownException

    from star_tracker.nodes.declaring import ParameterError

    nodes: Sequence[Node] = ()
    try:
        nodes = make()
        for node in nodes:
            executor.add_node(node)
        # In bounded waits: rclpy's handler of SIGTERM wakes the executor before it shuts the
        # context down, and an executor that waits again by then would wait for ever.
        while rclpy.ok():
            executor.spin_once(timeout_sec=_LONGEST_WAIT_S)
    except ExternalShutdownException:
        return 0
    except ParameterError as error:
        return _refuse(name, error)
    except (RCLError, NotInitializedException):
        # A signal during the start takes the context away from under the node's constructor.
        if not told.is_set():
            raise
        return 0
    finally:
        for node in nodes:
            node.destroy_node()
        # One that is not shut down may be collected after its own parts, and prints that.
        executor.shutdown()
        _shut_down()
    return 0


def _shut_down() -> None:
    """Shut down rclpy, unless its handler of signals has done so or does so just now."""
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError

    try:
        rclpy.try_shutdown()
    except RCLError:
        # The handler's thread came between rclpy's question and its act.
        if rclpy.ok():
            raise


def _refuse(name: str, error: Exception) -> int:
    """Say in one line what cannot be used; return the exit code."""
    from rclpy.logging import get_logger

    get_logger(name).fatal(" ".join(str(error).split()))
    return 2
