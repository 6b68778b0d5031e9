"""How the camera is mounted, and its attitude as a transform on /tf."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from star_tracker.attitude.attitude import Attitude
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters.transforms import (
    FrameRotation,
    rotations_from_tf,
    tf_from_rotation,
    tf_message_type,
)
from star_tracker.nodes.declaring import parameter
from star_tracker.nodes.identify.static_frames import StaticFrames

#: tf2's own: the names are absolute, all robots of a graph share them.
_TF, _TF_STATIC, _TF_DEPTH, _TF_STATIC_DEPTH = "/tf", "/tf_static", 100, 100
_COMPLAINT_S = 10.0


@dataclass(frozen=True)
class TransformParameters:
    """What identify_node is told of transforms."""

    publish_tf: bool = parameter(
        False, "publish the attitude as a transform on /tf: reference_frame to the camera, "
        "or to base_frame", fixed=True,
    )
    base_frame: str = parameter(
        "", "frame_id of what carries the camera, by static transforms on /tf_static; empty = "
        "the camera itself", fixed=True,
    )


class Mounting:
    """How the camera is fixed to what carries it, learned from /tf_static.

    Args:
        node: who listens, where there is a base frame.
        base_frame: frame_id of what carries the camera; empty = the camera itself.

    Raises ValueError where tf2_msgs is missing.
    """

    def __init__(self, node: Node, base_frame: str) -> None:
        self._node, self.base_frame = node, base_frame.lstrip("/")
        self._frames = StaticFrames()
        if self.base_frame:
            qos = QoSProfile(
                depth=_TF_STATIC_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL
            )
            kind = _tf_type(f"base_frame {base_frame}")
            node.create_subscription(kind, _TF_STATIC, self._take, qos)

    def body_of(self, camera_frame: str) -> str:
        """Return the frame_id of what is reported: the base, or the camera itself."""
        return self.base_frame or camera_frame

    def camera_from_body(self, camera_frame: str) -> Floats | None:
        """Return the rotation (3, 3), body to camera; None, with a line in the log, if unknown."""
        if not self.base_frame:
            return np.eye(3)
        rotation = self._frames.rotation(camera_frame.lstrip("/"), self.base_frame)
        if rotation is None:
            self._node.get_logger().warning(
                f"how {camera_frame} is fixed to base_frame {self.base_frame} is not known: no "
                "chain of transforms on /tf_static connects them, and nothing is published for "
                "the base; start robot_state_publisher or static_transform_publisher",
                throttle_duration_sec=_COMPLAINT_S,
            )
        return rotation

    def _take(self, message: Any) -> None:
        found, complaints = rotations_from_tf(message)
        for turned in found:
            self._frames.take(turned.parent, turned.child, turned.rotation)
        for sentence in complaints:
            self._node.get_logger().error(f"{_TF_STATIC}: {sentence}")


class TransformOutput:
    """Publishes each attitude as a transform.

    Args:
        node: what publishes.
        reference_frame: parent of the transform.
        mounting: whose body is the child.

    Raises ValueError where tf2_msgs is missing.
    """

    def __init__(self, node: Node, reference_frame: str, mounting: Mounting) -> None:
        self._reference_frame, self._mounting = reference_frame, mounting
        kind = _tf_type("publish_tf")
        self._tf = node.create_publisher(kind, _TF, _TF_DEPTH)

    def publish(self, attitude: Attitude, camera_header: Header) -> None:
        """Publish the attitude of a frame; its header names the camera's frame."""
        camera = camera_header.frame_id
        mounted = self._mounting.camera_from_body(camera)
        if mounted is None:
            return
        self._tf.publish(tf_from_rotation(
            FrameRotation(
                self._reference_frame, self._mounting.body_of(camera), attitude.rotation @ mounted
            ),
            camera_header,
        ))


def _tf_type(wanted_by: str) -> Any:
    """Return the class TFMessage. Raises ValueError that names the parameter that needs it."""
    try:
        return tf_message_type()
    except ImportError as error:
        raise ValueError(f"parameter {wanted_by}: {error}") from error
