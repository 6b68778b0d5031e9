"""Attitude and boresight messages."""

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from std_msgs.msg import Header

from star_tracker.attitude.attitude import Attitude
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.msg_adapters.attitude import (
    array_from_boresight,
    boresight_from_attitude,
    quaternion_from_attitude,
)

HEADER = Header(frame_id="icrs")
HEADER.stamp.sec, HEADER.stamp.nanosec = 12, 345


def attitude_at(ra_deg, dec_deg, roll_deg):
    rotation = rotation_from_boresight(*np.radians([ra_deg, dec_deg, roll_deg]))
    return Attitude.from_rotation(rotation, np.eye(3))


def test_quaternion_order_is_x_y_z_w():
    attitude = Attitude(np.array([0.5, -0.5, 0.1, 0.7]), np.eye(3), 0.0, 0.0, 0.0)
    message = quaternion_from_attitude(attitude, HEADER)
    assert message.quaternion == Quaternion(x=0.5, y=-0.5, z=0.1, w=0.7)


def test_quaternion_of_numpy_float32_is_sent_as_float():
    # rclpy sends a numpy float32 as garbage; ROS_PYTHON_CHECK_FIELDS=1 makes that an error here.
    attitude = Attitude(np.array([0, 0, 0, 1], np.float32), np.eye(3), 0.0, 0.0, 0.0)
    assert type(quaternion_from_attitude(attitude, HEADER).quaternion.w) is float


def test_boresight_is_in_degrees_ra_dec_roll():
    message = boresight_from_attitude(attitude_at(243.0, -28.0, 90.0), HEADER)
    np.testing.assert_allclose(array_from_boresight(message), [243.0, -28.0, 90.0], atol=1e-9)


@pytest.mark.parametrize("write", [quaternion_from_attitude, boresight_from_attitude])
def test_header_is_the_callers(write):
    assert write(attitude_at(10.0, 20.0, 30.0), HEADER).header == HEADER
