"""How deep a catalogue, and how far its features, suit a field of view.

A guide star that the image does not show is one more chance of a wrong match, a star of the image
that the catalogue lacks is one right match less. What suits is a few dozen guide stars a field:
the magnitude comes from the catalogue's own star counts. Pairs and patterns reach so far that a
star has as many companions as in the paper's catalogue (docs/catalogues.md).
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from star_tracker.catalogue.catalog import (
    GAIA_MAGNITUDE_RANGE,
    LIMITING_MAGNITUDE_RANGE,
    MIN_SEPARATION_RANGE_DEG,
    StarCatalog,
)
from star_tracker.catalogue.pairs import MAX_DIRECTED_PAIRS
from star_tracker.catalogue.patterns import PatternSettings
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera

#: Catalogues whose depth can be chosen, and where they end.
DEEPEST = {
    "hipparcos": LIMITING_MAGNITUDE_RANGE[1], "gaia": GAIA_MAGNITUDE_RANGE[1],
}
#: Guide stars of the average field; 22 to 67 then lie in nine fields of ten.
GUIDE_STARS = 40.0
#: Never shallower: what a wide lens sees in a bright sky.
FLOOR_MAGNITUDE = 4.0
#: Magnitudes are rounded up to whole steps, so that cameras of nearly one field share a database.
MAGNITUDE_STEP = 0.1
#: Companions of a star in its pairs, and neighbours in its pattern, at the mean density: those
#: of the paper's 12 deg and 6 deg among its 4908 stars.
COMPANIONS = 54.0
NEIGHBOURS = 13.5
#: Directed pairs are so many times those of evenly spread stars, at the most: the Milky Way.
_CLUSTERING = 1.4
#: Pixels closer than which two stars are one centroid: two standard deviations of a star image
#: as sharp as centroids want it (benchmark/merging.py).
BLEND_PX = 2.0
#: No wider, so that pairs are found among the near stars that one image shows.
_WIDEST_RAD = math.radians(30.0)
_NARROWEST_RAD = math.radians(0.5)
_PAPER = PatternSettings()


@dataclass(frozen=True)
class Depth:
    """What of a catalogue is searched; the defaults let the camera decide.

    Attributes:
        limiting_magnitude: the faintest guide stars, 0 = automatic.
        min_separation_deg: stars closer than this are merged, None = automatic.
        max_separation_deg: largest separation of a pair, 0 = automatic.
    """

    limiting_magnitude: float = 0.0
    min_separation_deg: float | None = None
    max_separation_deg: float = 0.0

    def stars_for(self, camera: Camera, catalog: str, epoch: float) -> StarCatalog:
        """Return the guide stars that suit a camera. Raises ValueError as `StarCatalog.named`."""
        limit, apart = self.limiting_magnitude, self.min_separation_deg
        if limit == 0 and catalog in DEEPEST:
            limit = limiting_magnitude_for(catalog, solid_angle_sr(camera))
        return StarCatalog.named(
            catalog, limiting_magnitude=limit, epoch=epoch,
            min_separation_deg=blend_separation_deg(camera) if apart is None else apart,
        )


def limiting_magnitude_for(
    catalog: str, solid_angle_sr: float, *, stars: float = GUIDE_STARS
) -> float:
    """Return the magnitude to which a field holds so many stars on the average.

    `catalog` is `hipparcos` or `gaia`. The result lies between `FLOOR_MAGNITUDE` and the end of
    the catalogue. Raises ValueError where the package of `gaia` is missing.
    """
    magnitudes, deepest = _magnitudes(catalog)
    wanted = round(stars * 4 * math.pi / solid_angle_sr)
    if wanted >= len(magnitudes):
        return deepest
    steps = math.ceil(float(magnitudes[wanted]) / MAGNITUDE_STEP - 1e-6)
    return min(max(round(steps * MAGNITUDE_STEP, 6), FLOOR_MAGNITUDE), deepest)


def solid_angle_sr(camera: Camera) -> float:
    """Return the solid angle of a camera's image, its lens and principal point left aside."""
    a, b = camera.width_px / 2 / camera.fx_px, camera.height_px / 2 / camera.fy_px
    return 4 * math.atan(a * b / math.sqrt(1 + a * a + b * b))


def stars_in_view(n_stars: int, camera: Camera) -> float:
    """Return how many of so many stars the average field of a camera shows."""
    return n_stars * solid_angle_sr(camera) / (4 * math.pi)


def blend_separation_deg(camera: Camera) -> float:
    """Return the angle below which a camera takes two stars for one, in steps of 2^(1/2)."""
    low, high = MIN_SEPARATION_RANGE_DEG
    steps = round(2 * math.log2(math.degrees(BLEND_PX / camera.focal_length_px)))
    return float(np.clip(2 ** (steps / 2), low, high))


def separation_for(n_stars: int) -> float:
    """Return the largest separation of pairs, rad, for a catalogue of so many stars."""
    most = MAX_DIRECTED_PAIRS / _CLUSTERING / max(n_stars, 1)
    return max(_radius_with(n_stars, min(COMPANIONS, most)), _NARROWEST_RAD)


def pattern_settings_for(n_stars: int) -> PatternSettings:
    """Return the patterns' geometry for a catalogue of so many stars: the paper's, scaled."""
    ring_rad = _radius_with(n_stars, NEIGHBOURS) / _PAPER.n_rings
    return PatternSettings(_PAPER.n_rings * ring_rad, ring_rad)


def _radius_with(n_stars: int, companions: float) -> float:
    """Return the radius, rad, within which a star has so many of `n_stars` on the average."""
    share = companions / max(n_stars, 1)
    return min(math.acos(max(1 - 2 * share, -1.0)), _WIDEST_RAD)


@cache
def _magnitudes(catalog: str) -> tuple[Floats, float]:
    """Return all magnitudes of a catalogue (n,), ascending, and where it ends."""
    deepest = DEEPEST[catalog]
    stars = StarCatalog.named(catalog, limiting_magnitude=deepest, min_separation_deg=0.0)
    return np.sort(stars.v_mag), deepest
