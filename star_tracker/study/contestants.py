"""Who is measured: our methods, the paper's forms of them and the peers are all contestants.

A contestant is a set of plain values, so that it can be told apart, stored and sent to another
process. Set up for a camera it becomes an entrant, which takes frames.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import Condition
from star_tracker.optics.camera import Camera
from star_tracker.study.scenes import Scene, Sky

#: Highest over lowest field of view of a range that counts as one: 1 % either way.
ONE_SIZE = 1.021


@dataclass(frozen=True)
class Told:
    """What an identifier is told before the frames come.

    Attributes:
        sky: the guide stars.
        camera: the camera, which may be wrong.
        fov_range_deg: between which the true field of view lies.
        noise_px: the true noise of a centroid along each axis.
        deadline_ms: give up on a frame after this wall-clock time.
    """

    sky: Sky
    camera: Camera
    fov_range_deg: tuple[float, float]
    noise_px: float
    deadline_ms: float

    @property
    def fov_tolerance_percent(self) -> float:
        """How far the field of view may be off, 0 where it is told to 1 %: that is exact."""
        low, high = self.fov_range_deg
        if high <= ONE_SIZE * low:
            return 0.0
        told_deg = self.camera.fov_deg
        return 100 * max(high / told_deg - 1, 1 - low / told_deg)

    @classmethod
    def of(cls, sky: Sky, camera: Camera, condition: Condition, deadline_ms: float) -> "Told":
        """Return what is told under a condition of a true camera."""
        return cls(
            sky, condition.told_camera(camera), condition.fov_range_deg(camera),
            condition.noise_px, deadline_ms,
        )


@dataclass(frozen=True)
class Answer:
    """What became of a frame.

    Attributes:
        rotation: (3, 3) camera to ICRS; None = not solved.
        ended: why not, a name of `Status`.
        catalog_index: (n,) the guide star of each centroid, -1 = none; None = it names none.
        covariance_rad2: (3, 3) of small rotations about the camera's axes; None = it tells none.
    """

    rotation: Floats | None
    ended: str = "NO_MATCH"
    catalog_index: NDArray[np.int64] | None = None
    covariance_rad2: Floats | None = None


@dataclass(frozen=True)
class Entrant:
    """A contestant set up for one camera.

    Attributes:
        prepare: puts a frame into the form that `solve` takes.
        solve: the identifier's own call, which is timed, and nothing else.
        answer: reads what `solve` returned.
        storage_bytes: size of the features that it searches; None = not known.
    """

    prepare: Callable[[Scene], Any]
    solve: Callable[[Any], Any]
    answer: Callable[[Any], Answer]
    storage_bytes: int | None = None


@dataclass(frozen=True)
class Contestant(ABC):
    """An identifier with its settings.

    Attributes:
        name: what tables call it; empty = its method or package.
        every: it sees only every so-many-th frame, if it is slow.
        brightness: it is told the brightness where that is measured.
        package: what has to be installed for it, empty for this package itself.
        names_stars: whether its answers name the stars, as the star maps ask for.
    """

    name: str = ""
    every: int = 1
    brightness: bool = True
    package: ClassVar[str] = ""
    names_stars: ClassVar[bool] = False

    @property
    def title(self) -> str:
        """What tables call it."""
        return self.name or self.package

    @property
    @abstractmethod
    def settings(self) -> str:
        """How it is set up, in words."""

    def declines(self, condition: Condition) -> str:
        """Return why it cannot take part under a condition; empty where it can."""
        return "" if condition.fov_error_percent is not None else "it needs a field of view"

    @abstractmethod
    def set_up(self, told: Told) -> Entrant:
        """Make it ready for a camera. Raises ImportError where its package is missing."""

    def told_brightness(self) -> str:
        """Return in words whether it is told the brightness."""
        return f"with{'' if self.brightness else 'out'} brightness"
