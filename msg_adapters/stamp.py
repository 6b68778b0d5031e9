"""Stamp -> nanoseconds."""

from std_msgs.msg import Header


def nanoseconds_from_header(header: Header) -> int:
    """Read a header's stamp as whole nanoseconds."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
