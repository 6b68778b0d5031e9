"""What the matchers search: the guide stars, their features and the settings that built them."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from star_tracker.catalogue.catalog import REFERENCE_EPOCH, StarCatalog
from star_tracker.catalogue.depth import Depth, pattern_settings_for, separation_for
from star_tracker.catalogue.feature_file import Features, identity, load_features, save_features
from star_tracker.catalogue.pairs import PairTable, checked_tree
from star_tracker.catalogue.patterns import PatternSettings, PatternTable
from star_tracker.catalogue.sky_index import SkyIndex
from star_tracker.catalogue.triangles import KNOWN_SCALE, Grid, TriangleTable
from star_tracker.optics.camera import Camera
from star_tracker.resources import cache_folder, sources_digest

#: The paper keeps pairs to 12 deg (5.2.4.1): enough for the nearest companions in any wider field.
DEFAULT_MAX_SEPARATION_DEG = 12.0
MAX_SEPARATION_RANGE_DEG = (0.5, 30.0)
#: More stars' patterns take seconds to make, and more memory than their pairs.
MAX_PATTERN_STARS = 15_000


@dataclass(frozen=True)
class FeatureDatabase:
    """A catalogue with its features. Build it once for each catalogue and separation.

    Attributes:
        catalog: the guide stars.
        pairs: the primary matcher's pair table.
        pattern_settings: geometry of the fallback's patterns.
        triangle_grid: cells of the triangles by shape.
        loaded_patterns: patterns out of a file; None = build them.
        cache_note: one line on a cache file that could not be read or saved; mostly empty.
    """

    catalog: StarCatalog
    pairs: PairTable
    pattern_settings: PatternSettings = field(default_factory=PatternSettings)
    triangle_grid: Grid = KNOWN_SCALE
    loaded_patterns: PatternTable | None = None
    cache_note: str = ""

    @classmethod
    def build(
        cls,
        catalog: StarCatalog,
        *,
        max_separation_deg: float = 0.0,
        pattern_settings: PatternSettings | None = None,
        triangle_grid: Grid = KNOWN_SCALE,
    ) -> "FeatureDatabase":
        """Build the features of all stars of a catalogue: 0.2 s for 4908 stars, 1 s for 41,000.

        A largest separation of 0 is automatic: 12 deg, and less for a catalogue deeper than the
        paper's; likewise the patterns without settings. The patterns follow at their first use,
        in another 0.4 s for 4908 stars. Raises ValueError for a separation out of range or too
        many pairs.
        """
        settings = pattern_settings or _default_patterns(len(catalog))
        return cls(
            catalog, PairTable.build(catalog, _separation_rad(max_separation_deg, catalog)),
            settings, triangle_grid,
        )

    @classmethod
    def cached(
        cls,
        catalog: StarCatalog,
        *,
        max_separation_deg: float = 0.0,
        pattern_settings: PatternSettings | None = None,
        with_patterns: bool = True,
        folder: Path | None = None,
    ) -> "FeatureDatabase":
        """Return what `build` returns, patterns included, out of a file where there is one.

        Without patterns they are made at their first use, as by `build`. The file lies in
        `folder`, by default the package's cache folder, and is made where it is missing; one that
        cannot be used is made again. What went wrong with it is told by `cache_note`. Raises
        ValueError as `build`.
        """
        settings = pattern_settings or _default_patterns(len(catalog))
        separation_rad = _separation_rad(max_separation_deg, catalog)
        with_patterns = with_patterns and len(catalog) <= MAX_PATTERN_STARS
        kind = f"{separation_rad!r} {settings!r} {with_patterns}"
        name = identity(catalog, kind, sources_digest())
        where = cache_folder() if folder is None else folder
        path = None if where is None else where / f"features-{name[:16]}.npz"
        notes = [] if path else ["there is no home for a cache of the features"]
        if path is not None:
            try:
                found = load_features(path, name, settings)
                return cls(catalog, found.pairs, settings, loaded_patterns=found.patterns)
            except FileNotFoundError:
                pass
            except ValueError as error:
                notes.append(f"feature file {path} {error}; it is built again")
        database = cls(catalog, PairTable.build(catalog, separation_rad), settings)
        patterns = database.patterns if with_patterns else None
        if path is not None:
            try:
                save_features(path, name, Features(database.pairs, patterns))
            except OSError as error:
                notes.append(f"feature file {path} cannot be saved: {error.strerror or error}")
        return replace(database, loaded_patterns=patterns, cache_note="; ".join(notes))

    @classmethod
    def for_camera(
        cls,
        camera: Camera,
        *,
        catalog: str = "hipparcos",
        epoch: float = REFERENCE_EPOCH,
        depth: Depth | None = None,
        with_patterns: bool = True,
    ) -> "FeatureDatabase":
        """Return the cached database that suits a camera's field of view (`depth.py`).

        The paper's catalogue is what it is: only the largest separation of its pairs can be
        chosen. Raises ValueError as `StarCatalog.named` and `build`.
        """
        depth = depth or Depth()
        stars = depth.stars_for(camera, catalog, epoch)
        apart_deg, settings = depth.max_separation_deg, None
        if catalog != "paper":
            apart_deg = apart_deg or math.degrees(separation_for(len(stars)))
            settings = pattern_settings_for(len(stars))
        return cls.cached(
            stars, max_separation_deg=apart_deg, pattern_settings=settings,
            with_patterns=with_patterns,
        )

    @staticmethod
    def check(catalog: StarCatalog, *, max_separation_deg: float = 0.0) -> None:
        """Raise ValueError where `build` would, without building: in some 0.1 s."""
        checked_tree(catalog, _separation_rad(max_separation_deg, catalog))

    @staticmethod
    def check_patterns(catalog: StarCatalog) -> None:
        """Raise ValueError where a catalogue has too many stars for the fallback's patterns."""
        if len(catalog) > MAX_PATTERN_STARS:
            raise ValueError(
                f"{len(catalog)} guide stars are too dense for method radial_cyclic, which "
                f"takes {MAX_PATTERN_STARS}: lower limiting_magnitude or set method to match_group"
            )

    @cached_property
    def sky_index(self) -> SkyIndex:
        """The guide stars by place on the sky."""
        return SkyIndex.build(self.catalog.vectors)

    @property
    def patterns_available(self) -> bool:
        """Whether the catalogue is small enough for the fallback's patterns."""
        return len(self.catalog) <= MAX_PATTERN_STARS

    @property
    def patterns_note(self) -> str:
        """Why there are no patterns, and what to do about it; empty where there are."""
        try:
            self.check_patterns(self.catalog)
        except ValueError as error:
            return str(error)
        return ""

    @cached_property
    def triangles(self) -> TriangleTable:
        """The guide stars' triangles by shape."""
        return TriangleTable.build(
            self.catalog.vectors, self.catalog.v_mag, grid=self.triangle_grid
        )

    @cached_property
    def patterns(self) -> PatternTable:
        """The fallback's patterns. Raises ValueError where they are not available."""
        if self.loaded_patterns is not None:
            return self.loaded_patterns
        self.check_patterns(self.catalog)
        return PatternTable.build(self.catalog.vectors, self.pattern_settings)

    @cached_property
    def pattern_pairs(self) -> PairTable:
        """All pairs up to the patterns' radius, from which their comparisons are counted."""
        radius = self.pattern_settings.radius_rad
        if self.pairs.max_separation_rad >= radius:
            return self.pairs
        return PairTable.build(self.catalog, radius)

    @property
    def nbytes(self) -> int:
        """Size in memory of the stars, the sky index and the features made so far, bytes.

        The patterns widened for a search come on top, 1.7 kB a star.
        """
        stars, patterns = self.catalog, self.__dict__.get("patterns", self.loaded_patterns)
        arrays = [
            stars.vectors, stars.v_mag, stars.hip, stars.number, stars.gaia_source,
            *self.sky_index[1:], *self.pairs, *self.__dict__.get("triangles", ()),
        ]
        packed = 0 if patterns is None else patterns.packed.nbytes
        return packed + sum(part.nbytes for part in arrays if isinstance(part, np.ndarray))


def _default_patterns(n_stars: int) -> PatternSettings:
    """Return the paper's geometry, or where the stars are denser, so many neighbours."""
    paper, suited = PatternSettings(), pattern_settings_for(n_stars)
    return suited if suited.radius_rad < paper.radius_rad else paper


def _separation_rad(max_separation_deg: float, catalog: StarCatalog) -> float:
    if max_separation_deg == 0:
        return min(separation_for(len(catalog)), math.radians(DEFAULT_MAX_SEPARATION_DEG))
    low, high = MAX_SEPARATION_RANGE_DEG
    if not low <= max_separation_deg <= high:
        raise ValueError(
            f"max_separation_deg {max_separation_deg:g} is outside of {low:g} to {high:g} "
            "(0 = automatic)"
        )
    return math.radians(max_separation_deg)
