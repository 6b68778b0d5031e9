"""What identify_node works with, made of its parameters as a whole."""

from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.nodes.parameters import ParameterError
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

#: The parameters that a database depends on.
_OF_DATABASE = (
    "catalog", "limiting_magnitude", "min_separation_deg", "epoch", "max_separation_deg",
)
_DIGEST_LENGTH = 12


@dataclass(frozen=True)
class Configuration:
    """Checked values of all parameters by name, and what the core makes of them."""

    values: dict[str, Any]
    camera: Camera
    settings: SolveSettings

    @classmethod
    def of(cls, values: dict[str, Any]) -> "Configuration":
        """Put checked values together. Raises ValueError where they do not fit each other."""
        p = values
        for name in ("cx_px", "cy_px"):
            if -1 < p[name] < 0:
                raise ParameterError(f"parameter {name} is {p[name]:g}: it must be -1 or >= 0 px")
        camera = Camera.from_fov(
            p["fov_deg"], p["width_px"], p["height_px"], parity=p["parity"],
            cx_px=None if p["cx_px"] < 0 else p["cx_px"],
            cy_px=None if p["cy_px"] < 0 else p["cy_px"],
        )
        settings = SolveSettings(
            method=p["method"],
            match_group=MatchGroupSettings(pair_tolerance_px=p["pair_tolerance_px"]),
            centroid_sigma_px=p["centroid_sigma_px"],
            displaced_gate_px=p["displaced_gate_px"],
            max_log10_false_alarms=p["max_log10_false_alarms"],
            deadline_ms=p["deadline_ms"], max_centroids=p["max_centroids"],
        )
        return cls(dict(values), camera, settings)

    @property
    def database_key(self) -> tuple[Any, ...]:
        """Equal for two configurations that can share a database."""
        return tuple(self.values[name] for name in _OF_DATABASE)

    @property
    def digest(self) -> str:
        """Names the values of all parameters: equal for equal ones only."""
        text = "\n".join(f"{name}={self.values[name]!r}" for name in sorted(self.values))
        return sha256(text.encode()).hexdigest()[:_DIGEST_LENGTH]

    def build_database(self) -> FeatureDatabase:
        """Build the guide stars' features. Raises ValueError where there are too many of them."""
        p = self.values
        catalog = StarCatalog.named(
            p["catalog"], limiting_magnitude=p["limiting_magnitude"],
            min_separation_deg=p["min_separation_deg"], epoch=p["epoch"],
        )
        return FeatureDatabase.cached(catalog, max_separation_deg=p["max_separation_deg"])

    def tracker(self, database: FeatureDatabase) -> StarTracker:
        """Return a tracker. Raises ValueError where database and settings do not fit."""
        return StarTracker(database, self.camera, self.settings)
