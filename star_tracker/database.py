"""What the matchers search: the guide stars, their features and the settings that built them."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np

from star_tracker.catalog import StarCatalog
from star_tracker.pairs import PairTable
from star_tracker.patterns import PatternSettings, PatternTable

#: The paper keeps pairs to 12 deg (5.2.4.1): enough for the nearest companions in any wider field.
DEFAULT_MAX_SEPARATION_DEG = 12.0
MAX_SEPARATION_RANGE_DEG = (0.5, 30.0)
#: Denser catalogues set nearly every bit of the patterns, which then tell nothing.
MAX_PATTERN_STARS = 15_000
_FORMAT = "star_tracker patterns, format 1"


@dataclass(frozen=True)
class FeatureDatabase:
    """A catalogue with its features. Build it once for each catalogue and separation.

    Attributes:
        catalog: the guide stars.
        pairs: the primary matcher's pair table.
        pattern_settings: geometry of the fallback's patterns.
        loaded_patterns: patterns out of a file; None = build them.
    """

    catalog: StarCatalog
    pairs: PairTable
    pattern_settings: PatternSettings = field(default_factory=PatternSettings)
    loaded_patterns: PatternTable | None = None

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
        low, high = MAX_SEPARATION_RANGE_DEG
        if not low <= max_separation_deg <= high:
            raise ValueError(
                f"max_separation_deg {max_separation_deg:g} is outside of {low:g} to {high:g}"
            )
        pairs = PairTable.build(catalog, float(np.radians(max_separation_deg)))
        return cls(catalog, pairs, pattern_settings or PatternSettings())

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

    def save_patterns(self, path: Path) -> None:
        """Save the packed patterns with the settings and the catalogue that they belong to."""
        patterns = self.patterns
        with path.open("wb") as file:  # given a name, numpy would append .npz to it
            np.savez(
                file, format=_FORMAT, catalog=self._fingerprint, packed=patterns.packed,
                settings=[patterns.settings.radius_rad, patterns.settings.ring_rad],
            )

    def with_patterns(self, path: Path) -> "FeatureDatabase":
        """Return this database with the patterns of a file instead of building them.

        Raises ValueError with the file's name where it is damaged or was built from another
        catalogue or with other settings.
        """
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
                form, catalog = str(content["format"]), str(content["catalog"])
                settings, packed = content["settings"], content["packed"]
        except Exception as error:  # the reader raises errors of many kinds for damaged files
            raise ValueError(f"pattern file {path} cannot be read: {error}") from error
        wanted = [self.pattern_settings.radius_rad, self.pattern_settings.ring_rad]
        if form != _FORMAT or packed.dtype != np.uint8 or packed.ndim != 2:
            raise ValueError(f"pattern file {path} has another format: save it again")
        if catalog != self._fingerprint or len(packed) != len(self.catalog):
            raise ValueError(f"pattern file {path} is of another catalogue: save it again")
        fits = settings.shape == (2,) and settings.dtype == np.float64
        fits = fits and np.allclose(settings, wanted, rtol=1e-12, atol=0)
        if not fits or packed.shape[1] != self.pattern_settings.n_bytes:
            raise ValueError(f"pattern file {path} has other pattern settings: save it again")
        return replace(self, loaded_patterns=PatternTable(self.pattern_settings, packed))

    @property
    def _fingerprint(self) -> str:
        """Names the catalogue: its stars, their order and positions to 1e-6 rad."""
        digest = sha256(self.catalog.hip.tobytes() + self.catalog.number.tobytes())
        digest.update(np.round(self.catalog.vectors * 1e6).astype(np.int64).tobytes())
        return digest.hexdigest()
