"""The two nodes as processes of their own, as users start them: how they work and how they end."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from ros_helpers import IdentifyClient, frame_of, open_bench, stamp_ns
from sensor_msgs.msg import PointCloud2

import star_tracker
from msg_adapters.solution import values_from_diagnostics
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.tracker import StarTracker

#: The longest that a process may take to start or to end; a slow machine needs seconds.
TIMEOUT_S = 30.0
IDENTIFY, REPLAY = "star_tracker.nodes.identify_node", "star_tracker.nodes.replay_node"
MAPS = [
    "-p", "parity:=mirrored", "-p", "deadline_ms:=60000.0", "-p", "keep_up:=false",
]


@pytest.fixture(scope="module", autouse=True)
def compiled_code():
    """Compile the solver, or load it, before any node does: the first time takes half a minute."""
    StarTracker(FeatureDatabase.build(StarCatalog.paper()), Camera.from_fov(12, 512, 512))


def start(command, namespace="", arguments=()):
    """Start a Python process that imports the package under test, its messages in a pipe."""
    root = Path(star_tracker.__file__).parent.parent
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    if namespace:
        arguments = ["-r", f"__ns:={namespace}", *arguments]
    return subprocess.Popen(
        [sys.executable, *command, "--ros-args", *arguments],
        stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path},
    )


@contextmanager
def running(module, namespace, arguments=()):
    """A node in a process, killed at the end should it still run."""
    with start(["-m", module], namespace, arguments) as process:
        try:
            yield process
        finally:
            process.kill()


def run_to_the_end(module, *arguments):
    """Run a node that is expected to end by itself; return exit code and messages."""
    with running(module, "", arguments) as process:
        _, messages = process.communicate(timeout=TIMEOUT_S)
    return process.returncode, messages


def wait_for_line(process, text):
    """Read the process's messages until one holds `text`; a process that hangs is killed."""
    watchdog = threading.Timer(TIMEOUT_S, process.kill)
    watchdog.start()
    try:
        lines = []
        for line in process.stderr:
            lines.append(line)
            if text in line:
                return
    finally:
        watchdog.cancel()
    pytest.fail(f"no line with {text!r} in:\n{''.join(lines)}")


def ended(process):
    """Wait for a process; return its exit code and the rest of its messages."""
    _, messages = process.communicate(timeout=TIMEOUT_S)
    return process.returncode, messages


# ---- both nodes together ---------------------------------------------------------------------


def shake_hands(client):
    """Send empty frames until one is answered: then all topics are connected both ways.

    What a process publishes before its end of the connection is made is lost without a trace, so
    that one attempt would not do.
    """
    client.connect()
    empty = np.empty((0, 2))
    timer = client.bench.probe.create_timer(0.1, lambda: client.publish(frame_of(empty)))
    client.bench.until(lambda: client.solutions.messages and client.clouds.messages, "answer")
    timer.cancel()


@contextmanager
def identify_process(*arguments):
    """An identify_node in a process, and a client that talks to it."""
    with open_bench(TIMEOUT_S) as bench:
        client = IdentifyClient(bench)
        with running(IDENTIFY, bench.namespace, [*MAPS, *arguments]) as process:
            shake_hands(client)
            yield process, client


def test_replay_through_identify_solves_all_maps_and_ends():
    with open_bench(TIMEOUT_S) as bench:
        client = IdentifyClient(bench)
        arguments = [*MAPS, "-p", "use_camera_info:=true", "-p", "camera_info_wait_ms:=10000.0"]
        with running(IDENTIFY, bench.namespace, arguments):
            bench.until(
                lambda: all(i.n_publishers for i in (client.solutions, client.clouds)),
                "publisher of identify_node",
            )
            with running(REPLAY, bench.namespace, ["-p", "rate_hz:=50.0"]) as replay:
                bench.until(lambda: len(client.clouds.messages) >= 8, "eighth answer")
                bench.until(lambda: len(client.solutions.messages) >= 8, "eighth solution")
                code, messages = ended(replay)
    values = [values_from_diagnostics(message) for message in client.solutions.messages]
    assert [v["status"] for v in values] == ["SOLVED"] * 8
    assert [int(v["total"]) for v in values] == [len(m.labels) for m in paper_maps()]
    stamps = [stamp_ns(message.header) for message in client.solutions.messages]
    assert stamps == sorted(stamps)
    assert code == 0, messages
    assert "8 frames sent" in messages
    assert "Traceback" not in messages


@pytest.fixture(scope="module")
def client():
    with identify_process() as (_, result):
        yield result


def test_reliable_publisher_of_another_process_is_heard(client):
    assert client.send(frame_of(paper_maps((1,))[0].xy_px)).status == "SOLVED"


def test_best_effort_publisher_that_appears_later_is_heard(client):
    late = client.bench.connected_outbox(
        PointCloud2, "centroids", ReliabilityPolicy.BEST_EFFORT
    )
    frame = frame_of(paper_maps((1,))[0].xy_px)
    late.publish(frame)
    assert client.outcome(frame).status == "SOLVED"


# ---- being told to stop ----------------------------------------------------------------------

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


@SIGNALS
def test_signal_ends_identify_node_with_exit_code_0(number):
    with identify_process() as (process, _):
        process.send_signal(number)
        code, messages = ended(process)
    assert code == 0, messages
    assert "Traceback" not in messages


@SIGNALS
def test_signal_ends_a_looping_replay_node_with_exit_code_0(number):
    with open_bench(TIMEOUT_S) as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        arguments = ["-p", "loop:=true", "-p", "publish_camera_info:=false"]
        with running(REPLAY, bench.namespace, arguments) as process:
            bench.until(lambda: frames.messages, "first frame")
            process.send_signal(number)
            code, messages = ended(process)
    assert code == 0, messages
    assert "Traceback" not in messages


@SIGNALS
def test_signal_right_after_the_start_ends_replay_node_with_exit_code_0(number):
    with running(REPLAY, "/alone") as process:
        wait_for_line(process, "waiting for a subscriber")
        process.send_signal(number)
        code, messages = ended(process)
    assert code == 0, messages
    assert "Traceback" not in messages


#: A node that is told to stop while its database is made, which is most of its start.
SIGNAL_DURING_START = """
import os, sys
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.nodes import identify_node
cached = FeatureDatabase.cached
def signal_and_load(*args, **kwargs):
    os.kill(os.getpid(), {number})
    return cached(*args, **kwargs)
FeatureDatabase.cached = signal_and_load
sys.exit(identify_node.main())
"""

#: rclpy's handler of SIGTERM wakes the executor first and then shuts the context down. An executor
#: that is back in its wait before the second step is not woken again: an idle node hung in one of
#: twelve tries. Here the second step comes alone, once a wait lasts.
SHUTDOWN_WITHOUT_WAKING = """
import sys, threading
import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from star_tracker.nodes import identify_node
entered, left = threading.Event(), threading.Event()
class WaitSet(rclpy_implementation.WaitSet):
    def wait(self, timeout_ns):
        left.clear()
        entered.set()
        super().wait(timeout_ns)
        left.set()
def shut_down_in_a_long_wait():
    entered.wait()
    while left.wait(0.05):
        entered.clear()
        entered.wait()
    rclpy.get_default_context().handle.shutdown()
rclpy_implementation.WaitSet = WaitSet
threading.Thread(target=shut_down_in_a_long_wait, daemon=True).start()
sys.exit(identify_node.main())
"""


@pytest.mark.parametrize("script", [
    SIGNAL_DURING_START.format(number=int(signal.SIGINT)),
    SIGNAL_DURING_START.format(number=int(signal.SIGTERM)),
    SHUTDOWN_WITHOUT_WAKING,
], ids=["SIGINT at the start", "SIGTERM at the start", "SIGTERM between two waits"])
def test_identify_node_ends_with_exit_code_0_whenever_it_is_told_to_stop(script):
    with start(["-c", script]) as process:
        try:
            code, messages = ended(process)
        finally:
            process.kill()
    assert code == 0, messages
    assert "Traceback" not in messages
    assert "FATAL" not in messages


# ---- what cannot be used ---------------------------------------------------------------------


@pytest.mark.parametrize(("module", "argument", "text"), [
    (IDENTIFY, "fov_deg:=500.0",
     "parameter fov_deg is 500.0: it must be a number from 0.5 to 120 deg"),
    (IDENTIFY, "fov_deg:=.nan",
     "parameter fov_deg is nan: it must be a number from 0.5 to 120 deg"),
    (IDENTIFY, "catalog:=gaia",
     "parameter catalog is 'gaia': it must be one of paper, hipparcos"),
    (REPLAY, "maps:=[9]",
     "parameter maps is [9]: it must be a list, each item a whole number from 1 to 8"),
    (REPLAY, "folder:=/nowhere", "star map /nowhere/map1.csv cannot be read"),
])
def test_bad_parameter_gives_exit_code_2_and_one_line(module, argument, text):
    code, messages = run_to_the_end(module, "-p", argument)
    assert code == 2, messages
    assert len(messages.splitlines()) == 1, messages
    assert text in messages
    assert "[FATAL]" in messages


def test_integer_for_a_float_on_the_command_line_is_accepted():
    with running(IDENTIFY, "/integer", ["-p", "fov_deg:=20"]) as process:
        wait_for_line(process, "camera 20 deg over 512 px")


#: What of rcl's own says that a command line cannot be read; no node can keep it back.
RCL_LINE = "[rcl]: Failed to parse global arguments"


def lines_of_the_node(messages):
    return [line for line in messages.splitlines() if not line.endswith(RCL_LINE)]


@pytest.mark.parametrize("content", [
    "/**:\n  ros__parameters:\n    fov_deg: [1\n",
    "/**:\n  ros__parameters:\n    fov_deg:\n",
    "/**:\n  ros__parameters:\n    pair_tolerance_px: [1, 2.5]\n",
    "fov_deg: 12.0\n",
    "\x00\x01",
], ids=["unclosed", "no value", "mixed types", "no node", "binary"])
def test_broken_parameter_file_gives_exit_code_2_and_one_line(tmp_path, content):
    path = tmp_path / "broken.yaml"
    path.write_text(content, encoding="utf-8")
    code, messages = run_to_the_end(IDENTIFY, "--params-file", str(path))
    assert code == 2, messages
    assert len(lines_of_the_node(messages)) == 1, messages
    assert str(path) in messages
    assert "[FATAL]" in messages


def test_missing_parameter_file_gives_exit_code_2_and_one_line(tmp_path):
    code, messages = run_to_the_end(IDENTIFY, "--params-file", str(tmp_path / "none.yaml"))
    assert code == 2, messages
    assert len(lines_of_the_node(messages)) == 1, messages
    assert "none.yaml" in messages


@pytest.mark.parametrize("arguments", [
    ["--no-such-option"], ["-p", "fov_deg"], ["-p", "fov_deg:="], ["--log-level", "nonsense"],
], ids=" ".join)
def test_unknown_ros_argument_gives_exit_code_2_and_one_line(arguments):
    code, messages = run_to_the_end(IDENTIFY, *arguments)
    assert code == 2, messages
    assert len(lines_of_the_node(messages)) == 1, messages
    assert arguments[-1] in messages
