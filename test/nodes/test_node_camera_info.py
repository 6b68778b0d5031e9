"""identify_node and camera_info: publishers of any QoS, early and late; frames of any stamp."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from rclpy.clock import ClockType
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_helpers import IdentifyClient, frame_of, new_header, open_bench
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.nodes.identify_node import IdentifyNode

MAP1 = paper_maps((1,))[0]
PARAMETERS = {
    "parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False, "use_camera_info": True,
}
#: No test waits so long: a frame that is answered under it did not wait for a CameraInfo.
PATIENT = {**PARAMETERS, "camera_info_wait_ms": 10_000.0}
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
EVERY_QOS = [
    (RELIABLE, LATCHED), (BEST_EFFORT, VOLATILE),
    *(pytest.param(*qos, marks=pytest.mark.slow)
      for qos in ((RELIABLE, VOLATILE), (BEST_EFFORT, LATCHED))),
]
#: The one that gives late subscribers what it has sent: a best-effort one sends nothing again.
KEEPS = (RELIABLE, LATCHED)


@contextmanager
def info_client(parameters=PARAMETERS):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, parameters)
        yield client.connect()


def info(header=None, camera=MAP1.camera):
    return info_from_camera(camera, header or new_header())


def map1(header=None):
    return frame_of(MAP1.xy_px, header)


def at(sec):
    header = Header(frame_id="camera")
    header.stamp.sec = sec
    return header


# ---- publishers of every QoS -----------------------------------------------------------------


@pytest.mark.parametrize(("reliability", "durability"), EVERY_QOS)
def test_publisher_that_is_there_before_the_node(reliability, durability):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        infos = bench.outbox(CameraInfo, "camera_info", reliability, durability)
        if (reliability, durability) == KEEPS:
            infos.publish(info())  # once, before anybody listens
        bench.start(IdentifyNode, PATIENT)
        client.connect()
        if (reliability, durability) != KEEPS:
            bench.until(lambda: infos.n_subscribers, "subscriber to camera_info")
            infos.publish(info())
        assert client.send(map1()).status == "SOLVED"


@pytest.mark.parametrize(("reliability", "durability"), EVERY_QOS)
def test_publisher_that_comes_after_the_node(reliability, durability):
    with info_client(PATIENT) as client:
        infos = client.bench.outbox(CameraInfo, "camera_info", reliability, durability)
        if (reliability, durability) == KEEPS:
            infos.publish(info())  # at once: the node hears of the publisher later
        else:
            client.bench.until(lambda: infos.n_subscribers, "subscriber to camera_info")
            infos.publish(info())
        assert client.send(map1()).status == "SOLVED"


def test_an_ordinary_camera_that_comes_after_the_node_has_no_reason_to_warn(capfd):
    with info_client(PATIENT) as client:
        client.bench.connected_outbox(CameraInfo, "camera_info").publish(info())
        assert client.send(map1()).status == "SOLVED"
    assert "incompatible" not in capfd.readouterr().err


@pytest.mark.parametrize("reliability", [RELIABLE, BEST_EFFORT])
def test_latched_publisher_that_takes_the_place_of_one_that_is_not(reliability):
    with info_client(PATIENT) as client:
        bench = client.bench
        first = bench.connected_outbox(CameraInfo, "camera_info", reliability, VOLATILE)
        bench.probe.destroy_publisher(first.publisher)
        second = bench.outbox(CameraInfo, "camera_info", RELIABLE, LATCHED)
        second.publish(info())
        assert client.send(map1()).status == "SOLVED"


@pytest.mark.parametrize("volatile_first", [True, False])
def test_latched_publisher_beside_one_that_is_not(volatile_first):
    """Two cameras share the topic, each serves its own frames."""
    with open_bench() as bench:
        client = IdentifyClient(bench)
        latched = bench.outbox(CameraInfo, "camera_info", RELIABLE, LATCHED)
        latched.publish(info(new_header("left")))
        other = info(new_header("right"), MAP1.camera.scaled(0.5))
        if volatile_first:
            bench.outbox(CameraInfo, "camera_info", RELIABLE, VOLATILE)
        bench.start(IdentifyNode, PATIENT)
        client.connect()
        volatile = bench.connected_outbox(CameraInfo, "camera_info", RELIABLE, VOLATILE)
        volatile.publish(other)
        assert client.send(map1(new_header("left"))).status == "SOLVED"


def test_latched_publisher_that_comes_beside_one_that_is_not():
    with info_client(PATIENT) as client:
        bench = client.bench
        volatile = bench.connected_outbox(CameraInfo, "camera_info", RELIABLE, VOLATILE)
        volatile.publish(info(new_header("right"), MAP1.camera.scaled(0.5)))
        latched = bench.outbox(CameraInfo, "camera_info", RELIABLE, LATCHED)
        latched.publish(info(new_header("left")))  # at once: the node hears of it later
        assert client.send(map1(new_header("left"))).status == "SOLVED"


def test_a_camera_that_is_not_announced_holds_up_no_other_one():
    with info_client({**PATIENT, "camera_info_wait_ms": 10_000.0}) as client:
        infos = client.bench.connected_outbox(CameraInfo, "camera_info")
        for name in ("left", "right"):
            infos.publish(info(new_header(name)))
        client.publish(map1(new_header("unknown")))
        # Answered while the one before it waits, longer than any test does.
        assert client.send(map1(new_header("left"))).status == "SOLVED"
        assert client.bench.node._intake.n_waiting == 1


# ---- which camera, and why none --------------------------------------------------------------


@pytest.mark.parametrize("header", [at(0), at(500)], ids=["stamp zero", "older"])
def test_the_only_camera_serves_frames_of_any_stamp_and_the_log_says_so_once(header, capfd):
    with info_client() as client:
        client.bench.connected_outbox(CameraInfo, "camera_info").publish(info(at(1000)))
        for _ in range(3):
            client.publish(map1(header))
        client.bench.until(lambda: len(client.attitudes.messages) == 3, "three attitudes")
    lines = [line for line in capfd.readouterr().err.splitlines() if "younger" in line]
    zero = ", whose stamp is 0" if header.stamp.sec == 0 else ""
    (line,) = lines
    assert line.endswith(
        f"the only camera announced on {client.bench.namespace}/camera_info is younger than the "
        f"frame{zero}: it is taken for frames of any stamp"
    )


def reason_of(client, header=None):
    outcome = client.send(map1(header))
    assert outcome.status == "BAD_INPUT"
    return outcome.values["reason"]


def test_reason_where_nobody_publishes():
    with info_client() as client:
        topic = f"{client.bench.namespace}/camera_info"
        assert reason_of(client) == (
            f"no CameraInfo was received on {topic}, nothing is published there: publish the "
            "camera there, or set use_camera_info to false"
        )


def test_reason_where_nothing_was_sent():
    with info_client() as client:
        client.bench.connected_outbox(CameraInfo, "camera_info")
        assert "its publisher has sent none yet" in reason_of(client)


def test_reason_where_what_was_sent_cannot_be_used():
    with info_client() as client:
        useless = info()
        useless.k = np.zeros(9)
        infos = client.bench.connected_outbox(CameraInfo, "camera_info")
        heard = client.bench.calls_of("camera_info")
        infos.publish(useless)
        client.bench.until(lambda: heard, "camera_info heard by the node")
        assert reason_of(client) == (
            f"no CameraInfo of {client.bench.namespace}/camera_info can be used, the last one: "
            "CameraInfo: K is zero: the camera is not calibrated, calibrate it"
        )


@pytest.mark.parametrize(("header", "zero"), [(at(0), ", whose stamp is 0"), (at(500), "")])
def test_reason_where_all_are_younger_and_differ(header, zero):
    with info_client() as client:
        infos = client.bench.connected_outbox(CameraInfo, "camera_info")
        heard = client.bench.calls_of("camera_info")
        infos.publish(info(at(1000)))
        infos.publish(info(at(1001), replace(MAP1.camera, width_px=600)))
        client.bench.until(lambda: len(heard) == 2, "camera_info heard by the node")
        assert reason_of(client, header) == (
            f"all CameraInfo of {client.bench.namespace}/camera_info are younger than this frame"
            f"{zero}, and not of one camera: publish each with its frame's stamp or an earlier one"
        )


# ---- waiting ---------------------------------------------------------------------------------


def timer_of(client):
    return client.bench.node._intake._timer


def test_no_timer_runs_while_no_frame_waits():
    with info_client() as client:
        node = client.bench.node
        running = [t for t in node.timers if not t.is_canceled()]
        assert [t.timer_period_ns for t in running] == [1_000_000_000]  # of /diagnostics
        reason_of(client)  # waited for a CameraInfo that did not come
        assert timer_of(client).is_canceled()


def test_a_frame_waits_by_a_steady_clock():
    """With use_sim_time and no /clock the ROS time stands still for ever."""
    with info_client({**PARAMETERS, "use_sim_time": True}) as client:
        assert timer_of(client).clock.clock_type == ClockType.STEADY_TIME
        assert "no CameraInfo was received" in reason_of(client)


def test_an_info_for_the_first_frame_only_delays_the_second_and_no_more():
    with info_client() as client:
        infos = client.bench.connected_outbox(CameraInfo, "camera_info")
        waited = client.bench.count_calls(timer_of(client))
        first = map1()
        infos.publish(info(first.header))
        assert client.send(first).status == "SOLVED"
        assert len(waited) == 0
        for _ in range(5):
            assert client.send(map1()).status == "SOLVED"
            # For as long as it may take, and once more for what came meanwhile.
            assert len(waited) == 2


# ---- fields and rectified images -------------------------------------------------------------


def test_fields_of_other_names_are_read():
    frame = map1()
    frame.fields[0].name, frame.fields[1].name = "u", "v"
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, {**PARAMETERS, "use_camera_info": False, "x_field": "u",
                                   "y_field": "v"})
        assert client.connect().send(frame).status == "SOLVED"


def test_of_a_rectified_image_p_holds():
    """K and the distortion are those of the raw image: with them nothing is solved."""
    message = info()
    message.k = [0.8 * value for value in message.k]
    message.k[8] = 1.0
    message.d = [-0.2, 0.0, 0.0, 0.0, 0.0]
    with info_client({**PATIENT, "rectified": True}) as client:
        client.bench.connected_outbox(CameraInfo, "camera_info").publish(message)
        outcome = client.send(map1())
    assert outcome.status == "SOLVED"
    assert float(outcome.values["rms_px"]) < 0.05
