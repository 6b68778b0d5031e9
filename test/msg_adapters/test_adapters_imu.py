"""Attitude -> Imu: whose axes the covariance is about, and what is absent."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from star_tracker.attitude.attitude import Attitude
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.msg_adapters.imu import imu_from_attitude, orientation_from_imu

HEADER = Header(frame_id="star_camera")
HEADER.stamp.sec = 77
#: rad^2 about the camera's x, y, z: roll about the boresight is the least certain.
ABOUT_CAMERA = np.diag([1e-10, 2e-10, 9e-9])


def attitude_at(ra_deg, dec_deg, roll_deg, covariance=ABOUT_CAMERA):
    angles = np.radians([ra_deg, dec_deg, roll_deg])
    return Attitude.from_rotation(rotation_from_boresight(*angles), covariance)


@pytest.mark.parametrize(("boresight", "expected"), [
    # Boresight along ICRS x: x of the camera points to -y (to the right of an image with north
    # up is west), its y down to -z.
    ((0, 0, 0), [9e-9, 1e-10, 2e-10]),
    # Along ICRS y: x of the camera points to +x.
    ((90, 0, 0), [1e-10, 9e-9, 2e-10]),
    # The image turned by a quarter: x and y change places.
    ((0, 0, 90), [9e-9, 2e-10, 1e-10]),
    # At the pole the roll is about ICRS z.
    ((0, 90, 0), [2e-10, 1e-10, 9e-9]),
])
def test_covariance_is_about_the_axes_of_the_reference_frame(boresight, expected):
    _, covariance = orientation_from_imu(imu_from_attitude(attitude_at(*boresight), HEADER))
    np.testing.assert_allclose(covariance, np.diag(expected), atol=1e-20)


def test_covariance_is_that_of_rotations_scattered_about_the_reference_axes():
    attitude = attitude_at(40.0, 25.0, 110.0, np.array(
        [[4e-8, 1e-8, 0.0], [1e-8, 9e-8, -2e-8], [0.0, -2e-8, 4e-7]]
    ))
    true = Rotation.from_matrix(attitude.rotation)
    n = 20_000
    camera_side = np.random.default_rng(1).multivariate_normal(
        np.zeros(3), attitude.covariance_rad2, n
    )
    scattered = true * Rotation.from_rotvec(camera_side)
    reference_side = (scattered * true.inv()).as_rotvec()
    _, covariance = orientation_from_imu(imu_from_attitude(attitude, HEADER))
    # Entries of a sample covariance scatter by sqrt(2 / n), 1 %, of the variances.
    np.testing.assert_allclose(
        np.cov(reference_side.T), covariance, atol=0.05 * np.diag(covariance).max()
    )


def test_covariance_is_symmetric_to_the_last_digit():
    _, covariance = orientation_from_imu(imu_from_attitude(attitude_at(33, -12, 201), HEADER))
    np.testing.assert_array_equal(covariance, covariance.T)


def test_orientation_is_the_quaternion_and_the_header_is_the_callers():
    attitude = attitude_at(40.0, 25.0, 110.0)
    message = imu_from_attitude(attitude, HEADER)
    quaternion, _ = orientation_from_imu(message)
    np.testing.assert_array_equal(quaternion, attitude.quaternion_xyzw)
    assert message.header == HEADER


def test_rate_and_acceleration_are_marked_absent():
    message = imu_from_attitude(attitude_at(0, 0, 0), HEADER)
    for covariance in (
        message.angular_velocity_covariance, message.linear_acceleration_covariance
    ):
        assert list(covariance) == [-1.0, *[0.0] * 8]
    assert (message.angular_velocity.x, message.linear_acceleration.z) == (0.0, 0.0)
