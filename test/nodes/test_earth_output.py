"""What of the node tells the attitude against the Earth, and as a transform; each by itself."""

import re
import sys
from datetime import datetime, timezone
from types import ModuleType

import numpy as np
import pytest
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.node import Node
from ros_helpers import open_bench
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Header
from tf_stand_in import TFMessage

from star_tracker.attitude.attitude import Attitude
from star_tracker.earth.attitude import Fix, enu_attitude, itrs_attitude
from star_tracker.earth.rotation import EarthOrientation
from star_tracker.earth.site import Site
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.identification.labels import Identification, StarState
from star_tracker.msg_adapters.imu import earth_attitude_from_imu
from star_tracker.msg_adapters.site import fix_from_site
from star_tracker.msg_adapters.transforms import FrameRotation, rotations_from_tf, tf_from_rotation
from star_tracker.msg_adapters.velocity import vector_from_velocity
from star_tracker.nodes.identify.earth import EarthOutput, EarthParameters
from star_tracker.nodes.identify.static_frames import StaticFrames
from star_tracker.nodes.identify.transforms import Mounting, TransformOutput, TransformParameters
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, Status

SITE = Site(47.3, 8.5, 500.0)
HEADER = Header(frame_id="star_camera")
HEADER.stamp.sec = int(datetime(2024, 11, 2, 21, tzinfo=timezone.utc).timestamp())
STAMP_NS = HEADER.stamp.sec * 10**9
ENU = EarthParameters("enu", 47.3, 8.5, 500.0)
#: The camera looks along the base's z, its right is the base's y.
BASE_FROM_CAMERA = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ABOUT_CAMERA = np.diag([1e-10, 2e-10, 9e-9])


@pytest.fixture
def bench():
    with open_bench() as opened:
        yield opened


@pytest.fixture
def solution(catalog):
    """Return a frame solved by hand: nine stars near its boresight."""
    rotation = rotation_from_boresight(*np.radians([40.0, 60.0, 20.0]))
    near = np.argsort(-catalog.vectors @ rotation[:, 2])[:9]
    labels = Identification(
        near, np.full(9, StarState.IDENTIFIED, np.uint8), np.zeros(9)
    )
    return Solution(
        Status.SOLVED, "identified", labels, Attitude.from_rotation(rotation, ABOUT_CAMERA),
        told_camera=Camera.from_fov(12.0, 512, 512), focal_length_error=0.0, catalog=catalog,
    )


class Recorder:
    """What of a node transforms need; rclpy cannot carry the stand-in's messages."""

    def __init__(self):
        self.published, self.said, self.listeners = [], [], {}

    def create_publisher(self, kind, topic, depth):
        assert (kind, topic, depth) == (TFMessage, "/tf", 100)
        return self

    def publish(self, message):
        self.published.append(message)

    def create_subscription(self, kind, topic, callback, qos):
        assert kind is TFMessage
        self.listeners[topic] = callback

    def get_logger(self):
        return self

    def warning(self, sentence, **_):
        self.said.append(sentence)

    error = warning


@pytest.fixture
def recorder(monkeypatch):
    messages = ModuleType("tf2_msgs.msg")
    messages.TFMessage = TFMessage
    monkeypatch.setitem(sys.modules, "tf2_msgs", ModuleType("tf2_msgs"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", messages)
    return Recorder()


def tell_mounting(recorder):
    """Send the mounting in two steps, as robot_state_publisher does."""
    tell = recorder.listeners["/tf_static"]
    tell(tf_from_rotation(FrameRotation("base_link", "mast", BASE_FROM_CAMERA), HEADER))
    tell(tf_from_rotation(FrameRotation("mast", "star_camera", np.eye(3)), HEADER))


def output_of(bench, parameters):
    """Start a node with an output of this kind."""
    pytest.importorskip("erfa", reason="pyerfa is an extra")
    node = bench.start(lambda **options: Node("tracker", **options))
    return EarthOutput(node, parameters, "icrs", Mounting(node, ""))


def test_imu_enu_has_stamp_frame_orientation_and_covariance(bench, solution):
    inbox = bench.inbox(Imu, "imu_enu")
    output = output_of(bench, ENU)
    bench.until(lambda: inbox.n_publishers, "publisher")
    output.publish(solution, HEADER, ENU)
    bench.until(lambda: inbox.messages, "imu_enu")
    (message,) = inbox.messages
    assert (message.header.stamp, message.header.frame_id) == (HEADER.stamp, "star_camera")
    expected = enu_attitude(Fix.of_solution(solution), STAMP_NS, SITE)
    read = earth_attitude_from_imu(message)
    np.testing.assert_allclose(read.rotation, expected.rotation, atol=1e-14)
    np.testing.assert_allclose(read.covariance_rad2, ABOUT_CAMERA, atol=1e-20)


def test_attitude_itrs_uses_the_velocity_that_is_told(bench, solution):
    parameters = EarthParameters("itrs", use_velocity=True, ut1_utc_s=0.1)
    inbox = bench.inbox(QuaternionStamped, "attitude_itrs")
    output = output_of(bench, parameters)
    outbox = bench.connected_outbox(Vector3Stamped, "velocity")
    bench.until(lambda: inbox.n_publishers, "publisher")
    output.publish(solution, HEADER, parameters)
    assert output.n_refused == 1  # nothing is known of the velocity yet
    velocity = np.array([7000.0, 3000.0, -100.0])
    calls = bench.calls_of("velocity")
    gcrs = Header(stamp=HEADER.stamp, frame_id="gcrs")
    outbox.publish(vector_from_velocity(velocity, gcrs))
    bench.until(lambda: calls, "velocity taken")
    output.publish(solution, HEADER, parameters)
    bench.until(lambda: inbox.messages, "attitude_itrs")
    (message,) = inbox.messages
    assert message.header.frame_id == "earth"
    expected = itrs_attitude(
        Fix.of_solution(solution), STAMP_NS, orientation=EarthOrientation(0.1),
        velocity_m_per_s=velocity,
    )
    q = message.quaternion
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], expected.quaternion_xyzw, atol=1e-14)
    late = Header(frame_id="star_camera")
    late.stamp.sec = HEADER.stamp.sec + 11
    output.publish(solution, late, parameters)
    assert output.n_refused == 2


def test_the_place_of_a_receiver_counts_when_it_has_a_fix(bench, solution):
    parameters = EarthParameters("enu", use_fix=True)
    inbox = bench.inbox(Imu, "imu_enu")
    output = output_of(bench, parameters)
    outbox = bench.connected_outbox(NavSatFix, "fix")
    bench.until(lambda: inbox.n_publishers, "publisher")
    calls = bench.calls_of("fix")
    no_fix = fix_from_site(SITE, HEADER)
    no_fix.status.status = -1
    outbox.publish(no_fix)
    bench.until(lambda: len(calls) == 1, "first fix")
    output.publish(solution, HEADER, parameters)
    assert output.n_refused == 1
    outbox.publish(fix_from_site(SITE, HEADER))
    bench.until(lambda: len(calls) == 2, "second fix")
    output.publish(solution, HEADER, parameters)
    bench.until(lambda: inbox.messages, "imu_enu")
    expected = enu_attitude(Fix.of_solution(solution), STAMP_NS, SITE)
    read = earth_attitude_from_imu(inbox.messages[0])
    np.testing.assert_allclose(read.rotation, expected.rotation, atol=1e-14)


def test_a_stamp_without_a_date_publishes_nothing_and_is_counted(bench, solution):
    output = output_of(bench, ENU)
    output.publish(solution, Header(frame_id="star_camera"), ENU)
    assert output.n_refused == 1


def test_imu_enu_of_the_base_waits_for_its_mounting(bench, solution, recorder):
    pytest.importorskip("erfa", reason="pyerfa is an extra")
    node = bench.start(lambda **options: Node("tracker", **options))
    inbox = bench.inbox(Imu, "imu_enu")
    mounting = Mounting(recorder, "base_link")
    output = EarthOutput(node, ENU, "icrs", mounting)
    bench.until(lambda: inbox.n_publishers, "publisher")
    output.publish(solution, HEADER, ENU)
    assert output.n_refused == 1
    assert recorder.said == [
        "how star_camera is fixed to base_frame base_link is not known: no chain of transforms "
        "on /tf_static connects them, and nothing is published for the base; start "
        "robot_state_publisher or static_transform_publisher"
    ]
    tell_mounting(recorder)
    output.publish(solution, HEADER, ENU)
    bench.until(lambda: inbox.messages, "imu_enu")
    (message,) = inbox.messages
    assert message.header.frame_id == "base_link"
    of_camera = enu_attitude(Fix.of_solution(solution), STAMP_NS, SITE)
    read = earth_attitude_from_imu(message)
    np.testing.assert_allclose(read.rotation @ BASE_FROM_CAMERA, of_camera.rotation, atol=1e-14)
    # The camera's x is the base's y.
    np.testing.assert_allclose(read.covariance_rad2, np.diag([2e-10, 1e-10, 9e-9]), atol=1e-20)


def test_transform_of_the_camera(solution, recorder):
    output = TransformOutput(recorder, "icrs", Mounting(recorder, ""))
    output.publish(solution.attitude, HEADER)
    (message,) = recorder.published
    assert message.transforms[0].header.stamp == HEADER.stamp
    (turned,), _ = rotations_from_tf(message)
    assert (turned.parent, turned.child) == ("icrs", "star_camera")
    np.testing.assert_allclose(turned.rotation, solution.attitude.rotation, atol=1e-14)


def test_transform_of_the_base_lets_the_camera_keep_its_one_parent(solution, recorder):
    output = TransformOutput(recorder, "icrs", Mounting(recorder, "base_link"))
    output.publish(solution.attitude, HEADER)
    assert recorder.published == []
    tell_mounting(recorder)
    output.publish(solution.attitude, HEADER)
    (turned,), _ = rotations_from_tf(recorder.published[0])
    assert (turned.parent, turned.child) == ("icrs", "base_link")
    np.testing.assert_allclose(
        turned.rotation @ BASE_FROM_CAMERA, solution.attitude.rotation, atol=1e-14
    )


def test_a_mounting_that_is_no_rotation_is_told_and_left_out(recorder):
    mounting = Mounting(recorder, "base_link")
    bad = tf_from_rotation(FrameRotation("base_link", "star_camera", np.eye(3)), HEADER)
    bad.transforms[0].transform.rotation.w = 0.0
    recorder.listeners["/tf_static"](bad)
    assert "/tf_static: the transform from base_link to star_camera" in recorder.said[0]
    assert mounting.camera_from_body("star_camera") is None


def test_static_frames_go_up_and_down_the_tree():
    frames = StaticFrames()
    x, z = (Rotation.from_euler(axis, 90, degrees=True).as_matrix() for axis in "xz")
    frames.take("base", "left", x)
    frames.take("base", "mast", z)
    frames.take("mast", "right", x)
    np.testing.assert_allclose(frames.rotation("base", "right"), z @ x, atol=1e-15)
    np.testing.assert_allclose(frames.rotation("left", "right"), x.T @ z @ x, atol=1e-15)
    assert frames.rotation("base", "elsewhere") is None
    frames.take("right", "base", x)  # a circle ends
    assert frames.rotation("elsewhere", "right") is None


@pytest.mark.parametrize(("values", "sentence"), [
    (("enu",), "parameter earth_frame enu needs a place: set latitude_deg and longitude_deg, or "
     "use_fix"),
    (("enu", 47.3), "parameter earth_frame enu needs a place: set latitude_deg and "
     "longitude_deg, or use_fix"),
    (("enu", -95.0, 8.5), "latitude_deg is -95.0: it must be from -90 to 90 deg"),
])
def test_parameters_that_do_not_go_together_are_refused(values, sentence):
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        EarthParameters(*values)


def test_polar_motion_has_two_numbers():
    with pytest.raises(ValueError, match=r"polar_motion_arcsec has 1 numbers: give xp and yp"):
        EarthParameters(polar_motion_arcsec=(0.1,))


@pytest.mark.parametrize(("missing", "make", "sentence"), [
    ("erfa", lambda: EarthOutput(None, ENU, "icrs", None),
     "parameter earth_frame enu: the attitude against the Earth needs pyerfa: apt install "
     "python3-erfa, or pip install pyerfa"),
    ("tf2_msgs", lambda: Mounting(None, "base_link"),
     "parameter base_frame base_link: transforms need tf2_msgs: apt install ros-jazzy-tf2-msgs"),
    ("tf2_msgs", lambda: TransformOutput(None, "icrs", Mounting(None, "")),
     "parameter publish_tf: transforms need tf2_msgs: apt install ros-jazzy-tf2-msgs"),
])
def test_a_missing_library_is_told_with_parameter_and_remedy(monkeypatch, missing, make, sentence):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        make()


def test_nothing_of_it_is_wanted_by_default():
    assert EarthParameters().earth_frame == "none"
    assert TransformParameters() == TransformParameters(publish_tf=False, base_frame="")
