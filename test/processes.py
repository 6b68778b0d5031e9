"""Nodes and commands as processes of their own, as users start them."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from waiting import last_resort, longest_s

ROOT = Path(__file__).resolve().parents[1]
IDENTIFY, REPLAY = "star_tracker.nodes.identify_node", "star_tracker.nodes.replay_node"
#: Arguments of an identify_node for the paper's maps that may take its time.
#: The size of an image, without which identify_node does not start.
SIZE = ["-p", "width_px:=512", "-p", "height_px:=512"]
#: The paper's camera of 12 deg.
MAPS = [
    *SIZE, "-p", "fov_deg:=12.0", "-p", "fov_tolerance_percent:=0.0", "-p", "catalog:=paper",
    "-p", "parity:=mirrored", "-p", "deadline_ms:=60000.0", "-p", "keep_up:=false",
]
#: What of rcl's own says that a command line cannot be read; no node can keep it back.
_RCL_LINE = "[rcl]: Failed to parse global arguments"


def environment(**changes):
    """Return the environment of a process that imports the sources under test."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path, **changes}


def popen(*arguments, **options):
    """Start this Python with arguments, its messages in a pipe."""
    options = {"stderr": subprocess.PIPE, "text": True, "env": environment(), **options}
    return subprocess.Popen([sys.executable, *map(str, arguments)], **options)


def completed(*arguments, **options):
    """Run this Python with arguments to its end; return code, output and messages."""
    options = {"capture_output": True, "text": True, "env": environment(), **options}
    return subprocess.run(
        [sys.executable, *map(str, arguments)], timeout=longest_s(), check=False, **options
    )


def start(command, namespace="", arguments=()):
    """Start Python with a command line and ROS arguments, its messages in a pipe."""
    if namespace:
        arguments = ["-r", f"__ns:={namespace}", *arguments]
    return popen(*command, "--ros-args", *arguments)


@contextmanager
def started(command, namespace="", arguments=()):
    """A process as of `start`, killed at the end should it still run."""
    with start(command, namespace, arguments) as process:
        try:
            yield process
        finally:
            process.kill()


def running(module, namespace, arguments=()):
    """A node in a process, killed at the end should it still run.

    identify_node is told the size of an image, unless the arguments say it.
    """
    if module == IDENTIFY and not any("width_px" in str(word) for word in arguments):
        arguments = [*SIZE, *arguments]
    return started(["-m", module], namespace, arguments)


def wait_for_line(process, text):
    """Return the process's messages up to the line that holds `text`; it must come."""
    lines = []
    with last_resort(process.kill):
        for line in process.stderr:
            lines.append(line)
            if text in line:
                return "".join(lines)
    pytest.fail(f"no line with {text!r} in:\n{''.join(lines)}")


def ended(process):
    """Wait for a process; return its exit code and the rest of its messages."""
    _, messages = process.communicate(timeout=longest_s())
    return process.returncode, messages


def run_to_the_end(module, *arguments):
    """Run a node that is expected to end by itself; return exit code and messages."""
    with running(module, "", arguments) as process:
        return ended(process)


def lines_of_the_node(messages):
    """Return the messages' lines without those that come from below the node."""
    return [line for line in messages.splitlines() if not line.endswith(_RCL_LINE)]


def assert_ended_well(code, messages):
    """Exit code 0, and nothing that looks like an accident."""
    assert code == 0, messages
    assert "Traceback" not in messages
    assert "FATAL" not in messages


def assert_refused(code, messages, text):
    """Exit code 2 and one line, which holds `text`."""
    assert code == 2, messages
    assert len(lines_of_the_node(messages)) == 1, messages
    assert "[FATAL]" in messages
    assert str(text) in messages
    assert "Traceback" not in messages
