"""What the matchers search: the guide stars, their features and the settings that built them."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.feature_file import Features, identity, load_features, save_features
from star_tracker.catalogue.pairs import PairTable
from star_tracker.catalogue.patterns import PatternSettings, PatternTable
from star_tracker.catalogue.sky_index import SkyIndex
from star_tracker.catalogue.triangles import TriangleTable
from star_tracker.resources import cache_folder, sources_digest

#: The paper keeps pairs to 12 deg (5.2.4.1): enough for the nearest companions in any wider field.
DEFAULT_MAX_SEPARATION_DEG = 12.0
MAX_SEPARATION_RANGE_DEG = (0.5, 30.0)
#: Denser catalogues set nearly every bit of the patterns, which then tell nothing.
MAX_PATTERN_STARS = 15_000


@dataclass(frozen=True)
class FeatureDatabase:
    """A catalogue with its features. Build it once for each catalogue and separation.

    Attributes:
        catalog: the guide stars.
        pairs: the primary matcher's pair table.
        pattern_settings: geometry of the fallback's patterns.
        loaded_patterns: patterns out of a file; None = build them.
        cache_note: one line on a cache file that could not be read or saved; mostly empty.
    """

    catalog: StarCatalog
    pairs: PairTable
    pattern_settings: PatternSettings = field(default_factory=PatternSettings)
    loaded_patterns: PatternTable | None = None
    cache_note: str = ""

    @classmethod
    def build(
        cls,
        catalog: StarCatalog,
        *,
        max_separation_deg: float = DEFAULT_MAX_SEPARATION_DEG,
        pattern_settings: PatternSettings | None = None,
    ) -> "FeatureDatabase":
        """Build the features of all stars of a catalogue: 0.3 s for 4908 stars.

        The patterns follow at their first use, in another 0.4 s. Raises ValueError for a
        separation out of range or too many pairs.
        """
        pairs = PairTable.build(catalog, _separation_rad(max_separation_deg))
        return cls(catalog, pairs, pattern_settings or PatternSettings())

    @classmethod
    def cached(
        cls,
        catalog: StarCatalog,
        *,
        max_separation_deg: float = DEFAULT_MAX_SEPARATION_DEG,
        pattern_settings: PatternSettings | None = None,
        folder: Path | None = None,
    ) -> "FeatureDatabase":
        """Return what `build` returns, patterns included, out of a file where there is one.

        The file lies in `folder`, by default the package's cache folder, and is made where it is
        missing; one that cannot be used is made again. What went wrong with it is told by
        `cache_note`. Raises ValueError as `build`.
        """
        settings = pattern_settings or PatternSettings()
        name = identity(catalog, _separation_rad(max_separation_deg), settings, sources_digest())
        dense = len(catalog) > MAX_PATTERN_STARS
        where = cache_folder() if folder is None else folder
        path = None if where is None else where / f"features-{name[:16]}.npz"
        notes = [] if path else ["there is no home for a cache of the features"]
        if path is not None:
            try:
                found = load_features(path, name, len(catalog), settings)
                return cls(catalog, found.pairs, settings, None if dense else found.patterns)
            except FileNotFoundError:
                pass
            except ValueError as error:
                notes.append(f"feature file {path} {error}; it is built again")
        database = cls.build(
            catalog, max_separation_deg=max_separation_deg, pattern_settings=settings
        )
        features = Features(database.pairs, None if dense else database.patterns)
        if path is not None:
            try:
                save_features(path, name, features)
            except OSError as error:
                notes.append(f"feature file {path} cannot be saved: {error.strerror or error}")
        return replace(
            database, loaded_patterns=features.patterns, cache_note="; ".join(notes)
        )

    @cached_property
    def sky_index(self) -> SkyIndex:
        """The guide stars by place on the sky."""
        return SkyIndex.build(self.catalog.vectors)

    @cached_property
    def triangles(self) -> TriangleTable:
        """The guide stars' triangles by shape, for a camera whose scale is not known."""
        return TriangleTable.build(self.catalog.vectors)

    @cached_property
    def patterns(self) -> PatternTable:
        """The fallback's patterns. Raises ValueError for a catalogue too dense for them."""
        if self.loaded_patterns is not None:
            return self.loaded_patterns
        if len(self.catalog) > MAX_PATTERN_STARS:
            raise ValueError(
                f"{len(self.catalog)} guide stars are too dense for method radial_cyclic, which "
                f"takes {MAX_PATTERN_STARS}: lower limiting_magnitude or set method to match_group"
            )
        return PatternTable.build(self.catalog.vectors, self.pattern_settings)

    @cached_property
    def pattern_pairs(self) -> PairTable:
        """All pairs up to the patterns' radius, from which their comparisons are counted."""
        radius = self.pattern_settings.radius_rad
        if self.pairs.max_separation_rad >= radius:
            return self.pairs
        return PairTable.build(self.catalog, radius)


def _separation_rad(max_separation_deg: float) -> float:
    low, high = MAX_SEPARATION_RANGE_DEG
    if not low <= max_separation_deg <= high:
        raise ValueError(
            f"max_separation_deg {max_separation_deg:g} is outside of {low:g} to {high:g}"
        )
    return float(np.radians(max_separation_deg))
