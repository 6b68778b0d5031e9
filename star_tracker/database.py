"""What the matchers search: the guide stars and the features built from them."""

from dataclasses import dataclass

import numpy as np

from star_tracker.catalog import StarCatalog
from star_tracker.pairs import PairTable

#: The paper keeps pairs to 12 deg (5.2.4.1): enough for the nearest companions in any wider field.
DEFAULT_MAX_SEPARATION_DEG = 12.0
MAX_SEPARATION_RANGE_DEG = (0.5, 30.0)


@dataclass(frozen=True)
class FeatureDatabase:
    """A catalogue with its pair table. Build it once for each catalogue and separation."""

    catalog: StarCatalog
    pairs: PairTable

    @classmethod
    def build(
        cls, catalog: StarCatalog, *, max_separation_deg: float = DEFAULT_MAX_SEPARATION_DEG
    ) -> "FeatureDatabase":
        """Build the features of all stars of a catalogue: 0.3 s for 4908 stars.

        Raises ValueError for a separation out of range or too many pairs.
        """
        low, high = MAX_SEPARATION_RANGE_DEG
        if not low <= max_separation_deg <= high:
            raise ValueError(
                f"max_separation_deg {max_separation_deg:g} is outside of {low:g} to {high:g}"
            )
        return cls(catalog, PairTable.build(catalog, float(np.radians(max_separation_deg))))
