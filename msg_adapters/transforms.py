"""Rotations <-> TFMessage.

tf2_msgs is no part of ROS' common messages and is imported where a message is made: reading a
message and all else work without it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from star_tracker.geometry.rotation import rotation_matrix, write_quaternion
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters import shown

if TYPE_CHECKING:
    import std_msgs.msg


@dataclass(frozen=True)
class FrameRotation:
    """How one frame is turned in another.

    Attributes:
        parent, child: frame_ids.
        rotation: (3, 3) turns vectors in the child into the parent.
    """

    parent: str
    child: str
    rotation: Floats


def tf_message_type() -> Any:
    """Return the class TFMessage. Raises ImportError, with the remedy, where it is missing."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError as error:
        raise ImportError(
            "transforms need tf2_msgs: apt install ros-jazzy-tf2-msgs"
        ) from error
    return TFMessage


def tf_from_rotation(turned: FrameRotation, header: "std_msgs.msg.Header") -> Any:
    """Write a TFMessage of one transform at the header's stamp, without translation.

    Stars tell no place. Raises ImportError where tf2_msgs is missing.
    """
    from geometry_msgs.msg import TransformStamped
    from std_msgs.msg import Header

    quaternion = np.empty(4)
    write_quaternion(np.ascontiguousarray(turned.rotation, float), quaternion)
    transform = TransformStamped(
        header=Header(stamp=header.stamp, frame_id=str(turned.parent)),
        child_frame_id=str(turned.child),
    )
    q = transform.transform.rotation
    q.x, q.y, q.z, q.w = (float(value) for value in quaternion)
    return tf_message_type()(transforms=[transform])


def rotations_from_tf(message: Any) -> tuple[list[FrameRotation], list[str]]:
    """Read the rotations of a TFMessage; return them, and a sentence for each that is none."""
    read = [_rotation_of(transform) for transform in message.transforms]
    return (
        [one for one in read if isinstance(one, FrameRotation)],
        [one for one in read if isinstance(one, str)],
    )


def _rotation_of(transform: Any) -> FrameRotation | str:
    """Return a transform's rotation, or what is wrong with it."""
    parent, child = str(transform.header.frame_id), str(transform.child_frame_id)
    q = transform.transform.rotation
    quaternion = np.array([q.x, q.y, q.z, q.w], float)
    if not abs(np.linalg.norm(quaternion) - 1) < 0.01:
        return (
            f"the transform from {shown(parent)} to {shown(child)} has the quaternion "
            f"{quaternion.tolist()}: its length must be 1"
        )
    # tf2 lets a leading slash pass, and takes it away.
    return FrameRotation(parent.lstrip("/"), child.lstrip("/"), rotation_matrix(quaternion))
