"""identify_node tracks: prediction, its switch, its reset, and what a jump of the clock does."""

from contextlib import contextmanager

import numpy as np
import pytest
from ros_helpers import IdentifyClient, frame_of, open_bench
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.maps.simulation import Condition, synthetic_field
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.optics.camera import Camera

CAMERA = Camera.from_fov(12, 512, 512)
SKY = StarCatalog.paper()
START = rotation_from_boresight(1.9, 0.2, 0.3)


@contextmanager
def tracking_client(parameters=None):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        client.reset = bench.probe.create_client(
            Trigger, f"{bench.namespace}/identify_node/reset"
        )
        bench.start(IdentifyNode, {
            "deadline_ms": 60_000.0, "keep_up": False, **(parameters or {}),
        })
        yield client.connect()


def frame_at(seconds, deg_per_s=1.0):
    """Return the frame of a camera that turns, as seen at a time."""
    turn = Rotation.from_rotvec(np.radians([deg_per_s * seconds, 0, 0])).as_matrix()
    field = synthetic_field(
        SKY, CAMERA, START @ turn, np.random.default_rng(round(1000 * seconds)),
        Condition(noise_px=0.5, false_stars=0.5),
    )
    header = Header(frame_id="camera")
    header.stamp.sec, header.stamp.nanosec = int(seconds), round(seconds % 1 * 1e9)
    return frame_of(field.xy_px, header)


def modes(client, times, **options):
    values = [client.send(frame_at(t, **options)).values for t in times]
    assert {v["status"] for v in values} == {"SOLVED"}
    return [v["mode"] for v in values]


LOST, TRACKED = "lost_in_space", "tracking"


def test_frames_after_a_fix_are_tracked():
    with tracking_client() as client:
        assert modes(client, [10.0, 10.1, 10.2, 10.3]) == [LOST, TRACKED, TRACKED, TRACKED]


def test_mode_lost_in_space_never_tracks():
    with tracking_client({"mode": LOST}) as client:
        assert modes(client, [10.0, 10.1, 10.2]) == [LOST] * 3


def test_an_old_fix_is_not_used():
    with tracking_client({"tracking_max_age_s": 0.5}) as client:
        assert modes(client, [10.0, 10.4, 11.0], deg_per_s=0.1) == [LOST, TRACKED, LOST]


def test_reset_forgets():
    with tracking_client() as client:
        assert modes(client, [10.0, 10.1]) == [LOST, TRACKED]
        bench = client.bench
        bench.until(client.reset.service_is_ready, "service reset")
        answer = client.reset.call_async(Trigger.Request())
        answer.add_done_callback(lambda _: bench._event())
        bench.until(answer.done, "answer of reset")
        assert answer.result().success
        assert modes(client, [10.2, 10.3]) == [LOST, TRACKED]


def test_a_stamp_that_goes_back_forgets():
    with tracking_client() as client:
        assert modes(client, [10.0, 10.1]) == [LOST, TRACKED]
        assert modes(client, [5.0, 5.1]) == [LOST, TRACKED]


def test_a_jump_is_found_in_the_same_frame():
    with tracking_client() as client:
        assert modes(client, [10.0, 10.1]) == [LOST, TRACKED]
        # 90 deg away, seen 0.1 s later.
        far = frame_at(100.0)
        far.header.stamp.sec, far.header.stamp.nanosec = 10, 200_000_000
        values = client.send(far).values
        assert (values["status"], values["mode"]) == ("SOLVED", LOST)


@pytest.mark.parametrize("stamp", [0, 7])
def test_frames_that_all_have_one_stamp_are_solved(stamp):
    with tracking_client() as client:
        for seconds in (10.0, 10.1, 10.2):
            frame = frame_at(seconds)
            frame.header.stamp.sec = stamp
            frame.header.stamp.nanosec = 0
            client.publish(frame)
        client.bench.until(lambda: len(client.solutions.messages) == 3, "three answers")
    values = [{p.key: p.value for p in m.status[0].values} for m in client.solutions.messages]
    assert [v["status"] for v in values] == ["SOLVED"] * 3
