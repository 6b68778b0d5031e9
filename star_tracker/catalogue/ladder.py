"""Databases for a camera whose field of view is not known: a ladder of depths.

A catalogue that suits 10 deg has too few stars for 4 deg and too many for 40. So the range of
fields is cut into steps, each with the database of the field in its middle, which is built when it
is first used.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby, pairwise

from star_tracker.catalogue.catalog import REFERENCE_EPOCH
from star_tracker.catalogue.database import MAX_SEPARATION_RANGE_DEG, FeatureDatabase
from star_tracker.catalogue.depth import (
    DEEPEST,
    Depth,
    limiting_magnitude_for,
    solid_angle_sr,
)
from star_tracker.catalogue.triangles import ANY_SCALE
from star_tracker.optics.camera import Camera

#: Largest factor between the ends of a step: its fields hold 24 to 66 guide stars on the average.
STEP_FACTOR = 1.65


@dataclass(frozen=True)
class LadderStep:
    """A range of fields of view, degrees across the width, and the database that serves it."""

    fov_min_deg: float
    fov_max_deg: float
    width_px: int
    height_px: int
    catalog: str = "hipparcos"
    epoch: float = REFERENCE_EPOCH
    depth: Depth = field(default_factory=Depth)

    @property
    def camera(self) -> Camera:
        """The camera in the middle of the range."""
        middle_deg = math.sqrt(self.fov_min_deg * self.fov_max_deg)
        return Camera.from_fov(middle_deg, self.width_px, self.height_px)

    @cached_property
    def database(self) -> FeatureDatabase:
        """The database, made at the first use. Raises ValueError as `StarCatalog.named`.

        What is searched without a scale is the shapes of its `triangles`. Its pairs are a few:
        once a camera is found, `FeatureDatabase.for_camera` has those that suit it.
        """
        return FeatureDatabase.build(
            self.depth.stars_for(self.camera, self.catalog, self.epoch),
            max_separation_deg=MAX_SEPARATION_RANGE_DEG[0], triangle_grid=ANY_SCALE,
        )


def ladder(
    fov_range_deg: tuple[float, float],
    size_px: tuple[int, int],
    *,
    catalog: str = "hipparcos",
    epoch: float = REFERENCE_EPOCH,
    depth: Depth | None = None,
) -> tuple[LadderStep, ...]:
    """Return the steps from the narrowest field to the widest, for an image of width and height.

    Neighbours that the catalogue serves with one depth are one step. Raises ValueError for a
    range that is none, and as `Camera.from_fov`.
    """
    low, high = fov_range_deg
    if not 0 < low <= high:
        raise ValueError(
            f"fov_min_deg {low:g} is not below fov_max_deg {high:g}: "
            "give the narrowest and the widest field of view in question"
        )
    depth = depth or Depth()
    if catalog not in DEEPEST or depth.limiting_magnitude != 0:
        return (LadderStep(low, high, *size_px, catalog, epoch, depth),)
    n = max(1, math.ceil(math.log(high / low) / math.log(STEP_FACTOR)))
    edges = [low * (high / low) ** (i / n) for i in range(n)] + [high]
    steps = [
        LadderStep(*ends, *size_px, catalog, epoch, depth)
        for ends in pairwise(edges)
    ]
    joined = [
        list(same) for _, same in groupby(
            steps, lambda step: limiting_magnitude_for(catalog, solid_angle_sr(step.camera))
        )
    ]
    return tuple(replace(same[0], fov_max_deg=same[-1].fov_max_deg) for same in joined)
