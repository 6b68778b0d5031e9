"""Stamp -> nanoseconds."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import std_msgs.msg


def nanoseconds_from_header(header: "std_msgs.msg.Header") -> int:
    """Read a header's stamp as whole nanoseconds."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
