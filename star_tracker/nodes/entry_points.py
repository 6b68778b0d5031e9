"""The nodes as console commands, which a signal ends quietly from the first moment.

A node's imports take half a second, and several on a busy machine. Until they are done and the
node takes signals itself (`running.py`), there is nothing that would have to be cleaned up.
"""

import os
import signal
import sys
from importlib import import_module
from typing import Any


def identify_node() -> int:
    """Run identify_node; return the exit code."""
    return _run("identify_node")


def replay_node() -> int:
    """Run replay_node; return the exit code."""
    return _run("replay_node")


def _run(module: str) -> int:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    main: Any = import_module(f"star_tracker.nodes.{module}").main
    return int(main(sys.argv))


def _end(*_: Any) -> None:
    os._exit(0)
