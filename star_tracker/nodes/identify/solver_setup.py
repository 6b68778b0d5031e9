"""What identify_node works with, made of its parameters as a whole."""

from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from star_tracker.calibration.camera_file import read_camera
from star_tracker.calibration.learning import LearningTracker, Sources
from star_tracker.calibration.second_opinion import ToldBy
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.depth import Depth
from star_tracker.catalogue.ladder import LadderStep, ladder
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.searcher import METHODS
from star_tracker.msg_adapters.centroids import Centroids
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.parameters import IdentifyParameters
from star_tracker.optics.camera import PIXEL_ORIGINS, Camera
from star_tracker.solution import SolveSettings

_DIGEST_LENGTH = 12


@dataclass(frozen=True)
class SolverSetup:
    """The parameters, and what the core makes of them.

    Attributes:
        parameters: all of them.
        camera: as told by parameters or `camera_file`; None where the field of view is not told,
            or camera_info tells it.
        settings: of the search.
        from_file: the camera as `camera_file` held it at the start, None without one.
    """

    parameters: IdentifyParameters
    camera: Camera | None
    settings: SolveSettings
    from_file: Camera | None = field(default=None)

    @classmethod
    def of(
        cls, parameters: IdentifyParameters, before: "SolverSetup | None" = None
    ) -> "SolverSetup":
        """Put parameters together. Raises ValueError where they do not fit each other.

        The camera file is read at the start alone: `before` is the setup that holds until now.
        """
        p = parameters
        from_file = _read_file(p) if before is None else before.from_file
        camera = None if p.use_camera_info else _camera(p, from_file)
        settings = SolveSettings(
            method=p.method,
            match_group=MatchGroupSettings(pair_tolerance_px=p.pair_tolerance_px),
            centroid_sigma_px=p.centroid_sigma_px,
            displaced_gate_px=p.displaced_gate_px,
            max_log10_false_alarms=p.max_log10_false_alarms,
            deadline_ms=p.deadline_ms, max_centroids=p.max_centroids,
        )
        return cls(p, camera, settings, from_file)

    @property
    def database_key(self) -> tuple[Any, ...]:
        """Equal for two setups that can share a database."""
        p = self.parameters
        guides = (
            p.catalog, p.limiting_magnitude, p.min_separation_deg, p.epoch, p.max_separation_deg
        )
        if p.catalog == "paper":
            return guides
        return (*guides, p.fov_deg, p.fov_min_deg, p.fov_max_deg, p.width_px, p.height_px)

    @property
    def told_of_camera(self) -> tuple[Any, ...]:
        """Equal for two setups that tell the same of the camera: what was learnt of it holds."""
        p = self.parameters
        return (
            self.camera, p.parity, p.fov_min_deg, p.fov_max_deg, p.width_px, p.height_px,
            p.camera_info_tolerance_percent,
        )

    @property
    def _told_by(self) -> ToldBy:
        """What a user corrects where the field of view is wrong."""
        if self.parameters.use_camera_info:
            return ToldBy("the field of view of camera_info", "camera_info_tolerance_percent")
        if self.from_file is not None:
            return ToldBy("the field of view of camera_file", "tolerance_percent in it")
        return ToldBy()

    def announced(self, camera: Camera) -> Camera:
        """Return a camera of camera_info with what parameters say of it."""
        p = self.parameters
        return replace(
            camera, parity=p.parity, tolerance_percent=p.camera_info_tolerance_percent
        )

    def counted(self, centroids: Centroids) -> Centroids:
        """Return a frame's centroids, counted as the camera is.

        That is as camera_info counts, or else from the outer corner of the first pixel.
        """
        return replace(centroids, xy_px=centroids.xy_px + _added_px(self.parameters))

    def told(self, camera: Camera) -> Camera:
        """Return a camera that frames were solved with, counted as centroids are."""
        return camera.moved(-_added_px(self.parameters))

    def for_file(self, camera: Camera) -> Camera:
        """Return a camera that frames were solved with, counted from the outer corner."""
        return camera.moved(PIXEL_ORIGINS["center"] if self.parameters.use_camera_info else 0.0)

    @property
    def depth(self) -> Depth:
        """What of the catalogue is searched."""
        p = self.parameters
        return Depth(
            p.limiting_magnitude, None if p.min_separation_deg < 0 else p.min_separation_deg,
            p.max_separation_deg,
        )

    @property
    def steps(self) -> tuple[LadderStep, ...]:
        """The databases for a field of view that is not known. Raises ValueError."""
        return self._steps(self.parameters.width_px or 1024, self.parameters.height_px or 1024)

    def _steps(self, width_px: int, height_px: int) -> tuple[LadderStep, ...]:
        p = self.parameters
        size_px = width_px, height_px
        return _ladder((p.fov_min_deg, p.fov_max_deg), size_px, p.catalog, p.epoch, self.depth)

    def sources(self, camera: Camera | None) -> Sources:
        """Return where a tracker that learns its camera gets its guide stars."""
        own = camera is None or (camera.width_px, camera.height_px) == (
            self.parameters.width_px, self.parameters.height_px
        )
        return Sources(
            self.database_for,
            (lambda: self.steps) if own else (
                lambda: self._steps(camera.width_px, camera.height_px)
            ),
        )

    def database_for(self, camera: Camera) -> FeatureDatabase:
        """Return the guide stars that suit a camera. Raises ValueError."""
        p = self.parameters
        return FeatureDatabase.for_camera(
            camera, catalog=p.catalog, epoch=p.epoch, depth=self.depth
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
        if self.parameters.use_camera_info:
            return "camera_info"
        if self.camera is None:
            p = self.parameters
            return (
                f"of any field of view from {p.fov_min_deg:g} to {p.fov_max_deg:g} deg over "
                f"{p.width_px} px"
            )
        return f"{self.camera.fov_deg:g} deg over {self.camera.width_px} px"

    def check(self) -> None:
        """Raise ValueError, within a second, for what could not be built in many of them."""
        p = self.parameters
        camera = _TYPICAL if p.use_camera_info else self.camera
        if camera is None:  # one of any field of view: its guide stars have no pairs to speak of
            middle = self.steps[len(self.steps) // 2]
            self.depth.stars_for(middle.camera, p.catalog, p.epoch)
            return
        catalog = self.depth.stars_for(camera, p.catalog, p.epoch)
        FeatureDatabase.check(catalog, max_separation_deg=p.max_separation_deg)
        if self.settings.method == METHODS[1]:
            FeatureDatabase.check_patterns(catalog)

    def build_database(self) -> FeatureDatabase:
        """Build the guide stars' features. Raises ValueError where there are too many of them."""
        if self.camera is not None:
            return self.database_for(self.camera)
        if self.parameters.use_camera_info:
            return self.database_for(_TYPICAL)
        databases = [step.database for step in self.steps]
        return databases[len(databases) // 2]

    def tracker(
        self, database: FeatureDatabase, camera: Camera | None = None
    ) -> LearningTracker:
        """Return a tracker, by default for the camera as told.

        Args:
            database: guide stars of the camera as told.
            camera: another one, that camera_info tells.

        Raises ValueError where database and settings do not fit.
        """
        if self.parameters.use_camera_info:
            return LearningTracker(
                self.sources(camera), camera or _TYPICAL, self.settings,
                parity=self.parameters.parity, told_by=self._told_by,
            )
        told, sources = self.camera, self.sources(self.camera)
        own = Sources(
            lambda one: database if one == told else self.database_for(one), sources.ladder
        )
        return LearningTracker(
            own, told, self.settings, parity=self.parameters.parity, told_by=self._told_by
        )


@lru_cache(maxsize=2)
def _ladder(
    fov_range_deg: tuple[float, float], size_px: tuple[int, int], catalog: str, epoch: float,
    depth: Depth,
) -> tuple[LadderStep, ...]:
    """Return a ladder whose databases stay while other parameters change."""
    return ladder(fov_range_deg, size_px, catalog=catalog, epoch=epoch, depth=depth)


#: Stands for the camera until camera_info has told the true one.
_TYPICAL = Camera.from_fov(20.0, 1024, 1024)


def _added_px(p: IdentifyParameters) -> float:
    """Return what is added to centroids, so that they are counted as the camera is."""
    return 0.0 if p.use_camera_info else PIXEL_ORIGINS[p.pixel_origin]


def _read_file(p: IdentifyParameters) -> Camera | None:
    """Return the camera of the file, None where there is none. Raises ValueError.

    With camera_info it is a place to write to alone.
    """
    if not p.camera_file:
        return None
    file = Path(p.camera_file).expanduser()
    if not file.parent.is_dir():
        raise ParameterError(
            f"camera_file {file} cannot be written: there is no folder {file.parent}, make it"
        )
    return read_camera(file) if file.exists() and not p.use_camera_info else None


def _camera(p: IdentifyParameters, from_file: Camera | None) -> Camera | None:
    """Return the camera as told, None where its field of view is not. Raises ValueError."""
    if from_file is not None:
        size = p.width_px or from_file.width_px, p.height_px or from_file.height_px
        if (from_file.width_px, from_file.height_px) != size:
            raise ValueError(
                f"camera file {p.camera_file} is for {from_file.width_px} x {from_file.height_px} "
                f"px, width_px and height_px say {size[0]} x {size[1]}: calibrate this size, or "
                "correct them"
            )
        return from_file if p.parity == "auto" else from_file.with_parity(p.parity)
    if not (p.width_px and p.height_px):
        raise ParameterError(
            f"there is no camera file {p.camera_file} yet: tell width_px and height_px until it "
            "is written"
        )
    if p.fov_deg == 0:
        return None
    cx_px, cy_px = (
        None if one is None else one + _added_px(p) for one in p.principal_point_px
    )
    return Camera.from_fov(
        p.fov_deg, p.width_px, p.height_px, parity=p.parity, principal_point_px=(cx_px, cy_px),
        tolerance_percent=p.fov_tolerance_percent,
    )
