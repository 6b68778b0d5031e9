"""ROS messages <-> arrays and the core's dataclasses: pure functions, in pairs. No rclpy here.

Message fields are not type-checked by default and a wrong type is sent as garbage, so every value
passes through float(), int() or str() on its way into a message.
"""


class MessageError(ValueError):
    """A message that cannot be used; the text names the field and the remedy."""
