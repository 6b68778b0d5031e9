"""Where will the camera point? A constant rate from the last two fixes, for tracking.

Quaternions are tuples (x, y, z, w) of plain numbers here: with arrays, or with scipy's rotations,
a prediction would take a third of the time that the search of a frame takes.
"""

import math
from collections.abc import Sequence

import numpy as np

from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.geometry.spherical import Floats

#: How a node uses a prediction: `auto` = wherever there is one, `lost_in_space` = never.
PREDICTION_MODES = ("auto", "lost_in_space")
#: Two fixes that ask for more than this are a jump, not a motion: no rate follows from them.
_FASTEST_RAD_PER_S = math.radians(60.0)

Quaternion = tuple[float, float, float, float]
_AT_REST = (0.0, 0.0, 0.0)


class Predictor:
    """Remembers the last fix and a rate, and says where the camera points at a later stamp.

    Stamps are whole nanoseconds of any one clock; one that goes back forgets everything, as the
    clock has jumped or a recording starts again.

    Args:
        max_age_s: a fix older than this predicts nothing. Raises ValueError where it is negative.
    """

    def __init__(self, max_age_s: float = 2.0) -> None:
        if not max_age_s >= 0:
            raise ValueError("max_age_s must be 0 or more")
        self._max_age_s = max_age_s
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._fix: tuple[int, Quaternion] | None = None
        self._newest_ns: int | None = None
        self._rate: tuple[float, float, float] = _AT_REST  # rad/s about the camera's axes

    def predict(self, stamp_ns: int) -> Floats | None:
        """Return the rotation (3, 3), camera to ICRS, expected at a stamp; None = not known."""
        if self._newest_ns is not None and stamp_ns < self._newest_ns:
            self.reset()
        self._newest_ns = stamp_ns
        if self._fix is None:
            return None
        fixed_ns, quaternion = self._fix
        age_s = (stamp_ns - fixed_ns) / 1e9
        if age_s > self._max_age_s:
            return None
        return rotation_matrix(np.array(_product(quaternion, _turn(self._rate, age_s))))

    def add(self, stamp_ns: int, quaternion_xyzw: Floats) -> None:
        """Take in a fix: the unit quaternion (4,) that turns camera-frame vectors into ICRS."""
        quaternion = _tuple(quaternion_xyzw.tolist())
        if self._fix is not None:
            fixed_ns, (x, y, z, w) = self._fix
            elapsed_s = (stamp_ns - fixed_ns) / 1e9
            if elapsed_s < 0:
                self.reset()
            elif elapsed_s > 0:  # a stamp that repeats tells nothing of the rate
                self._rate = _rate(_product((-x, -y, -z, w), quaternion), elapsed_s)
                jump = math.hypot(*self._rate) > _FASTEST_RAD_PER_S
                if jump or elapsed_s > self._max_age_s:
                    self._rate = _AT_REST
        self._fix, self._newest_ns = (stamp_ns, quaternion), stamp_ns


def _tuple(values: Sequence[float]) -> Quaternion:
    x, y, z, w = values
    return x, y, z, w


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the quaternion that turns by b first and by a then."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz,
    )


def _turn(rate: tuple[float, float, float], seconds: float) -> Quaternion:
    """Return the quaternion of a constant rate, rad/s, over some time."""
    speed = math.hypot(*rate)
    half = speed * seconds / 2
    scale = math.sin(half) / speed if speed > 0 else 0.0
    return rate[0] * scale, rate[1] * scale, rate[2] * scale, math.cos(half)


def _rate(turn: Quaternion, seconds: float) -> tuple[float, float, float]:
    """Return the constant rate, rad/s, that makes a turn in some time, the shorter way round."""
    x, y, z, w = turn if turn[3] >= 0 else (-turn[0], -turn[1], -turn[2], -turn[3])
    sine = math.hypot(x, y, z)
    scale = 2 * math.atan2(sine, w) / (sine * seconds) if sine > 0 else 0.0
    return x * scale, y * scale, z * scale
