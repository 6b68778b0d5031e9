"""What identify_node works with, made of its parameters as a whole."""

from dataclasses import astuple, dataclass, fields
from functools import cached_property
from hashlib import sha256
from typing import Any

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.searcher import METHODS
from star_tracker.nodes.parameters import IdentifyParameters
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

_DIGEST_LENGTH = 12


@dataclass(frozen=True)
class SolverSetup:
    """The parameters, and what the core makes of them."""

    parameters: IdentifyParameters
    camera: Camera
    settings: SolveSettings

    @classmethod
    def of(cls, parameters: IdentifyParameters) -> "SolverSetup":
        """Put parameters together. Raises ValueError where they do not fit each other."""
        p = parameters
        cx_px, cy_px = p.principal_point_px
        camera = Camera.from_fov(
            p.fov_deg, p.width_px, p.height_px, parity=p.parity, cx_px=cx_px, cy_px=cy_px
        )
        settings = SolveSettings(
            method=p.method,
            match_group=MatchGroupSettings(pair_tolerance_px=p.pair_tolerance_px),
            centroid_sigma_px=p.centroid_sigma_px,
            displaced_gate_px=p.displaced_gate_px,
            max_log10_false_alarms=p.max_log10_false_alarms,
            deadline_ms=p.deadline_ms, max_centroids=p.max_centroids,
        )
        return cls(p, camera, settings)

    @property
    def database_key(self) -> tuple[Any, ...]:
        """Equal for two setups that can share a database."""
        p = self.parameters
        return (
            p.catalog, p.limiting_magnitude, p.min_separation_deg, p.epoch, p.max_separation_deg
        )

    @cached_property
    def digest(self) -> str:
        """Names the values of all parameters: equal for equal ones only."""
        names = [field.name for field in fields(self.parameters)]
        pairs = zip(names, astuple(self.parameters), strict=True)
        text = "\n".join(f"{name}={value!r}" for name, value in sorted(pairs))
        return sha256(text.encode()).hexdigest()[:_DIGEST_LENGTH]

    @property
    def camera_source(self) -> str:
        """Where the camera comes from, in words."""
        p = self.parameters
        return "camera_info" if p.use_camera_info else f"{p.fov_deg:g} deg over {p.width_px} px"

    def check(self) -> None:
        """Raise ValueError, within a second, for what could not be built in many of them."""
        catalog = self._catalog()
        FeatureDatabase.check(catalog, max_separation_deg=self.parameters.max_separation_deg)
        if self.settings.method in ("auto", METHODS[1]):
            FeatureDatabase.check_patterns(catalog)

    def build_database(self) -> FeatureDatabase:
        """Build the guide stars' features. Raises ValueError where there are too many of them."""
        return FeatureDatabase.cached(
            self._catalog(), max_separation_deg=self.parameters.max_separation_deg
        )

    def tracker(self, database: FeatureDatabase) -> StarTracker:
        """Return a tracker. Raises ValueError where database and settings do not fit."""
        return StarTracker(database, self.camera, self.settings)

    def _catalog(self) -> StarCatalog:
        p = self.parameters
        return StarCatalog.named(
            p.catalog, limiting_magnitude=p.limiting_magnitude,
            min_separation_deg=p.min_separation_deg, epoch=p.epoch,
        )
