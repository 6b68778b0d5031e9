"""What identify_node says while it starts: in /diagnostics, and in the log where it takes long."""

import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from star_tracker.compiled import cache_state, mark_warm

#: Between two lines of a start that takes long, s.
_PERIOD_S = 10.0


class Starting:
    """The start of a node: how long it has taken, and what is being done.

    Args:
        node: what starts.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._since_s = node, time.monotonic()
        cache = cache_state()
        #: Whether the log has said that nothing can be cached.
        self.warned = not cache.writable and not cache.warm
        self._doing = "loading" if cache.warm else "compiling"
        self._timer = None
        if self.warned:
            where = cache.folder or "a home folder, which this user has not"
            node.get_logger().warning(
                f"compiled code cannot be kept in {where}: every start compiles for about a "
                "minute; set NUMBA_CACHE_DIR to a folder that can be written"
            )
        elif not cache.warm:
            node.get_logger().info(
                "compiling the solver: about a minute, the first time on this machine "
                "(`star_tracker compile` does it ahead)"
            )
        if not cache.warm:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = node.create_timer(_PERIOD_S, self._say, clock=steady)

    @property
    def sentence(self) -> str:
        """What is being done, and for how long."""
        return f"starting: {self._doing} the solver, {time.monotonic() - self._since_s:.0f} s"

    def _say(self) -> None:
        self._node.get_logger().info(self.sentence)

    def end(self) -> None:
        """Take in that all has been compiled or loaded."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        mark_warm()
