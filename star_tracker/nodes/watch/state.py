"""What an identify_node says, put together frame by frame. No ROS here.

Times `now_s` are seconds of a clock that never goes back, as `time.monotonic`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.attitude import Attitude
from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.geometry.spherical import Floats

#: How long a frame waits for its missing messages, s: one may be lost on the way.
PATIENCE_S = 0.5


@dataclass(eq=False)
class Frame:
    """One frame, whose messages arrive one by one.

    Attributes:
        stamp_ns: its stamp.
        since_s: when its first message was heard.
        values: keys and values of `solution`; empty before that message.
        attitude: from `imu`; an unsolved frame has none.
        stars: rows (n,) of `identified_stars`, one for each centroid; None before that message.
    """

    stamp_ns: int
    since_s: float
    values: Mapping[str, str] = field(default_factory=dict)
    attitude: Attitude | None = None
    stars: NDArray[np.void] | None = None

    @property
    def status(self) -> str:
        """SOLVED, or why not."""
        return self.values.get("status", "?")

    @property
    def complete(self) -> bool:
        """Whether all messages that this frame will have are here."""
        # Only a frame without centroids, or one that cannot be read, has no cloud.
        has_stars = self.stars is not None or self.values.get("total") == "0"
        has_attitude = self.attitude is not None or self.status != "SOLVED"
        return bool(self.values) and has_stars and has_attitude


@dataclass(frozen=True)
class Report:
    """A status of /diagnostics: level (`OK`, `WARN`, ...), sentence, values, when it was heard."""

    level: str
    message: str
    values: Mapping[str, str]
    heard_s: float


@dataclass
class Watched:
    """One identify_node as seen from outside.

    Attributes:
        namespace: the node's, from `/`.
        name: the node's own; empty before its first message.
        frame: the last one.
        solved: the last one with an attitude.
        reports: the last of each kind, such as `health`.
        trouble: a message that could not be read, in a sentence.
    """

    namespace: str = "/"
    name: str = ""
    frame: Frame | None = None
    solved: Frame | None = None
    reports: dict[str, Report] = field(default_factory=dict)
    trouble: str = ""
    _arriving: list[Frame] = field(init=False, default_factory=list)

    @property
    def full_name(self) -> str:
        """Namespace and name of the node; `identify_node` while its own name is not known."""
        return f"{self.namespace.rstrip('/')}/{self.name or 'identify_node'}"

    def arriving(self, stamp_ns: int, now_s: float) -> Frame:
        """Return the frame of this stamp, to be filled with what has just been heard."""
        # Frames can have the same stamp, such as 0: a complete one gets no more messages.
        for frame in self._arriving:
            if frame.stamp_ns == stamp_ns and not frame.complete:
                return frame
        self._arriving.append(Frame(stamp_ns, now_s))
        return self._arriving[-1]

    def take(self, now_s: float) -> list[Frame]:
        """Return the frames that are complete or have waited long enough, in order of arrival."""
        done = [f for f in self._arriving if f.complete or now_s - f.since_s > PATIENCE_S]
        self._arriving = [frame for frame in self._arriving if frame not in done]
        # One without `solution` is from before the first message that was heard.
        frames = [frame for frame in done if frame.values]
        for frame in frames:
            self.frame = frame
            self.solved = frame if frame.attitude is not None else self.solved
        return frames

    def on_report(self, status_name: str, report: Report) -> None:
        """Keep a status if it is this node's: all nodes share /diagnostics."""
        full_name, separator, kind = status_name.partition(": ")
        namespace, _, name = full_name.strip("/").rpartition("/")
        if not separator or f"/{namespace}" != self.namespace or self.name not in ("", name):
            return
        self.name = name
        self.reports[kind] = report


def attitude_from_orientation(quaternion_xyzw: Floats, covariance_rad2: Floats) -> Attitude:
    """Return the attitude that `imu` carries.

    Its covariance (3, 3) is about the axes of the reference frame, R P R^T. P, about the camera's
    axes, tells the errors of the boresight (x, y) and of the roll (z) apart.
    Raises ValueError for a quaternion (4,) that is no rotation.
    """
    if not 0 < np.linalg.norm(quaternion_xyzw) < np.inf:
        raise ValueError("the orientation is no rotation")
    rotation = rotation_matrix(quaternion_xyzw)
    return Attitude.from_rotation(rotation, rotation.T @ covariance_rad2 @ rotation)
