"""Lost-in-space star identification and attitude determination.

    from star_tracker import Camera, FeatureDatabase, SolveSettings, StarCatalog, StarTracker

The names below are what most users need; each is imported when it is first used. The package
imports no ROS but in `star_tracker.nodes`; its compiled core needs numpy, scipy and numba.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from star_tracker.catalogue.catalog import StarCatalog as StarCatalog
    from star_tracker.catalogue.database import FeatureDatabase as FeatureDatabase
    from star_tracker.optics.camera import Camera as Camera
    from star_tracker.solution import Solution as Solution
    from star_tracker.solution import SolveSettings as SolveSettings
    from star_tracker.solution import Status as Status
    from star_tracker.tracker import StarTracker as StarTracker

__all__ = [
    "Camera", "FeatureDatabase", "Solution", "SolveSettings", "StarCatalog", "StarTracker",
    "Status",
]
#: Where each public name lives.
_HOMES = {
    "Camera": "star_tracker.optics.camera",
    "FeatureDatabase": "star_tracker.catalogue.database",
    "Solution": "star_tracker.solution",
    "SolveSettings": "star_tracker.solution",
    "StarCatalog": "star_tracker.catalogue.catalog",
    "StarTracker": "star_tracker.tracker",
    "Status": "star_tracker.solution",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
