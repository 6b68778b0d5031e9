"""The two nodes as processes of their own, as users start them: how they work together."""

import os
import re
import signal
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from processes import (
    IDENTIFY,
    MAPS,
    REPLAY,
    SIZE,
    assert_ended_well,
    assert_refused,
    ended,
    running,
    start,
    started,
    wait_for_line,
)
from rclpy.qos import ReliabilityPolicy
from ros_helpers import IdentifyClient, frame_of, open_bench, stamp_ns
from sensor_msgs.msg import PointCloud2
from waiting import longest_s

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.solution import values_from_diagnostics

pytestmark = pytest.mark.usefixtures("solver_compiled")


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
    with open_bench() as bench:
        client = IdentifyClient(bench)
        with running(IDENTIFY, bench.namespace, [*MAPS, *arguments]) as process:
            shake_hands(client)
            yield process, client


@pytest.mark.slow
def test_replay_through_identify_solves_all_maps_and_ends():
    with open_bench() as bench:
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
    assert_ended_well(code, messages)
    assert "8 frames sent" in messages


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


@pytest.mark.slow
def test_integer_for_a_float_on_the_command_line_is_accepted():
    with running(IDENTIFY, "/integer", [*SIZE, "-p", "fov_deg:=20"]) as process:
        wait_for_line(process, "camera 20 deg over 512 px")


@pytest.mark.slow
def test_what_does_not_reach_the_node_is_named_at_its_start(tmp_path):
    path = tmp_path / "other.yaml"
    path.write_text("star_tracker:\n  ros__parameters:\n    fov_deg: 20.0\n", encoding="utf-8")
    arguments = ["--params-file", str(path), "-p", "fov:=20.0", *MAPS]
    with running(IDENTIFY, "/deaf", arguments) as process:
        messages = wait_for_line(process, "ready: ")
        messages += wait_for_line(process, "other.yaml") if str(path) not in messages else ""
    assert "there is no parameter fov: fov_deg?" in messages
    sentence = f"parameter file {path} has nothing for /deaf/identify_node, only for /star_tracker"
    assert sentence in messages


def test_console_command_passes_arguments_and_exit_code_on():
    """What else is refused, and in which words, is in `test_refusals.py`."""
    script = "import sys; from star_tracker.nodes import running; sys.exit(running.{}())"
    arguments = ["-p", "rate_hz:=-1.0"]
    with started(["-c", script.format("replay_node")], "", arguments) as process:
        assert_refused(*ended(process), "rate_hz")


# ---- the cache of features -------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache of features for the processes of a test; compiled code stays in the usual one."""
    usual = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    monkeypatch.setenv("NUMBA_CACHE_DIR", os.environ.get("NUMBA_CACHE_DIR") or usual)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "star_tracker"


def said_until_ready(namespace):
    """Start identify_node, end it when it is ready and return its messages."""
    with running(IDENTIFY, namespace, MAPS) as process:
        messages = wait_for_line(process, "ready: ")
        process.send_signal(signal.SIGTERM)
        code, rest = ended(process)
    assert_ended_well(code, messages + rest)
    return messages + rest


@pytest.mark.slow
def test_damaged_cache_is_named_in_one_line_and_built_again(cache):
    assert "feature file" not in said_until_ready("/first")
    (path,) = cache.glob("features-*.npz")
    whole = path.read_bytes()
    path.write_bytes(whole[:-1000])
    messages = said_until_ready("/second")
    (line,) = (line for line in messages.splitlines() if "feature file" in line)
    assert re.search(rf"\[WARN\].* feature file {re.escape(str(path))} cannot be read: .+; "
                     r"it is built again$", line)
    assert path.read_bytes() == whole
    assert "feature file" not in said_until_ready("/third")


@pytest.mark.slow
def test_cache_that_cannot_be_written_is_named_in_one_line(cache):
    cache.touch()  # a file where the folder has to be
    messages = said_until_ready("/unsaved")
    lines = [line for line in messages.splitlines() if "feature file" in line]
    assert len(lines) == 1, messages
    assert f"feature file {cache}/features-" in lines[0]
    assert "cannot be saved: " in lines[0]


@pytest.mark.slow
def test_two_nodes_start_with_one_empty_cache(cache):
    both = [start(["-m", IDENTIFY], f"/twin{n}", MAPS) for n in (1, 2)]
    try:
        for process in both:
            wait_for_line(process, "ready: ")
            process.send_signal(signal.SIGTERM)
        for process in both:
            assert_ended_well(*ended(process))
    finally:
        for process in both:
            process.kill()
            process.communicate(timeout=longest_s())
    assert len(list(cache.iterdir())) == 1
