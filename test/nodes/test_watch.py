"""`star_tracker watch` with real nodes: in one process, and as users start it."""

import json
import os
import pty
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from processes import environment, popen
from rclpy.executors import ExternalShutdownException
from ros_helpers import frame_of, new_header, open_bench
from sensor_msgs.msg import Imu, PointCloud2
from waiting import last_resort, longest_s

from star_tracker.commands import cli
from star_tracker.maps.simulation import uniform_noise
from star_tracker.maps.star_map import paper_maps
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify import health
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.watch import node as watch_module
from star_tracker.nodes.watch.node import WatchNode
from star_tracker.nodes.watch.view import pose_degrees

MAP1 = paper_maps((1,))[0]
FULL_SPEED = {"parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False}


class Notes:
    """An output that keeps what it is told."""

    def __init__(self):
        self.frames, self.enough = [], False

    def __call__(self, _, frames, __):
        self.frames += frames
        return not self.enough


@contextmanager
def watched_bench(monkeypatch, parameters=None):
    """A bench with an identify_node, connected frames, and a node that watches."""
    monkeypatch.setattr(health, "_PERIOD_S", 0.1)
    monkeypatch.setattr(watch_module, "_LOOK_S", 0.05)
    with open_bench() as bench:
        node = bench.start(IdentifyNode, {**FULL_SPEED, **(parameters or {})})
        bench.notes = Notes()
        bench.watch = bench._add(WatchNode(bench.notes, bench.namespace, context=bench.context))
        publishers = (node._outputs._solution, node._outputs._imu, node._outputs._stars)
        # No event of the probe tells of that; the outlook is called with each look of the watch.
        bench.count_calls(next(iter(bench.watch.timers)))
        bench.until(lambda: all(p.get_subscription_count() for p in publishers), "watching node")
        bench.centroids = bench.connected_outbox(PointCloud2, "centroids")
        yield bench


def send(bench, xy_px):
    """Send a frame and return what the watching node tells of it."""
    before = len(bench.notes.frames)
    bench.centroids.publish(frame_of(xy_px))
    bench.until(lambda: len(bench.notes.frames) > before, "frame that is told of")
    return bench.notes.frames[-1]


def test_a_real_node_is_watched(monkeypatch):
    with watched_bench(monkeypatch) as bench:
        solved = send(bench, MAP1.xy_px)
        unsolved = send(bench, uniform_noise(MAP1.camera, 8, np.random.default_rng(1)))
        reports = bench.watch.watched.reports
        bench.until(
            lambda: "health" in reports and reports["health"].values["frames"] == "2", "report"
        )
        assert reports["health"].values["solved"] == "1"
        assert bench.watch.watched.full_name == bench.node.get_fully_qualified_name()
    assert (solved.status, unsolved.status) == ("SOLVED", "NO_MATCH")
    boresight_deg, (x, y, z) = pose_degrees(solved.attitude)
    assert boresight_deg == pytest.approx([109.6, 34.5, 90.0], abs=1e-3)
    # A star tracker knows its roll less well than where it points.
    assert 0 < max(x, y) < z < 60
    np.testing.assert_array_equal(solved.stars["star_number"], MAP1.star_number)
    assert unsolved.attitude is None
    assert len(unsolved.stars) == 8
    assert bench.watch.watched.trouble == ""


def test_messages_that_cannot_be_read_are_told_and_outlived(monkeypatch):
    with watched_bench(monkeypatch) as bench:
        watched, troubles = bench.watch.watched, []
        for kind, topic, message in (
            (PointCloud2, "identified_stars", PointCloud2(height=2, width=1)),
            (DiagnosticArray, "solution", DiagnosticArray()),
            (Imu, "imu", null_imu()),
        ):
            outbox = bench.connected_outbox(kind, topic)
            watched.trouble = ""
            outbox.publish(message)
            bench.until(lambda: watched.trouble, f"trouble with {topic}")
            troubles.append(watched.trouble)
        assert send(bench, MAP1.xy_px).status == "SOLVED"
    assert troubles == [
        "identified_stars: PointCloud2 has points, but point_step is 0: give their size in bytes",
        "solution: DiagnosticArray holds no status: a solution has one",
        "imu: the orientation is no rotation",
    ]


def null_imu():
    message = Imu(header=new_header())
    message.orientation.w = 0.0
    return message


def test_the_node_ends_when_the_output_has_enough(monkeypatch):
    with watched_bench(monkeypatch) as bench:
        bench.notes.enough = True
        with pytest.raises(ExternalShutdownException):
            bench.until(lambda: False, "end")


def test_a_namespace_that_cannot_be_one_is_refused():
    with open_bench() as bench, pytest.raises(ParameterError, match="--namespace a b is not"):
        WatchNode(Notes(), "a b", context=bench.context)


# ---- as a process ----------------------------------------------------------------------------


def start_watch(*arguments, **options):
    return popen(
        "-m", "star_tracker.commands.cli", "watch", *arguments,
        **{"stdout": subprocess.PIPE, "env": environment(COLUMNS="80"), **options},
    )


@pytest.fixture(scope="module")
def namespace(solver_compiled):
    """The namespace of an identify_node and a replay_node without end, two processes, at work."""
    name = f"/watch_{os.getpid()}"
    nodes = [
        popen(
            "-m", f"star_tracker.nodes.{node}", "--ros-args", "-r", f"__ns:={name}",
            *(word for p in parameters for word in ("-p", p)), stderr=subprocess.DEVNULL,
        )
        for node, parameters in (
            ("identify_node", [
                "use_camera_info:=true", "parity:=mirrored", "deadline_ms:=60000.0",
                "keep_up:=false",
            ]),
            ("replay_node", ["loop:=true", "rate_hz:=20.0"]),
        )
    ]
    try:
        yield name
    finally:
        for node in nodes:
            node.terminate()
        for node in nodes:
            node.wait(timeout=longest_s())


def ended(process):
    out, err = process.communicate(timeout=longest_s())
    return process.returncode, out, err


def test_once_prints_one_record_of_a_running_node(namespace):
    process = start_watch("--namespace", namespace, "--once", "--json", "--timeout-s", "600")
    code, out, err = ended(process)
    assert (code, err) == (0, "")
    (line,) = out.splitlines()
    record = json.loads(line)
    assert record["node"] == f"{namespace}/identify_node"
    assert record["status"] == "SOLVED"
    assert record["total"] == len(record["stars"])
    assert record["health"]["level"]
    assert len(record["sigma_camera_xyz_arcsec"]) == 3


@pytest.mark.slow
def test_lines_end_with_ctrl_c_and_exit_code_0(namespace):
    process = start_watch("--namespace", namespace, "--json")
    lines = [process.stdout.readline() for _ in range(10)]
    for _ in range(2):  # as below launch, or where a user is impatient
        process.send_signal(signal.SIGINT)
    code, _, err = ended(process)
    assert (code, err) == (0, "")
    assert all(json.loads(line)["status"] == "SOLVED" for line in lines)


@pytest.mark.slow
def test_a_reader_that_has_enough_ends_it_without_a_word(namespace):
    process = start_watch("--namespace", namespace, "--json")
    json.loads(process.stdout.readline())
    process.stdout.close()
    assert process.wait(timeout=longest_s()) == cli.NO_READER
    assert process.stderr.read() == ""
    process.stderr.close()


@pytest.mark.slow
def test_screen_ends_with_ctrl_c_from_the_terminal(namespace):
    here, there = pty.openpty()
    process = start_watch(
        "--namespace", namespace, stdin=there, stdout=there, stderr=there, process_group=0,
    )
    os.close(there)
    shown = b""
    with last_resort(process.kill):
        while b"RA, Dec, roll" not in shown:
            shown += os.read(here, 65536)
        process.send_signal(signal.SIGINT)
        shown += rest_of(here)
    os.close(here)
    assert process.wait(timeout=longest_s()) == 0
    assert b"Traceback" not in shown
    # The terminal is as it was, with its cursor, and the last view stands there.
    assert b"identify_node" in shown.split(b"\x1b[?1049l")[1]
    assert b"\x1b[?25h" in shown


def rest_of(terminal):
    """Read until the process closes its end: Linux gives an error then."""
    shown = b""
    while True:
        try:
            more = os.read(terminal, 65536)
        except OSError:
            return shown
        shown += more


# ---- what cannot be used ---------------------------------------------------------------------


def refusal(capsys, *arguments):
    assert cli.main(["watch", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(("arguments", "text"), [
    (["--stars", "0"], "--stars must be a number greater than 0"),
    (["--timeout-s", "nan"], "--timeout-s must be a number greater than 0"),
    ([], "standard output is no terminal: add --once or --json"),
])
def test_an_option_that_cannot_be_used_is_refused(capsys, arguments, text):
    assert text in refusal(capsys, *arguments)


def test_without_ros_it_says_so(capsys, monkeypatch):
    monkeypatch.delitem(sys.modules, "star_tracker.nodes.watch.node")
    monkeypatch.delattr("star_tracker.nodes.watch.node")
    for name in [name for name in sys.modules if name.split(".")[0] == "rclpy"]:
        monkeypatch.setitem(sys.modules, name, None)
    text = refusal(capsys)
    assert text.startswith("star_tracker watch: this command needs ROS 2, which cannot be")


def test_nothing_heard_gives_exit_code_2_and_the_remedy():
    code, out, err = ended(start_watch("--namespace", "/nobody", "--once", "--timeout-s", "1"))
    assert (code, out) == (2, "")
    assert err == (
        "star_tracker watch: nothing heard of an identify_node in namespace /nobody within 1 s: "
        "start one, or give its --namespace and ROS_DOMAIN_ID\n"
    )
