"""Attitude <-> Imu: the orientation with its covariance, all else marked as absent."""

from typing import TYPE_CHECKING

import numpy as np

from star_tracker.attitude.attitude import Attitude
from star_tracker.earth.attitude import EarthAttitude
from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters.message_class import message_class

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

#: REP-145 and the message itself: the first element -1 says that a quantity is not there.
_ABSENT = [-1.0, *[0.0] * 8]


def imu_from_attitude(
    attitude: Attitude | EarthAttitude, header: "std_msgs.msg.Header"
) -> "sensor_msgs.msg.Imu":
    """Write the orientation of the sensor frame that the header names, as seen from ICRS.

    An attitude against the Earth is written in the same way; in ENU it is what REP-145 asks for.
    The covariance P of an attitude is of a small rotation about the camera's axes,
    R = R_true exp(d). Imu has it about the fixed axes of the reference frame, R = exp(e) R_true:
    e = R_true d, whose covariance is R P R^T, rad^2.
    """
    message = message_class("sensor_msgs/Imu")(header=header)
    x, y, z, w = (float(value) for value in attitude.quaternion_xyzw)
    message.orientation.x, message.orientation.y = x, y
    message.orientation.z, message.orientation.w = z, w
    message.orientation_covariance = [
        float(value) for value in reference_covariance(attitude).ravel()
    ]
    message.angular_velocity_covariance = list(_ABSENT)
    message.linear_acceleration_covariance = list(_ABSENT)
    return message


def reference_covariance(attitude: Attitude | EarthAttitude) -> Floats:
    """Return the covariance (3, 3) about the axes of the reference frame, rad^2."""
    rotation = attitude.rotation
    covariance = rotation @ attitude.covariance_rad2 @ rotation.T
    return np.asarray((covariance + covariance.T) / 2)


def orientation_from_imu(message: "sensor_msgs.msg.Imu") -> tuple[Floats, Floats]:
    """Read the quaternion (4,), order x, y, z, w, and its covariance (3, 3), rad^2."""
    q = message.orientation
    covariance = np.asarray(message.orientation_covariance, float).reshape(3, 3)
    return np.array([q.x, q.y, q.z, q.w]), covariance


def earth_attitude_from_imu(message: "sensor_msgs.msg.Imu") -> EarthAttitude:
    """Read an orientation against the Earth, its covariance about the sensor's own axes."""
    quaternion, covariance = orientation_from_imu(message)
    rotation = rotation_matrix(quaternion)
    return EarthAttitude.from_rotation(rotation, rotation.T @ covariance @ rotation)
