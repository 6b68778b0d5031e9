"""Vector3Stamped <-> a velocity about the Earth's centre, in GCRS."""

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters import MessageError, shown

if TYPE_CHECKING:
    import geometry_msgs.msg
    import std_msgs.msg

#: Above the speed of anything that has left the Earth.
_FASTEST_M_PER_S = 1e5


def velocity_from_vector(
    message: "geometry_msgs.msg.Vector3Stamped", inertial_frames: Collection[str]
) -> Floats:
    """Read a velocity (3,), m/s, told along the axes of one of these frames.

    Raises MessageError for another frame and for what is no velocity.
    """
    frame = str(message.header.frame_id)
    if frame not in inertial_frames:
        raise MessageError(
            f"velocity has frame_id {shown(frame)}: give it in GCRS, about the Earth's centre, "
            f"with frame_id {' or '.join(sorted(inertial_frames))}"
        )
    velocity = np.array([message.vector.x, message.vector.y, message.vector.z], float)
    if not np.linalg.norm(velocity) < _FASTEST_M_PER_S:
        raise MessageError(f"velocity is {velocity.tolist()}: give it in m/s, below 100 km/s")
    return velocity


def vector_from_velocity(
    velocity_m_per_s: Floats, header: "std_msgs.msg.Header"
) -> "geometry_msgs.msg.Vector3Stamped":
    """Write a velocity (3,), m/s, along the axes of the header's frame."""
    from geometry_msgs.msg import Vector3Stamped

    message = Vector3Stamped(header=header)
    message.vector.x, message.vector.y, message.vector.z = (float(v) for v in velocity_m_per_s)
    return message
