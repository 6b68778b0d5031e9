"""A stand-in for tf2_msgs/TFMessage, which the wheels of ROS' common messages are without."""

from dataclasses import dataclass, field


@dataclass
class TFMessage:
    """The message's one field."""

    transforms: list = field(default_factory=list)
