"""identify_node under every fault, one after the other: it lives on and nothing wrong comes out.

After each fault the next good frame is solved. At the end of each test every attitude that was
published belongs to a good frame and is the right one.
"""

import array

import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from ros_helpers import (
    IdentifyClient,
    array_from_quaternion,
    frame_of,
    new_header,
    open_bench,
    stamp_ns,
)
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.point_cloud import Centroids, cloud_from_centroids
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS

GOOD = paper_maps((1,))[0]
QUEUE_DEPTH = next(p.default for p in IDENTIFY_PARAMETERS if p.name == "queue_depth")
XY = GOOD.xy_px
PARAMETERS = {"parity": "mirrored", "deadline_ms": 200.0, "keep_up": False}
#: A published attitude may be off by this much, about any axis.
LIMIT_RAD = np.radians(0.1)


class Trial:
    """A node and a client that remembers which frames are good."""

    def __init__(self, bench, parameters=()):
        self.bench = bench
        self.client = IdentifyClient(bench)
        self.node = bench.start(IdentifyNode, {**PARAMETERS, **dict(parameters)})
        self.client.connect()
        self.good = {}

    @property
    def rejected(self):
        return self.node.rejected

    def good_frame(self, header=None):
        frame = frame_of(XY, header or new_header())
        self.good[stamp_ns(frame.header)] = GOOD.pose.rotation
        return frame

    def recover(self):
        """Send a good frame, which must be solved."""
        outcome = self.client.send(self.good_frame())
        assert outcome.status == "SOLVED", outcome.values
        return outcome

    def fault(self, frame):
        """Send a frame without a solution and a good one; return the first's outcome."""
        self.client.send(frame)
        self.recover()
        outcome = self.client.gathered(frame)
        assert outcome.status != "SOLVED", outcome.values
        assert outcome.attitude is None
        return outcome

    def check(self):
        """Hold every attitude that was published against the truth of its frame."""
        assert self.client.attitudes.messages
        for message in self.client.attitudes.messages:
            truth = self.good[stamp_ns(message.header)]
            found = Rotation.from_quat(array_from_quaternion(message))
            assert (Rotation.from_matrix(truth).inv() * found).magnitude() < LIMIT_RAD


@pytest.fixture(scope="module")
def shared():
    with open_bench() as bench:
        yield Trial(bench)


@pytest.fixture
def trial(shared):
    """The node of all tests here that need no parameters of their own."""
    yield shared
    shared.recover()
    shared.check()


def cloud(**changes):
    message = frame_of(XY)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def field(index, **changes):
    message = frame_of(XY)
    for name, value in changes.items():
        setattr(message.fields[index], name, value)
    return message


# ---- frames ----------------------------------------------------------------------------------

MALFORMED = {
    "no fields": lambda: cloud(fields=[]),
    "no y": lambda: cloud(fields=frame_of(XY).fields[:1]),
    "x twice": lambda: field(1, name="x"),
    "no datatype": lambda: field(0, datatype=0),
    "wild datatype": lambda: field(1, datatype=255),
    "two values": lambda: field(0, datatype=7, count=2),
    "wild count": lambda: field(1, count=2**32 - 1),
    "wild offset": lambda: field(1, offset=2**32 - 1),
    "offset past the step": lambda: field(1, offset=9),
    "two rows": lambda: cloud(height=2),
    "wild height": lambda: cloud(height=2**32 - 1),
    "wild width": lambda: cloud(width=2**32 - 1),
    "wild step": lambda: cloud(point_step=2**32 - 1),
    "no step": lambda: cloud(point_step=0),
    "no data": lambda: cloud(data=array.array("B")),
    "a byte short": lambda: cloud(data=frame_of(XY).data[:-1]),
    "a byte long": lambda: cloud(data=frame_of(XY).data + array.array("B", [0])),
    "unprintable name": lambda: field(0, name="x\n\x1b[31m", datatype=0),
    "long name": lambda: field(0, name="x" * 10_000, datatype=0),
}


@pytest.mark.parametrize("kind", MALFORMED)
def test_malformed_cloud(trial, kind):
    before = trial.rejected["malformed_cloud"]
    frame = MALFORMED[kind]()
    frame.header = new_header()
    outcome = trial.fault(frame)
    assert outcome.status == "BAD_INPUT"
    assert trial.rejected["malformed_cloud"] == before + 1
    reason = outcome.values["reason"]
    assert reason.isprintable()
    assert len(reason) < 300


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -50.0, 1e30, -1e300, 1.7e308])
def test_impossible_values_among_good_ones_are_left_out_and_counted(trial, value):
    before = trial.rejected["ignored_centroids"]
    frame = frame_of(np.concatenate([[[value, 100.0], [100.0, value]], XY]))
    trial.good[stamp_ns(frame.header)] = GOOD.pose.rotation
    outcome = trial.client.send(frame)
    assert (outcome.status, outcome.values["ignored"]) == ("SOLVED", "2")
    assert trial.rejected["ignored_centroids"] == before + 2


@pytest.mark.parametrize("value", [np.nan, np.inf, -50.0, 1e30])
def test_frame_of_impossible_values_only(trial, value):
    before = trial.rejected["bad_centroids"]
    assert trial.fault(frame_of(np.full((10, 2), value))).status == "BAD_INPUT"
    assert trial.rejected["bad_centroids"] == before + 1


def test_more_centroids_than_allowed(trial):
    before = trial.rejected["surplus_centroids"]
    xy = np.random.default_rng(1).uniform(0, 512, (5_000, 2))
    assert trial.fault(frame_of(xy)).status in {"TIMEOUT", "NO_MATCH"}
    assert trial.rejected["surplus_centroids"] == before + 4_000


ALONG = np.linspace(5.0, 500.0, 30)[:, None]
STRUCTURED = {
    "empty": np.empty((0, 2)),
    "one centroid many times": np.full((30, 2), 100.0),
    "two centroids many times": np.repeat([[100.0, 200.0], [300.0, 50.0]], 15, axis=0),
    "a good frame's first star many times": np.repeat(XY[:1], 30, axis=0),
    "a column": np.hstack([np.full_like(ALONG, 256.0), ALONG]),
    "a row": np.hstack([ALONG, np.full_like(ALONG, 17.0)]),
    "a diagonal": np.hstack([ALONG, 511 - ALONG]),
    "uneven along a line": np.hstack([ALONG**2 / 512, 0.3 * ALONG**2 / 512 + 40]),
}


@pytest.mark.parametrize("kind", STRUCTURED)
def test_centroids_that_show_no_sky_are_not_solved(trial, kind):
    """They are frames as any others: the solution says why, nothing is rejected."""
    before = trial.rejected.copy()
    status = trial.fault(frame_of(STRUCTURED[kind])).status
    assert status in {"NO_MATCH", "TIMEOUT", "TOO_FEW_STARS"}
    assert trial.rejected == before


def test_good_frame_with_every_centroid_twice_is_solved_right_or_not_at_all(trial):
    frame = frame_of(np.repeat(XY, 2, axis=0))
    trial.good[stamp_ns(frame.header)] = GOOD.pose.rotation
    trial.client.send(frame)


@pytest.mark.parametrize("intensity", [
    np.where(np.arange(30) % 2 == 0, 1e300, 1.0), np.where(np.arange(30) == 0, 1e30, 1.0),
    np.full(30, np.nan), np.full(30, -1.0), np.zeros(30),
], ids=["absurd", "one outlier", "NaN", "negative", "zero"])
def test_absurd_intensities_make_no_solution_of_noise(trial, intensity):
    xy = np.random.default_rng(7).uniform(0, 512, (30, 2))
    with np.errstate(over="ignore"):
        trial.fault(cloud_from_centroids(Centroids(xy, intensity), new_header()))


# ---- stamps ----------------------------------------------------------------------------------


def header_at(sec, nanosec=0):
    header = Header(frame_id="camera")
    header.stamp.sec, header.stamp.nanosec = sec, nanosec
    return header


@pytest.mark.parametrize("header", [
    header_at(0), header_at(-5), header_at(-2**31), header_at(2**31 - 1, 999_999_999),
    header_at(7, 2**32 - 1),
], ids=["zero", "negative", "lowest", "highest", "four seconds of nanoseconds"])
def test_any_stamp_is_answered_under_that_stamp(trial, header):
    outcome = trial.client.send(trial.good_frame(header))
    assert outcome.status == "SOLVED"
    assert outcome.attitude.header.stamp == header.stamp


def test_stamps_out_of_order_are_each_answered(trial):
    for sec in (900, 500, 700, -100, 800):
        assert trial.client.send(trial.good_frame(header_at(sec, 1))).status == "SOLVED"


def test_repeated_stamp_is_answered_each_time(trial):
    frame = trial.good_frame(header_at(901, 5))
    for n in range(1, 4):
        trial.client.publish(frame)
        trial.bench.until(
            lambda n=n: len(trial.client.attitudes.at(stamp_ns(frame.header))) == n, "answer"
        )


# ---- publishers ------------------------------------------------------------------------------


def test_publishers_come_and_go(trial):
    """Of either reliability; the node hears each of them, and its own publisher in between."""
    client, first = trial.client, trial.client.centroids
    reliabilities = (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)
    for reliability in reliabilities * 2:
        other = trial.bench.connected_outbox(PointCloud2, "centroids", reliability)
        frame = trial.good_frame()
        other.publish(frame)
        assert client.outcome(frame).status == "SOLVED"
        trial.bench.probe.destroy_publisher(other.publisher)
        trial.bench.until(lambda: first.n_subscribers, "subscriber to centroids")
        trial.recover()


def test_subscribers_come_and_go(trial):
    for _ in range(3):
        late = trial.bench.inbox(PointCloud2, "identified_stars")
        trial.bench.until(lambda late=late: late.n_publishers, "publisher of identified_stars")
        trial.recover()
        trial.bench.until(lambda late=late: late.messages, "stars")
        trial.bench.probe.destroy_subscription(
            next(s for s in reversed(list(trial.bench.probe.subscriptions))
                 if s.topic_name.endswith("identified_stars"))
        )
        trial.recover()


def test_burst_of_500_frames(trial):
    """What does not fit into the queues is lost, oldest first; the last frames are answered."""
    frames = [trial.good_frame() for _ in range(500)]
    before = len(trial.client.solutions.messages)
    for frame in frames:
        trial.client.publish(frame)
    assert trial.client.outcome(frames[-1]).status == "SOLVED"
    answered = [stamp_ns(m.header) for m in trial.client.solutions.messages[before:]]
    assert answered == sorted(set(answered))
    assert len(answered) >= QUEUE_DEPTH


# ---- cameras ---------------------------------------------------------------------------------


@pytest.fixture
def info_trial():
    """A node that takes its camera from camera_info; `infos` publishes it."""
    with open_bench() as bench:
        result = Trial(bench, {"use_camera_info": True, "camera_info_wait_ms": 200.0})
        result.infos = bench.connected_outbox(CameraInfo, "camera_info")
        yield result
        result.check()


def with_info(trial, frame, **changes):
    """Publish a frame's camera_info, changed, and then the frame; return its outcome."""
    info = info_from_camera(GOOD.camera, frame.header)
    for name, value in changes.items():
        setattr(info, name, value)
    trial.infos.publish(info)
    return trial.client.send(frame)


def test_camera_infos_that_cannot_be_used_one_after_the_other(info_trial):
    nan, k = float("nan"), info_from_camera(GOOD.camera, Header()).k
    faults = [
        {"k": np.zeros(9)}, {"k": np.full(9, nan)}, {"k": np.full(9, np.inf)}, {"k": -k},
        {"k": np.where(np.arange(9) == 2, 1e300, k)}, {"k": np.where(np.arange(9) == 1, 3.0, k)},
        {"k": np.where(np.arange(9) == 4, 1e-300, k)}, {"width": 0}, {"height": 2**32 - 1},
        {"d": [nan] * 5}, {"d": [1e300] * 5}, {"d": [0.1] * 77},
        {"d": [0.1] * 5, "distortion_model": "none such"},
    ]
    for n, fault in enumerate(faults, start=1):
        frame = frame_of(XY)
        # Where an earlier camera_info holds, the frame may be solved with that: rightly.
        info_trial.good[stamp_ns(frame.header)] = GOOD.pose.rotation
        with_info(info_trial, frame, **fault)
        assert info_trial.rejected["camera_info"] == n, fault
        assert with_info(info_trial, info_trial.good_frame()).status == "SOLVED", fault


def test_camera_info_that_changes_with_each_frame(info_trial):
    """Each frame is held against its own camera: a wrong one gives no solution or a right one."""
    k = info_from_camera(GOOD.camera, Header()).k
    for factor in (1.0, 1.3, 1.001, 0.5, 1.0, 3.0, 1.0):
        scaled = np.where(np.isin(np.arange(9), [0, 4]), k * factor, k)
        status = with_info(info_trial, info_trial.good_frame(), k=scaled).status
        if abs(factor - 1) < 0.01:
            assert status == "SOLVED"


# ---- clock -----------------------------------------------------------------------------------


def test_clock_that_jumps_backward():
    with open_bench() as bench:
        trial = Trial(bench, {"use_sim_time": True})
        clock = bench.connected_outbox(Clock, "/clock")
        taken = bench.count_calls(
            next(s for s in trial.node.subscriptions if s.topic_name == "/clock")
        )
        for n, sec in enumerate((1_000, 1_001, 500, 0, 2_000, 1), start=1):
            message = Clock()
            message.clock.sec = sec
            clock.publish(message)
            bench.until(lambda n=n: len(taken) == n, "clock")
            assert trial.node.get_clock().now().nanoseconds == sec * 10**9
            assert trial.client.send(trial.good_frame(header_at(sec, 3))).status == "SOLVED"
            trial.fault(cloud(header=header_at(sec, 4), point_step=0))
        trial.check()
