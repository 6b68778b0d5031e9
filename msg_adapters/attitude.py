"""Attitude <-> QuaternionStamped, and boresight <-> Vector3Stamped."""

from typing import TYPE_CHECKING

import numpy as np

from star_tracker.attitude.attitude import Attitude
from star_tracker.earth.attitude import EarthAttitude
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters.message_class import message_class

if TYPE_CHECKING:
    import geometry_msgs.msg
    import std_msgs.msg


def quaternion_from_attitude(
    attitude: Attitude | EarthAttitude, header: "std_msgs.msg.Header"
) -> "geometry_msgs.msg.QuaternionStamped":
    """Write the quaternion that rotates camera-frame vectors into the header's frame."""
    message = message_class("geometry_msgs/QuaternionStamped")(header=header)
    x, y, z, w = (float(value) for value in attitude.quaternion_xyzw)
    message.quaternion.x, message.quaternion.y = x, y
    message.quaternion.z, message.quaternion.w = z, w
    return message


def array_from_quaternion(message: "geometry_msgs.msg.QuaternionStamped") -> Floats:
    """Read the quaternion (4,), order x, y, z, w."""
    q = message.quaternion
    return np.array([q.x, q.y, q.z, q.w])


def boresight_from_attitude(
    attitude: Attitude, header: "std_msgs.msg.Header"
) -> "geometry_msgs.msg.Vector3Stamped":
    """Write right ascension, declination and roll, degrees, as x, y, z."""
    message = message_class("geometry_msgs/Vector3Stamped")(header=header)
    message.vector.x = float(np.degrees(attitude.ra_rad))
    message.vector.y = float(np.degrees(attitude.dec_rad))
    message.vector.z = float(np.degrees(attitude.roll_rad))
    return message


def array_from_boresight(message: "geometry_msgs.msg.Vector3Stamped") -> Floats:
    """Read right ascension, declination and roll (3,), degrees."""
    return np.array([message.vector.x, message.vector.y, message.vector.z])
