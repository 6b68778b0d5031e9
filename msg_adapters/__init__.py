"""ROS messages <-> arrays and the core's dataclasses: pure functions, in pairs. No rclpy here.

Reading needs no ROS: any object with the message's fields will do, such as those that a reader of
bags makes. What writes a message asks `message_class` for its class: that of ROS, or of a writer
of bags.

Message fields are not type-checked by default and a wrong type is sent as garbage, so every value
passes through float(), int() or str() on its way into a message.
"""

#: Characters of a message's own text that are shown in an error.
_LONGEST_TEXT = 40


class MessageError(ValueError):
    """A message that cannot be used; the text names the field and the remedy."""


def shown(text: str) -> str:
    """Return text out of a message as it can stand in a log: printable and not too long."""
    text = text if text.isprintable() and text else ascii(text)
    return text if len(text) <= _LONGEST_TEXT else f"{text[:_LONGEST_TEXT]}..."
