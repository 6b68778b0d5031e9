"""What an identify_node says, gathered frame by frame from plain values. No ROS here.

Times `now_s` are seconds of a clock that never goes back, as `time.monotonic`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import StarState

#: How long a frame waits for what is still missing of it, s: a message may be lost on the way.
PATIENCE_S = 0.5
#: Without a report for so long the node is said to be silent, s; it reports once a second.
SILENT_S = 3.0
_STATES = {int(state): state.name.lower() for state in StarState}
_ARCSEC_PER_RAD = math.degrees(1) * 3600


@dataclass(frozen=True)
class Pose:
    """An attitude as it was published.

    Attributes:
        quaternion_xyzw: (4,) rotates camera-frame vectors into the reference frame.
        sigma_arcsec: (3,) standard deviations of the small rotation about the camera's x, y, z.
        boresight_deg: (3,) right ascension, declination and roll.
    """

    quaternion_xyzw: Floats
    sigma_arcsec: Floats
    boresight_deg: Floats


@dataclass(frozen=True)
class Frame:
    """How one frame ended: its stamp, the values of `solution`, its pose and its stars.

    `stars` has a row for each centroid with the fields of `identified_stars`; None where they
    were not heard, as those of a frame that could not be read.
    """

    stamp_ns: int
    values: Mapping[str, str]
    pose: Pose | None
    stars: NDArray[np.void] | None

    @property
    def status(self) -> str:
        """SOLVED, or why not."""
        return self.values.get("status", "?")


@dataclass(frozen=True)
class Report:
    """A status of /diagnostics: its level (`OK`, `WARN`, `ERROR`, `STALE`), sentence, values."""

    level: str
    message: str
    values: Mapping[str, str]


@dataclass
class _Parts:
    """What has come of a frame so far."""

    since_s: float
    values: Mapping[str, str] | None = None
    orientation: tuple[Floats, Floats] | None = None
    boresight_deg: Floats | None = None
    stars: NDArray[np.void] | None = None

    @property
    def complete(self) -> bool:
        if self.values is None:
            return False
        # Only a frame without centroids, or one that cannot be read, comes without a cloud.
        stars = self.stars is not None or self.values.get("total") == "0"
        pose = self.orientation is not None and self.boresight_deg is not None
        return stars and (pose or self.values.get("status") != "SOLVED")


@dataclass
class Watched:
    """One identify_node as seen from outside.

    Attributes:
        namespace: the node's, from `/`.
        name: the node's own; unknown before its first frame or report.
        frame: the last one.
        frame_s: when it was heard.
        pose: of the last frame that was solved.
        pose_s: when that was heard.
        health: its last report.
        health_s: when it was heard.
        focal_length: its last report, where the node follows the focal length.
        trouble: a message that could not be read, in a sentence.
        n_frames: frames heard.
    """

    namespace: str = "/"
    name: str = ""
    frame: Frame | None = None
    frame_s: float = -math.inf
    pose: Pose | None = None
    pose_s: float = -math.inf
    health: Report | None = None
    health_s: float = -math.inf
    focal_length: Report | None = None
    trouble: str = ""
    n_frames: int = 0
    _pending: dict[int, _Parts] = field(init=False, default_factory=dict)

    @property
    def full_name(self) -> str:
        """Namespace and name of the node; `identify_node` where it has not said its own."""
        return f"{self.namespace.rstrip('/')}/{self.name or 'identify_node'}"

    @property
    def heard(self) -> bool:
        """Whether the node has been heard at all."""
        return self.frame is not None or self.health is not None

    def on_solution(
        self, stamp_ns: int, name: str, values: Mapping[str, str], now_s: float
    ) -> None:
        """Take in how a frame ended, as the node of this name says."""
        self.name = name
        self._parts(stamp_ns, now_s).values = values

    def on_orientation(
        self, stamp_ns: int, orientation: tuple[Floats, Floats], now_s: float
    ) -> None:
        """Take in a quaternion (4,) and its covariance (3, 3) about the reference axes, rad^2."""
        self._parts(stamp_ns, now_s).orientation = orientation

    def on_boresight(self, stamp_ns: int, boresight_deg: Floats, now_s: float) -> None:
        """Take in right ascension, declination and roll (3,)."""
        self._parts(stamp_ns, now_s).boresight_deg = boresight_deg

    def on_stars(self, stamp_ns: int, stars: NDArray[np.void], now_s: float) -> None:
        """Take in the rows (n,) of `identified_stars`."""
        self._parts(stamp_ns, now_s).stars = stars

    def on_report(self, status: str, report: Report, now_s: float) -> None:
        """Take in a status of /diagnostics if it is this node's; other nodes report there too."""
        full_name, _, topic = status.partition(": ")
        namespace, _, name = full_name.rpartition("/")
        if (namespace or "/") != self.namespace or (self.name and name != self.name):
            return
        if topic == "health":
            self.name, self.health, self.health_s = name, report, now_s
        elif topic == "focal length":
            self.focal_length = report

    def take(self, now_s: float) -> list[Frame]:
        """Return the frames that are complete, or have waited long enough, in order of arrival."""
        done = [
            stamp for stamp, parts in self._pending.items()
            if parts.complete or now_s - parts.since_s > PATIENCE_S
        ]
        frames = []
        for stamp in done:
            parts = self._pending.pop(stamp)
            # Parts without an end belong to a frame from before the first message that was heard.
            if parts.values is not None:
                frames.append(self._frame(stamp, parts))
        if frames:
            self.frame, self.frame_s = frames[-1], now_s
            self.n_frames += len(frames)
        return frames

    def _parts(self, stamp_ns: int, now_s: float) -> _Parts:
        return self._pending.setdefault(stamp_ns, _Parts(now_s))

    def _frame(self, stamp_ns: int, parts: _Parts) -> Frame:
        pose = None
        if parts.orientation is not None and parts.boresight_deg is not None:
            quaternion, covariance = parts.orientation
            pose = Pose(quaternion, sigma_arcsec(quaternion, covariance), parts.boresight_deg)
            self.pose, self.pose_s = pose, parts.since_s
        return Frame(stamp_ns, parts.values or {}, pose, parts.stars)


def sigma_arcsec(quaternion_xyzw: Floats, covariance_rad2: Floats) -> Floats:
    """Return the standard deviations (3,) of an attitude about the camera's axes, arcsec.

    The covariance (3, 3) of Imu is about the axes of the reference frame: R P R^T, with P about
    the camera's. About those the errors of the boresight (x, y) and of the roll (z) stand apart.
    """
    rotation = Rotation.from_quat(quaternion_xyzw).as_matrix()
    variances = np.diag(rotation.T @ covariance_rad2 @ rotation)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)) * _ARCSEC_PER_RAD)


def state_name(star: np.void) -> str:
    """Return the state of a row of `identified_stars` in a word, or its number if it has none."""
    state = int(star["state"])
    return _STATES.get(state, str(state))
