"""identify_node while its solver is compiled: in the graph, answering, losing nothing."""

import threading
from contextlib import contextmanager

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import Parameter
from ros_helpers import IdentifyClient, frame_of, open_bench, stamp_ns

from star_tracker.compiled import CacheState
from star_tracker.maps.star_map import paper_maps
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify import health, starting
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.identify_node import IdentifyNode

MAPS = dict(enumerate(paper_maps(), start=1))
MAPS_12 = {"parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False}


@pytest.fixture
def gate(monkeypatch):
    """The solver is not built before this is set."""
    gate, build = threading.Event(), SolverSetup.build_database

    def wait_and_build(self):
        assert gate.wait(60)
        return build(self)

    monkeypatch.setattr(SolverSetup, "build_database", wait_and_build)
    monkeypatch.setattr(health, "_PERIOD_S", 0.05)
    yield gate
    gate.set()


@contextmanager
def starting_client(gate, parameters=None):
    """A node that waits for the gate, and a client that is connected to it."""
    with open_bench() as bench:
        client = IdentifyClient(bench)
        client.reports = bench.inbox(DiagnosticArray, "/diagnostics")
        node = bench.start(IdentifyNode, {**MAPS_12, **(parameters or {})})
        bench.node = None  # connect, without waiting until it is ready
        client.connect()
        bench.node = node
        try:
            yield client
        finally:
            gate.set()


def send_taken(client, frames):
    """Publish frames and wait until the node has taken each."""
    taken = client.bench.calls_of("centroids")
    for n, frame in enumerate(frames, start=1):
        client.publish(frame)
        client.bench.until(lambda n=n: len(taken) == n, "frame taken by the node")


def last_status(client):
    client.reports.messages.clear()
    client.bench.until(lambda: client.reports.messages, "report in /diagnostics")
    return client.reports.messages[-1].status[0]


def test_the_node_stands_in_the_graph_and_answers_before_it_is_ready(gate):
    with starting_client(gate) as client:
        bench = client.bench
        assert not bench.node.ready
        ask = bench.probe.create_client(
            GetParameters, f"{bench.namespace}/identify_node/get_parameters"
        )
        bench.until(ask.service_is_ready, "service get_parameters")
        reply = ask.call_async(GetParameters.Request(names=["parity"]))
        reply.add_done_callback(lambda _: bench._event())
        bench.until(reply.done, "answer of get_parameters")
        assert reply.result().values[0].string_value == "mirrored"
        status = last_status(client)
        assert status.level == DiagnosticStatus.WARN
        assert status.message.startswith("starting: ")
        assert status.message.endswith(" s")
        gate.set()
        bench.until_ready()
        idle, reports = "no frame in the last 10 s", client.reports.messages
        # A report of before may still be on its way.
        bench.until(lambda: reports[-1].status[0].message == idle, "report of a ready node")


def test_frames_that_come_before_the_node_is_ready_are_answered_in_order(gate):
    with starting_client(gate) as client:
        frames = [frame_of(MAPS[number].xy_px) for number in (1, 2, 3)]
        send_taken(client, frames)
        assert not client.solutions.messages
        gate.set()
        assert [client.outcome(frame).status for frame in frames] == ["SOLVED"] * 3
        stamps = [stamp_ns(message.header) for message in client.solutions.messages]
        assert stamps == [stamp_ns(frame.header) for frame in frames]
        assert client.bench.node._intake.n_dropped == 0


def test_frames_beyond_the_queue_are_counted(gate):
    with starting_client(gate, {"queue_depth": 2}) as client:
        frames = [frame_of(MAPS[1].xy_px) for _ in range(5)]
        send_taken(client, frames)
        gate.set()
        assert [client.outcome(frame).status for frame in frames[3:]] == ["SOLVED"] * 2
        assert client.bench.node._intake.n_dropped == 3


def test_a_parameter_that_changes_meanwhile_holds_when_the_node_is_ready(gate):
    with starting_client(gate, {"parity": "normal"}) as client:
        node = client.bench.node
        for name, value in (("parity", "mirrored"), ("epoch", 2010.0)):
            assert node.set_parameters([Parameter(name, value=value)])[0].successful
        gate.set()
        client.bench.until_ready()
        assert node._solver.catalog.epoch == 2010.0
        assert client.send(frame_of(MAPS[1].xy_px)).status == "SOLVED"


def test_a_parameter_that_cannot_be_is_refused_meanwhile(gate):
    with starting_client(gate) as client:
        (result,) = client.bench.node.set_parameters([Parameter("fov_deg", value=500.0)])
    assert not result.successful


def test_a_solver_that_cannot_be_built_ends_the_node_with_one_line(monkeypatch):
    def fail(_):
        raise ValueError("star catalogue /x cannot be read: empty")

    monkeypatch.setattr(SolverSetup, "build_database", fail)
    with open_bench() as bench:
        bench.start(IdentifyNode, MAPS_12)
        with pytest.raises(ParameterError, match=r"^star catalogue /x cannot be read: empty$"):
            bench.until_ready()


def test_an_error_of_the_builder_itself_is_not_hidden(monkeypatch):
    def fail(_):
        raise RuntimeError("out of order")

    monkeypatch.setattr(SolverSetup, "build_database", fail)
    with open_bench() as bench:
        bench.start(IdentifyNode, MAPS_12)
        with pytest.raises(RuntimeError, match=r"^out of order$"):
            bench.until_ready()


# ---- what the log says -----------------------------------------------------------------------


def lines_of_a_start(capfd, monkeypatch, tmp_path, *, writable, warm):
    """Start a node with such a cache of compiled code; return what it logs, without the head."""
    state = CacheState(tmp_path, writable=writable, warm=warm)
    monkeypatch.setattr(starting, "cache_state", lambda: state)
    monkeypatch.setattr(starting, "mark_warm", lambda: None)
    with open_bench() as bench:
        bench.start(IdentifyNode, MAPS_12)
        bench.until_ready()
    lines = capfd.readouterr().err.splitlines()
    return [line.split("identify_node]: ")[1] for line in lines]


def test_a_warm_start_says_only_that_it_is_ready(capfd, monkeypatch, tmp_path):
    (line,) = lines_of_a_start(capfd, monkeypatch, tmp_path, writable=True, warm=True)
    assert line.startswith("ready: paper, 4908 stars")


def test_a_read_only_cache_that_is_warm_is_no_trouble(capfd, monkeypatch, tmp_path):
    (line,) = lines_of_a_start(capfd, monkeypatch, tmp_path, writable=False, warm=True)
    assert line.startswith("ready: ")


def test_a_cold_start_says_what_takes_so_long_and_ends_with_ready(capfd, monkeypatch, tmp_path):
    first, last = lines_of_a_start(capfd, monkeypatch, tmp_path, writable=True, warm=False)
    assert first == (
        "compiling the solver: about a minute, the first time on this machine "
        "(`star_tracker compile` does it ahead)"
    )
    assert last.startswith("ready: ")


def test_a_cache_that_cannot_be_written_is_named_once(capfd, monkeypatch, tmp_path):
    first, last = lines_of_a_start(capfd, monkeypatch, tmp_path, writable=False, warm=False)
    assert first == (
        f"compiled code cannot be kept in {tmp_path}: every start compiles for about a minute; "
        "set NUMBA_CACHE_DIR to a folder that can be written"
    )
    assert last.startswith("ready: ")


def test_a_start_that_takes_long_says_so_now_and_then(gate, capfd, monkeypatch, tmp_path):
    state = CacheState(tmp_path, writable=True, warm=False)
    monkeypatch.setattr(starting, "cache_state", lambda: state)
    monkeypatch.setattr(starting, "mark_warm", lambda: None)
    monkeypatch.setattr(starting, "_PERIOD_S", 0.05)
    with starting_client(gate) as client:
        said = client.bench.count_calls(client.bench.node._starting._timer)
        client.bench.until(lambda: len(said) >= 2, "two lines of progress")
        gate.set()
        client.bench.until_ready()
    lines = capfd.readouterr().err.splitlines()
    assert sum("starting: compiling the solver, " in line for line in lines) >= 2
    assert "ready: " in lines[-1]
