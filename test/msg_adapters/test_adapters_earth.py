"""Messages of the attitude against the Earth: places, transforms, Imu in ENU."""

import re
import sys
from types import ModuleType

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header
from tf_stand_in import TFMessage

from star_tracker.earth.attitude import EarthAttitude
from star_tracker.earth.site import Site
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.attitude import quaternion_from_attitude
from star_tracker.msg_adapters.imu import (
    earth_attitude_from_imu,
    imu_from_attitude,
    orientation_from_imu,
)
from star_tracker.msg_adapters.site import fix_from_site, site_from_fix
from star_tracker.msg_adapters.transforms import FrameRotation, rotations_from_tf, tf_from_rotation
from star_tracker.msg_adapters.velocity import vector_from_velocity, velocity_from_vector

HEADER = Header(frame_id="star_camera")
HEADER.stamp.sec, HEADER.stamp.nanosec = 1_717_556_645, 250_000_000
#: A camera that looks up, the top of its image to the north: x west, y (down) south, z up.
LOOKING_UP = np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])


def test_place_round_trip():
    site = Site(-24.6272, -70.4042, 2635.0)
    assert site_from_fix(fix_from_site(site, HEADER)) == site
    assert fix_from_site(site, HEADER).header == HEADER


def test_a_receiver_without_altitude_stands_on_the_ellipsoid():
    message = NavSatFix(latitude=1.0, longitude=2.0, altitude=float("nan"))
    message.status.status = NavSatStatus.STATUS_FIX
    assert site_from_fix(message) == Site(1.0, 2.0, 0.0)


@pytest.mark.parametrize("status", [NavSatStatus.STATUS_NO_FIX, NavSatStatus.STATUS_UNKNOWN])
def test_a_receiver_without_a_fix_has_no_place(status):
    message = fix_from_site(Site(1.0, 2.0), HEADER)
    message.status.status = status
    with pytest.raises(MessageError, match="says that the receiver has no fix: wait for one"):
        site_from_fix(message)


@pytest.mark.parametrize(("field", "value", "sentence"), [
    ("latitude", float("nan"), "NavSatFix latitude_deg is nan: it must be from -90 to 90 deg"),
    ("latitude", 91.0, "NavSatFix latitude_deg is 91.0: it must be from -90 to 90 deg"),
    ("longitude", float("nan"), "NavSatFix longitude_deg is nan: it must be from -180 to 360 deg"),
    ("longitude", float("-inf"), "NavSatFix longitude_deg is -inf: it must be from -180 to 360 "),
    ("altitude", float("inf"), "NavSatFix height_m is inf: it must be from -12000 to 100000 m"),
])
def test_a_fix_that_is_no_place_is_refused_by_name(field, value, sentence):
    message = fix_from_site(Site(1.0, 2.0), HEADER)
    setattr(message, field, value)
    with pytest.raises(MessageError, match=re.escape(sentence)):
        site_from_fix(message)


def test_imu_in_enu_round_trip():
    rotation = Rotation.from_euler("zyx", [40, 20, -70], degrees=True).as_matrix()
    about_camera = np.array([[4e-8, 1e-8, 0.0], [1e-8, 9e-8, -2e-8], [0.0, -2e-8, 4e-7]])
    attitude = EarthAttitude.from_rotation(rotation, about_camera)
    read = earth_attitude_from_imu(imu_from_attitude(attitude, HEADER))
    np.testing.assert_allclose(read.quaternion_xyzw, attitude.quaternion_xyzw, atol=1e-15)
    np.testing.assert_allclose(read.covariance_rad2, about_camera, atol=1e-20)


def test_imu_of_a_camera_that_looks_up_is_known_least_about_up():
    attitude = EarthAttitude.from_rotation(LOOKING_UP, np.diag([1e-10, 2e-10, 9e-9]))
    quaternion, covariance = orientation_from_imu(imu_from_attitude(attitude, HEADER))
    np.testing.assert_allclose(quaternion, [0, 0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(covariance, np.diag([1e-10, 2e-10, 9e-9]), atol=1e-22)
    level = Rotation.from_euler("x", 90, degrees=True).as_matrix() @ LOOKING_UP
    turned = EarthAttitude.from_rotation(level, attitude.covariance_rad2)
    _, covariance = orientation_from_imu(imu_from_attitude(turned, HEADER))
    np.testing.assert_allclose(covariance, np.diag([1e-10, 9e-9, 2e-10]), atol=1e-22)


def test_an_attitude_against_the_earth_is_a_quaternion_like_any_other():
    attitude = EarthAttitude.from_rotation(LOOKING_UP, np.eye(3))
    message = quaternion_from_attitude(attitude, HEADER)
    q = message.quaternion
    np.testing.assert_array_equal([q.x, q.y, q.z, q.w], attitude.quaternion_xyzw)


@pytest.fixture
def tf2_msgs(monkeypatch):
    """Let `tf2_msgs` be there, as a stand-in where ROS has none."""
    package, messages = ModuleType("tf2_msgs"), ModuleType("tf2_msgs.msg")
    messages.TFMessage = TFMessage
    monkeypatch.setitem(sys.modules, "tf2_msgs", package)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", messages)


@pytest.mark.usefixtures("tf2_msgs")
def test_transform_round_trip():
    rotation = Rotation.from_euler("zyx", [10, 20, 30], degrees=True).as_matrix()
    message = tf_from_rotation(FrameRotation("icrs", "star_camera", rotation), HEADER)
    (transform,) = message.transforms
    assert (transform.header.stamp, transform.header.frame_id) == (HEADER.stamp, "icrs")
    assert transform.transform.translation.x == 0.0
    (read,), complaints = rotations_from_tf(message)
    assert complaints == []
    assert (read.parent, read.child) == ("icrs", "star_camera")
    np.testing.assert_allclose(read.rotation, rotation, atol=1e-15)


@pytest.mark.usefixtures("tf2_msgs")
def test_a_transform_turns_vectors_of_the_child_into_the_parent():
    """As tf2 has it: a quarter turn about z brings the child's x to the parent's y."""
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    (transform,) = tf_from_rotation(FrameRotation("icrs", "camera", quarter), HEADER).transforms
    q = transform.transform.rotation
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)


def test_a_transform_without_a_rotation_is_refused():
    transform = TransformStamped(child_frame_id="camera")
    transform.header.frame_id = "base"
    transform.transform.rotation.w = 0.0
    good = TransformStamped(child_frame_id="other")
    good.header.frame_id = "base"
    (read,), (complaint,) = rotations_from_tf(TFMessage([transform, good]))
    assert "base to camera has the quaternion [0.0, 0.0, 0.0, 0.0]: its length" in complaint
    assert read.child == "other"


def test_a_missing_tf2_msgs_is_told_with_its_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_msgs", None)
    with pytest.raises(ImportError, match=r"^transforms need tf2_msgs: apt install ros-jazzy-tf2"):
        tf_from_rotation(FrameRotation("icrs", "camera", np.eye(3)), HEADER)


def test_velocity_round_trip():
    header = Header(frame_id="gcrs")
    velocity = np.array([7000.0, -3000.5, 12.0])
    message = vector_from_velocity(velocity, header)
    np.testing.assert_array_equal(velocity_from_vector(message, {"gcrs"}), velocity)


@pytest.mark.parametrize(("frame", "velocity", "sentence"), [
    ("base_link", [1, 2, 3], "velocity has frame_id base_link: give it in GCRS, about the "
     "Earth's centre, with frame_id gcrs or icrs"),
    ("icrs", [3e8, 0, 0], "velocity is [300000000.0, 0.0, 0.0]: give it in m/s, below 100 km/s"),
    ("icrs", [float("nan"), 0, 0], "velocity is [nan, 0.0, 0.0]: give it in m/s, below 100 km/s"),
])
def test_what_is_no_velocity_about_the_earth_is_refused(frame, velocity, sentence):
    message = vector_from_velocity(np.array(velocity, float), Header(frame_id=frame))
    with pytest.raises(MessageError, match=f"^{re.escape(sentence)}$"):
        velocity_from_vector(message, {"icrs", "gcrs"})
