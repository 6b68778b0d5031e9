"""What the user asks of a frame's solution, and what comes back."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, TypeVar

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.ended import MIN_STARS
from star_tracker.identification.fallback import RadialCyclicSettings
from star_tracker.identification.labels import Identification
from star_tracker.identification.searcher import LOST_IN_SPACE, METHODS
from star_tracker.optics.camera import Camera

_Kind = TypeVar("_Kind", bound="_UnpackedLate")
#: A standard error below this part of what was known beforehand comes from the stars.
_NEWS = 0.7
#: Allowed values of the settings, both ends included.
CENTROID_SIGMA_RANGE_PX = (0.0, 100.0)
DISPLACED_GATE_RANGE_PX = (0.0, 1000.0)
LOG10_FALSE_ALARMS_RANGE = (-100.0, 0.0)


class Status(Enum):
    """How a frame ended. Everything but SOLVED comes without an attitude."""

    SOLVED = "SOLVED"
    TOO_FEW_STARS = "TOO_FEW_STARS"
    NO_MATCH = "NO_MATCH"
    AMBIGUOUS = "AMBIGUOUS"
    TIMEOUT = "TIMEOUT"
    BAD_INPUT = "BAD_INPUT"


@dataclass(frozen=True)
class SolveSettings:
    """What the user decides. Raises ValueError for a value out of range, naming it.

    Attributes:
        method: `match_group`, `radial_cyclic`, or `auto`: the first, then the second.
        match_group: the primary matcher's settings.
        radial_cyclic: the fallback's settings.
        centroid_sigma_px: standard deviation of a centroid along each axis, where it is known;
            0 = find out from each frame. A known noise makes weak evidence a little stronger.
        displaced_gate_px: farthest a displaced star may lie from its place; 0 labels none.
        max_log10_false_alarms: accept a hypothesis whose log10 false alarms are below this.
        deadline_ms: give up after this time; infinity never does.
        max_centroids: of more the brightest are searched, or, where brightness is not known, an
            even sample.
    """

    method: str = "auto"
    match_group: MatchGroupSettings = field(default_factory=MatchGroupSettings)
    radial_cyclic: RadialCyclicSettings = field(default_factory=RadialCyclicSettings)
    centroid_sigma_px: float = 0.0
    displaced_gate_px: float = 40.0
    max_log10_false_alarms: float = -3.0
    deadline_ms: float = 200.0
    max_centroids: int = 1000

    def __post_init__(self) -> None:
        if self.method != "auto" and self.method not in METHODS:
            raise ValueError(f"method {self.method!r} is unknown: use auto, {', '.join(METHODS)}")
        for name, (low, high) in (
            ("centroid_sigma_px", CENTROID_SIGMA_RANGE_PX),
            ("displaced_gate_px", DISPLACED_GATE_RANGE_PX),
            ("max_log10_false_alarms", LOG10_FALSE_ALARMS_RANGE),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} must be from {low:g} to {high:g}")
            # An integer, or a float of another size, would have the path compiled anew for it.
            object.__setattr__(self, name, float(value))
        if not self.deadline_ms > 0:
            raise ValueError("deadline_ms must be greater than 0")
        if self.max_centroids < MIN_STARS:
            raise ValueError(f"max_centroids must be at least {MIN_STARS}")


class _UnpackedLate:
    """An object whose fields are worked out when one of them is first read.

    To make the parts of a solution takes a fifth of a clear frame's time, and many a user reads
    some of them alone.
    """

    __slots__ = ("_late",)
    _late: tuple[Callable[..., dict[str, Any]], tuple[Any, ...]] | None

    @classmethod
    def later(
        cls: type[_Kind], unpack: Callable[..., dict[str, Any]], *packed: Any
    ) -> _Kind:
        """Return an object whose fields `unpack(*packed)` returns, by name."""
        made = object.__new__(cls)
        object.__setattr__(made, "_late", (unpack, packed))
        return made

    def __getattr__(self, name: str) -> Any:
        """Work out the fields: this is called for one that is not there yet."""
        if name not in type(self).__slots__:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        late = self._late
        if late is not None:  # else another thread has just been through here
            for field_name, value in late[0](*late[1]).items():
                object.__setattr__(self, field_name, value)
            object.__setattr__(self, "_late", None)
        return object.__getattribute__(self, name)


@dataclass(frozen=True, slots=True, eq=False)  # arrays have no one answer
class Solution(_UnpackedLate):
    """What one frame gave.

    Attributes:
        status: SOLVED or why not; `reason` says it in a sentence.
        identification: one row for each centroid, also of an unsolved frame.
        attitude: only where solved.
        method: the matcher that found the solution, empty where none did.
        parity: the parity under which it was found, empty where none was.
        wrong_probability: that the identification is wrong, where frames that show the sky and
            frames that do not are equally likely; 1 where unsolved. It compares the best pose's
            evidence with that of all others seen and of none. Of a camera that is not as told, a
            wrong field of view above all, it knows nothing.
        log10_false_alarms: of the best hypothesis, solved or not; infinity where there was none.
            That many frames of unrelated points, at the most, would look as good.
        rms_px: root mean square residual of the identified stars, NaN where unsolved.
        n_hypotheses: how many hypotheses were compared.
        n_ignored: centroids left out because they are not finite or lie outside of the image.
        n_surplus: centroids left out because there are more than `max_centroids`.
        solve_ms: wall-clock time.
        mode: `lost_in_space`, or `tracking` where a predicted attitude led to the solution.
        told_camera: the camera as it was told, of the parity found; None where unsolved.
        scale: the focal length as found, as a multiple of the told one.
        focal_length_error: standard error of the focal length, relative; 0 where it was told
            without tolerance and so is not fitted, unless the stars contradict it
            (`identification/contradiction.py`). What was told beforehand is in it. Of a lens that
            bends and is not told it knows nothing: with k1 = -0.1 at 30 deg a focal length found
            in one frame is off by 0.5 %, thirteen such errors. `LearningTracker` and `calibrate`
            fit the lens.
        centroid_sigma_px: noise of a centroid along each axis that the covariance is made with.
        catalog: the catalogue that `catalog_index` counts in; None where unsolved.
    """

    status: Status
    reason: str
    identification: Identification
    attitude: Attitude | None = None
    method: str = ""
    parity: str = ""
    wrong_probability: float = 1.0
    log10_false_alarms: float = float("inf")
    rms_px: float = float("nan")
    n_hypotheses: int = 0
    n_ignored: int = 0
    n_surplus: int = 0
    solve_ms: float = 0.0
    mode: str = LOST_IN_SPACE
    told_camera: Camera | None = None
    scale: float = 1.0
    focal_length_error: float = float("nan")
    centroid_sigma_px: float = float("nan")
    catalog: StarCatalog | None = None

    @property
    def camera(self) -> Camera | None:
        """The camera as found: the told one with the focal length that the stars show."""
        if self.told_camera is None or self.scale == 1.0:
            return self.told_camera
        return self.told_camera.scaled(self.scale)

    @property
    def focal_length_from_stars(self) -> bool:
        """Whether the stars tell the focal length at least as well as it was told."""
        told = self.told_camera
        if told is None or not self.focal_length_error > 0:
            return False
        return self.focal_length_error < _NEWS * (told.tolerance_percent / 100 or math.inf)
