"""Bursts, drops, and several cameras in one graph."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from ros_helpers import (
    PAPER_CAMERA,
    IdentifyClient,
    frame_of,
    health_from_diagnostics,
    new_header,
    open_bench,
    stamp_ns,
)
from sensor_msgs.msg import CameraInfo, PointCloud2

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.listening import DropCounter

MAPS = dict(enumerate(paper_maps(), start=1))
MAPS_12 = {"parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False}


# ---- counting --------------------------------------------------------------------------------


def counted(*sequences, n_publishers=1):
    counter = DropCounter()
    counter.on_publishers(n_publishers)
    for sequence in sequences:
        counter.on_message(sequence)
    return counter.n_dropped


@pytest.mark.parametrize(("sequences", "n_dropped"), [
    ((), 0), ((7, 8, 9), 0), ((7, 9), 1), ((1, 11, 12, 20), 16),
    ((7, 7), 0), ((50, 1, 2), 0), ((50, 1, 3), 1), ((None, None), 0), ((7, None, 9), 1),
])
def test_gaps_in_the_sequence_are_drops(sequences, n_dropped):
    assert counted(*sequences) == n_dropped


def test_sequences_of_several_publishers_cannot_be_told_apart():
    assert counted(7, 100, 8, 101, n_publishers=2) == 0


def test_another_publisher_starts_anew():
    counter = DropCounter()
    counter.on_publishers(1)
    counter.on_message(7)
    counter.on_publishers(0)
    counter.on_publishers(1)
    counter.on_message(500)
    assert counter.n_dropped == 0


# ---- bursts ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT]
)
def test_the_newest_frames_of_a_burst_are_kept_and_the_others_counted(reliability):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, {**MAPS_12, "queue_depth": 4})
        client.connect(reliability)
        assert client.send(frame_of(MAPS[1].xy_px)).status == "SOLVED"
        before = len(client.solutions.messages)
        burst = [frame_of(MAPS[1].xy_px) for _ in range(100)]
        for frame in burst:
            client.publish(frame)
        assert client.outcome(burst[-1]).status == "SOLVED"
        answered = [stamp_ns(m.header) for m in client.solutions.messages[before:]]
        assert answered == [stamp_ns(frame.header) for frame in burst[-len(answered):]]
        assert len(answered) == 4
        assert bench.node._intake.n_dropped == 96


def test_frames_that_wait_for_their_camera_are_bounded_and_counted():
    parameters = {
        **MAPS_12, "queue_depth": 3, "use_camera_info": True, "camera_info_wait_ms": 10_000.0,
    }
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, parameters)
        client.connect()
        infos = bench.connected_outbox(CameraInfo, "camera_info")
        taken, frames = bench.calls_of("centroids"), [frame_of(MAPS[1].xy_px) for _ in range(5)]
        for i, frame in enumerate(frames, start=1):
            client.publish(frame)
            bench.until(lambda i=i: len(taken) == i, "frame taken by the node")
        infos.publish(info_from_camera(MAPS[1].camera, frames[0].header))
        assert [client.outcome(frame).status for frame in frames[2:]] == ["SOLVED"] * 3
        assert len(client.solutions.messages) == 3
        assert bench.node._intake.n_dropped == 2


def test_latency_counts_from_reception():
    """Frames that lay in the queue are later than their own solve takes."""
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, MAPS_12)
        client.connect()
        client.send(frame_of(MAPS[1].xy_px))
        burst = [frame_of(MAPS[1].xy_px) for _ in range(10)]
        for frame in burst:
            client.publish(frame)
        client.outcome(burst[-1])
        records = [record for _, record in bench.node._journal.health._frames][1:]
    assert records[-1].latency_ms > records[0].latency_ms
    assert records[-1].latency_ms < 10_000


# ---- several cameras -------------------------------------------------------------------------


def test_two_cameras_in_one_graph_by_namespace():
    cameras = {"left": (1, {}), "right": (7, {
        "fov_deg": 20.0, "width_px": 1024, "height_px": 1024,
    })}
    with open_bench() as bench:
        reports = bench.inbox(DiagnosticArray, "/diagnostics")
        answers, frames, names = {}, {}, []
        for side, (number, parameters) in cameras.items():
            answers[side] = bench.inbox(DiagnosticArray, f"{side}/solution")
            node = bench._add(IdentifyNode(
                context=bench.context, namespace=f"{bench.namespace}/{side}",
                parameter_overrides=[
                    Parameter(name, value=value)
                    for name, value in {**PAPER_CAMERA, **MAPS_12, **parameters}.items()
                ],
            ))
            names.append(f"{node.get_fully_qualified_name()[1:]}: health")
            frames[side] = frame_of(MAPS[number].xy_px, new_header(side))
        bench.until(lambda: all(a.n_publishers for a in answers.values()), "both nodes")
        for side, frame in frames.items():
            bench.connected_outbox(PointCloud2, f"{side}/centroids").publish(frame)
        bench.until(lambda: all(a.messages for a in answers.values()), "both answers")
        for side, matched in (("left", "15"), ("right", "41")):
            (message,) = answers[side].messages
            assert message.header.frame_id == side
            values = values_from_diagnostics(message)
            assert (values["status"], values["matched"]) == ("SOLVED", matched)
        bench.until(
            lambda: {s.name for m in reports.messages for s in m.status} >= set(names),
            "health of both nodes",
        )
        last = {name: [m for m in reports.messages if m.status[0].name == name] for name in names}
        assert all(health_from_diagnostics(last[name][-1], name)["version"] for name in names)
    assert np.all([len(a.messages) == 1 for a in answers.values()])
