"""SIGINT and SIGTERM end a node with exit code 0 and without a word, whenever they come.

The two are handled alike, so that most rows have one of them, in turn. Each row is a process; what
differs from another one in little but the node or the signal is slow.
"""

from signal import SIGINT, SIGTERM

import numpy as np
import pytest
from processes import (
    IDENTIFY,
    MAPS,
    REPLAY,
    assert_ended_well,
    assert_refused,
    ended,
    running,
    started,
    wait_for_line,
)
from ros_helpers import frame_of, new_header, open_bench, stamp_ns
from sensor_msgs.msg import PointCloud2
from test_processes import identify_process

from star_tracker.maps.star_map import paper_maps

pytestmark = pytest.mark.usefixtures("solver_compiled")
EITHER = pytest.mark.parametrize(
    "number", [SIGINT, pytest.param(SIGTERM, marks=pytest.mark.slow)]
)

# ---- during the start and the end ------------------------------------------------------------

#: A node that signals itself when a function is first entered, and does then what `rest` says.
SIGNAL_AT = """
import os, sys, threading
from star_tracker.nodes import {module} as node_module
def signalled(owner, name):
    before = getattr(owner, name)
    def wrapper(*args, **kwargs):
        setattr(owner, name, before)
        os.kill(os.getpid(), {number})
        {rest}
        return before(*args, **kwargs)
    setattr(owner, name, wrapper)
signalled({owner}, {name!r})
sys.exit(node_module.main())
"""
GOES_ON = "pass"
#: What is told the paper's camera.
HAVE_A_CAMERA = ("identify_node", "camera_to_attitude")
#: As one that compiles, which looks at nothing else for as long as it takes.
IS_BUSY = "threading.Event().wait()"


def slow_row(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(("module", "owner", "name", "number", "rest"), [
    slow_row("identify_node", "node_module", "declare", SIGINT, GOES_ON),
    # Most of the start.
    ("identify_node", "node_module.SolverSetup", "build_database", SIGINT, GOES_ON),
    slow_row("identify_node", "node_module.SolverSetup", "build_database", SIGTERM, GOES_ON),
    slow_row("identify_node", "node_module.IdentifyNode", "_apply", SIGTERM, GOES_ON),
    ("identify_node", "node_module.IdentifyNode", "_apply", SIGINT, IS_BUSY),
    slow_row("identify_node", "node_module", "Outputs", SIGINT, GOES_ON),
    slow_row("identify_node", "node_module", "Intake", SIGTERM, GOES_ON),
    slow_row("centroid_node", "node_module", "Worker", SIGTERM, GOES_ON),
    slow_row("centroid_node", "node_module", "exercise_detector", SIGINT, GOES_ON),
    slow_row("camera_to_attitude", "node_module", "CentroidNode", SIGINT, GOES_ON),
    slow_row("sky_image_node", "node_module", "declare", SIGTERM, GOES_ON),
    ("replay_node", "node_module", "declare", SIGTERM, GOES_ON),
    slow_row("replay_node", "node_module", "paper_maps", SIGINT, GOES_ON),
])
def test_signal_at_any_stage_of_the_start(module, owner, name, number, rest):
    script = SIGNAL_AT.format(
        module=module, owner=owner, name=name, number=int(number), rest=rest
    )
    with started(["-c", script], "/start", MAPS if module in HAVE_A_CAMERA else ()) as process:
        assert_ended_well(*ended(process))


@EITHER
def test_second_signal_while_the_node_ends(number):
    """As below launch when Ctrl-C is typed."""
    script = SIGNAL_AT.format(
        module="identify_node", owner="node_module.IdentifyNode", name="destroy_node",
        number=int(number), rest=GOES_ON,
    )
    with started(["-c", script], "/twice", MAPS) as process:
        wait_for_line(process, "ready: ")
        process.send_signal(number)
        assert_ended_well(*ended(process))


#: A console command that signals itself when it comes to import numpy, as heavy as it gets.
SIGNAL_AT_IMPORT = """
import os, sys
from star_tracker.nodes import running
class Finder:
    def find_spec(name, path=None, target=None):
        if name == "numpy":
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Finder)
sys.exit(running.{node}())
"""


@pytest.mark.parametrize(("node", "number"), [("identify_node", SIGINT), ("replay_node", SIGTERM)])
def test_signal_to_a_console_command_that_still_imports(node, number):
    script = SIGNAL_AT_IMPORT.format(node=node, number=int(number))
    with started(["-c", script]) as process:
        assert ended(process) == (0, "")


#: A node that is refused, with a signal's handler that shuts down just when the node does.
SHUT_DOWN_TWICE = """
import sys
import rclpy
from star_tracker.nodes import replay_node
def both():
    context = rclpy.get_default_context()
    context.shutdown()
    context.shutdown()
rclpy.try_shutdown = both
sys.exit(replay_node.main(["--ros-args", "-p", "rate_hz:=-1.0"]))
"""


def test_shutdown_that_comes_second():
    with started(["-c", SHUT_DOWN_TWICE]) as process:
        assert_refused(*ended(process), "rate_hz")


# ---- at work ---------------------------------------------------------------------------------

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


def test_shutdown_between_two_waits():
    with started(["-c", SHUTDOWN_WITHOUT_WAKING], "/between", MAPS) as process:
        assert_ended_well(*ended(process))


@pytest.mark.parametrize(("module", "line", "number"), [
    slow_row(IDENTIFY, "ready: ", SIGINT), (IDENTIFY, "ready: ", SIGTERM),
    slow_row(REPLAY, "waiting for a subscriber", SIGINT),
])
def test_signal_to_an_idle_node(module, line, number):
    with running(module, "/idle") as process:
        wait_for_line(process, line)
        process.send_signal(number)
        assert_ended_well(*ended(process))


@EITHER
def test_signal_while_frames_are_solved(number):
    """Frames of noise, of which each takes long, are still waiting when the signal comes."""
    noise = np.random.default_rng(1).uniform(0, 512, (60, 2))
    with identify_process() as (process, client):
        good = frame_of(paper_maps((1,))[0].xy_px, new_header())
        client.publish(good)
        client.bench.until(lambda: client.attitudes.at(stamp_ns(good.header)), "attitude")
        for _ in range(40):
            client.publish(frame_of(noise))
        before = len(client.solutions.messages)
        client.bench.until(lambda: len(client.solutions.messages) > before, "one answer")
        process.send_signal(number)
        assert_ended_well(*ended(process))


@pytest.mark.slow
def test_signal_while_frames_are_sent():
    with open_bench() as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        arguments = ["-p", "loop:=true", "-p", "publish_camera_info:=false"]
        with running(REPLAY, bench.namespace, arguments) as process:
            bench.until(lambda: frames.messages, "first frame")
            process.send_signal(SIGTERM)
            assert_ended_well(*ended(process))
