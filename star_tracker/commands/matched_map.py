"""A star map with its stars matched to the catalogue: what the calibration commands work on."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.star_map import Pose, StarMap, paper_maps, read_star_map
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker


@dataclass(frozen=True)
class MatchedMap:
    """The known stars of a star map.

    Attributes:
        name: the map's name.
        camera: its camera.
        labels: (n,) the centroids' names.
        xy_px: (n, 2) centroids.
        star_vectors: (n, 3) unit vectors, ICRS.
        source: who says which stars they are.
        pose: the true pose, where known.
    """

    name: str
    camera: Camera
    labels: tuple[str, ...]
    xy_px: Floats
    star_vectors: Floats
    source: str
    pose: Pose | None


def load(number_or_path: str) -> MatchedMap:
    """Return map 1 to 8 or a star map file with its stars matched.

    The file's own star numbers count, without the stars marked as displaced; a file without any
    is identified. Raises ValueError for a file that cannot be read, an unknown star number or
    map, or a map that cannot be identified.
    """
    if number_or_path.isdecimal():
        (star_map,) = paper_maps((int(number_or_path),))
    else:
        star_map = read_star_map(Path(number_or_path))
    catalog = StarCatalog.paper()
    if np.any(star_map.star_number):
        which = np.flatnonzero((star_map.star_number != 0) & (star_map.displaced_px == 0))
        index = _by_number(catalog, star_map.star_number[which])
        source = "star numbers of the map"
    else:
        which, index, source = _identify(catalog, star_map)
    return MatchedMap(
        star_map.name, star_map.camera, tuple(star_map.labels[i] for i in which),
        star_map.xy_px[which], catalog.vectors[index], source, star_map.pose,
    )


def _by_number(catalog: StarCatalog, number: NDArray[np.int64]) -> NDArray[np.intp]:
    index = np.minimum(np.searchsorted(catalog.number, number), len(catalog) - 1)
    unknown = number[catalog.number[index] != number]
    if len(unknown):
        raise ValueError(f"star number {unknown[0]} is not in the catalogue of the paper")
    return index


def _identify(
    catalog: StarCatalog, star_map: StarMap
) -> tuple[NDArray[np.intp], NDArray[np.int64], str]:
    """Return which centroids were identified, their catalogue indices, and by what."""
    settings = SolveSettings(deadline_ms=float("inf"))
    tracker = StarTracker(FeatureDatabase.build(catalog), star_map.camera, settings)
    solution = tracker.solve(star_map.xy_px)
    if solution.status is not Status.SOLVED:
        raise ValueError(
            f"{star_map.name} has no star numbers and was not identified: "
            f"{solution.status.value}, {solution.reason}"
        )
    which = solution.identification.identified
    return which, solution.identification.catalog_index[which], f"identified: {solution.method}"
