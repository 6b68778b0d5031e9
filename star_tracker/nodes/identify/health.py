"""How well identify_node does: rolling statistics of its frames, and their publisher."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

#: Between two reports, s.
_PERIOD_S = 1.0
#: The sliding window of rates, ratios and latencies, s, and the most frames that it holds.
WINDOW_S = 10.0
_MOST_FRAMES = 10_000
#: An input whose stamp is farther than this from now, or in the future, is of another clock, s.
_OLDEST_S, _YOUNGEST_S = 60.0, -0.001
#: Below this share of solved frames, and above this share of dropped ones, the node warns.
_GOOD_RATIO, _DROPPED_RATIO = 0.5, 0.1


@dataclass(frozen=True)
class FrameRecord:
    """How one frame went.

    Attributes:
        solved: whether it has an attitude.
        reason: status and sentence of how it ended.
        mode: how the solution was come by, empty where there is none.
        latency_ms: from reception to the last publication.
        age_s: from the frame's stamp to its reception; None where that makes no sense.
        n_stars: centroids of the frame.
        n_false: those of them that were not recognised.
        hint: what would have helped, where that is known.
        boresight: where the camera points, in words; empty where it is not solved.
    """

    solved: bool
    reason: str
    mode: str
    latency_ms: float
    age_s: float | None
    n_stars: int
    n_false: int
    hint: str = ""
    boresight: str = ""


def input_age_s(stamp_ns: int, now_ns: int) -> float | None:
    """Return the time from a stamp to now; None where the two clocks do not fit."""
    age_s = (now_ns - stamp_ns) / 1e9
    return age_s if stamp_ns > 0 and _YOUNGEST_S <= age_s <= _OLDEST_S else None


class Health:
    """Counts frames and keeps those of the last seconds.

    Times are seconds of a clock that never goes back, as `time.monotonic`.

    Args:
        started_s: when the node began to listen.
    """

    def __init__(self, started_s: float) -> None:
        self._started_s = started_s
        self._frames: deque[tuple[float, FrameRecord]] = deque(maxlen=_MOST_FRAMES)
        self._drops: deque[tuple[float, int]] = deque([(started_s, 0)])
        self._last: FrameRecord | None = None
        self._last_fix: tuple[float, str] | None = None
        self._last_failure = ""
        self.n_frames = self.n_solved = self.n_dropped = 0

    def add(self, record: FrameRecord, now_s: float) -> None:
        """Take in a frame that was answered."""
        self._frames.append((now_s, record))
        self._last = record
        self.n_frames += 1
        self.n_solved += record.solved
        if record.solved:
            self._last_fix = now_s, record.boresight
        else:
            self._last_failure = record.reason

    def report(self, rejected: Counter[str], now_s: float) -> tuple[str, str, dict[str, object]]:
        """Return level (`ok`, `warn`, `error`), a sentence and values by key.

        Args:
            rejected: frames and centroids that could not be used, by reason.
            now_s: the time.
        """
        since_s = max(now_s - WINDOW_S, self._started_s)
        if len(self._frames) == self._frames.maxlen:
            since_s = max(since_s, self._frames[0][0])
        while self._frames and self._frames[0][0] < since_s:
            self._frames.popleft()
        frames = [record for _, record in self._frames]
        solved = [record for record in frames if record.solved]
        # A window that has just begun is no base for a rate.
        span_s = max(now_s - since_s, 1.0)
        latency = sorted(record.latency_ms for record in frames)
        n_stars = sum(record.n_stars for record in solved)
        ratio = len(solved) / len(frames) if frames else None
        values: dict[str, object] = {
            "frames_per_s": len(frames) / span_s,
            "solved_per_s": len(solved) / span_s,
            "solve_ratio": ratio,
            "latency_p50_ms": quantile(latency, 0.50),
            "latency_p95_ms": quantile(latency, 0.95),
            "latency_max_ms": quantile(latency, 1.0),
            "input_age_s": self._last.age_s if self._last else None,
            "false_star_ratio": (
                sum(record.n_false for record in solved) / n_stars if n_stars else None
            ),
            "frames": self.n_frames,
            "solved": self.n_solved,
            "dropped": self.n_dropped,
            "boresight": self._last_fix[1] if self._last_fix else None,
            "fix_age_s": now_s - self._last_fix[0] if self._last_fix else None,
            "hint": next((record.hint for record in reversed(frames) if record.hint), None),
            "mode": (self._last.mode if self._last else "") or None,
            "last_reason": self._last_failure or None,
            **{f"rejected_{kind}": count for kind, count in sorted(rejected.items())},
        }
        return *self._verdict(frames, ratio, self._dropped(now_s)), values

    def _dropped(self, now_s: float) -> int:
        """Return how many frames were dropped in the window."""
        self._drops.append((now_s, self.n_dropped))
        while len(self._drops) > 1 and self._drops[1][0] <= now_s - WINDOW_S:
            self._drops.popleft()
        return self.n_dropped - self._drops[0][1]

    def _verdict(
        self, frames: Sequence[FrameRecord], ratio: float | None, dropped: int
    ) -> tuple[str, str]:
        if ratio is None:
            return "warn", f"no frame in the last {WINDOW_S:g} s"
        found = f"{round(100 * ratio)} % of {len(frames)} frames solved"
        if ratio == 0:
            return "error", f"{found}, the last: {self._last_failure}"
        if ratio < _GOOD_RATIO:
            return "warn", f"{found}, the last that was not: {self._last_failure}"
        if dropped > _DROPPED_RATIO * (dropped + len(frames)):
            return "warn", f"{found}, {dropped} more were dropped"
        return "ok", found


class DiagnosticsPublisher:
    """Publishes a node's statuses on /diagnostics once a second, whatever the ROS time does.

    Args:
        node: what publishes.
        statuses: called for what there is to say now.
    """

    def __init__(self, node: Node, statuses: Callable[[], Iterable[DiagnosticStatus]]) -> None:
        self._node, self._statuses = node, statuses
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(_PERIOD_S, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _report(self) -> None:
        header = Header(stamp=self._node.get_clock().now().to_msg())
        self._publisher.publish(DiagnosticArray(header=header, status=list(self._statuses())))


def quantile(ascending: Sequence[float], share: float) -> float | None:
    """Return the value below or at which a share of the values lies (nearest rank); None = none.

    Args:
        ascending: the values, sorted.
        share: above 0, up to 1.
    """
    if not ascending:
        return None
    rank = -(-round(share * len(ascending) * 1e9) // 10**9)  # rounded up, but not for a last digit
    return ascending[max(rank, 1) - 1]
