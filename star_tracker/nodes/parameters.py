"""The parameters of identify_node and replay_node, each declared once.

Ranges and defaults that the core has are the core's.
"""

from dataclasses import dataclass

from star_tracker.attitude.prediction import PREDICTION_MODES
from star_tracker.catalogue.catalog import (
    CATALOGS,
    EPOCH_RANGE,
    GAIA_MAGNITUDE_RANGE,
    MIN_SEPARATION_RANGE_DEG,
    REFERENCE_EPOCH,
)
from star_tracker.catalogue.database import MAX_SEPARATION_RANGE_DEG
from star_tracker.identification.cells import PAIR_TOLERANCE_RANGE_PX
from star_tracker.identification.ended import MIN_STARS
from star_tracker.identification.searcher import METHODS
from star_tracker.nodes.declaring import ParameterError, parameter, parameters_of
from star_tracker.nodes.identify.earth import EarthParameters
from star_tracker.nodes.identify.transforms import TransformParameters
from star_tracker.optics.camera import (
    FOV_RANGE_DEG,
    MOST_TOLERANCE_PERCENT,
    PARITIES,
    PIXEL_ORIGINS,
)
from star_tracker.solution import (
    CENTROID_SIGMA_RANGE_PX,
    DISPLACED_GATE_RANGE_PX,
    LOG10_FALSE_ALARMS_RANGE,
    SolveSettings,
)

_SOLVE = SolveSettings()
_SMALLEST_PX, _LARGEST_PX = 16, 65536
#: -1 stands for the middle of the image.
_MIDDLE = -1.0
#: -1 stands for what suits the camera.
_AUTOMATIC = -1.0
_PRINCIPAL_POINT_RANGE_PX = (_MIDDLE, 65536.0)


@dataclass(frozen=True)
class _SolverParameters:
    """What identify_node is told of camera, stars and search."""

    fov_deg: float = parameter(
        0.0, "field of view across the image's width; 0 = find it out", "deg",
        allowed=(0.0, FOV_RANGE_DEG[1]),
    )
    fov_tolerance_percent: float = parameter(
        5.0, "how far fov_deg may be off; 0 = it is exact, and nothing is learnt", "%",
        allowed=(0.0, MOST_TOLERANCE_PERCENT),
    )
    fov_min_deg: float = parameter(
        4.0, "least field of view where it is not known", "deg", allowed=FOV_RANGE_DEG
    )
    fov_max_deg: float = parameter(
        70.0, "greatest field of view where it is not known", "deg", allowed=FOV_RANGE_DEG
    )
    width_px: int = parameter(
        0, "image width; to be told here, by camera_info or by camera_file", "px",
        allowed=(0, _LARGEST_PX),
    )
    height_px: int = parameter(
        0, "image height; to be told like width_px", "px", allowed=(0, _LARGEST_PX)
    )
    camera_file: str = parameter(
        "", "camera calibration (YAML of ROS) that is read at the start and written with what was "
        "learnt; empty = none", fixed=True,
    )
    cx_px: float = parameter(
        _MIDDLE, "principal point, x, counted as centroids; -1 = middle of the image", "px",
        allowed=_PRINCIPAL_POINT_RANGE_PX,
    )
    cy_px: float = parameter(
        _MIDDLE, "principal point, y, likewise; -1 = middle of the image", "px",
        allowed=_PRINCIPAL_POINT_RANGE_PX,
    )
    pixel_origin: str = parameter(
        "corner", "where centroids are counted from: outer corner of the first pixel, or its "
        "center; with use_camera_info always as camera_info counts",
        choices=tuple(PIXEL_ORIGINS), fixed=True,
    )
    parity: str = parameter(
        "auto", "normal: y down; mirrored: y up or seen in a mirror; auto: find out",
        choices=PARITIES,
    )
    use_camera_info: bool = parameter(
        False, "take camera and size from camera_info, not from parameters", fixed=True
    )
    camera_info_tolerance_percent: float = parameter(
        1.0, "how far the focal length of camera_info may be off, as calibrations age; 0 = exact",
        "%", allowed=(0.0, MOST_TOLERANCE_PERCENT),
    )
    camera_info_wait_ms: float = parameter(
        100.0, "longest wait of a frame for its camera_info", "ms", allowed=(0.0, 10000.0)
    )
    rectified: bool = parameter(
        False, "centroids are of the rectified image: of camera_info P holds, and no distortion",
        fixed=True,
    )
    x_field: str = parameter("x", "field of centroids with the x coordinate")
    y_field: str = parameter("y", "field of centroids with the y coordinate")
    intensity_field: str = parameter(
        "", "field of centroids with the brightness; empty = intensity, if there is one"
    )
    method: str = parameter(
        _SOLVE.method,
        "match_group, radial_cyclic, or auto: the first, then the second as its fallback",
        choices=("auto", *METHODS),
    )
    pair_tolerance_px: tuple[float, ...] = parameter(
        _SOLVE.match_group.pair_tolerance_px,
        "tolerances of a star pair's separation, tried in turn", "px",
        allowed=PAIR_TOLERANCE_RANGE_PX,
    )
    centroid_sigma_px: float = parameter(
        _SOLVE.centroid_sigma_px, "noise of a centroid along each axis; 0 = find out", "px",
        allowed=CENTROID_SIGMA_RANGE_PX,
    )
    displaced_gate_px: float = parameter(
        _SOLVE.displaced_gate_px,
        "farthest that a displaced star may lie from its place; 0 = label none", "px",
        allowed=DISPLACED_GATE_RANGE_PX,
    )
    max_log10_false_alarms: float = parameter(
        _SOLVE.max_log10_false_alarms,
        "accept a solution whose log10 of expected false alarms is below",
        allowed=LOG10_FALSE_ALARMS_RANGE,
    )
    mode: str = parameter(
        "auto", "auto: after a fix try the predicted attitude first; lost_in_space: never",
        choices=PREDICTION_MODES,
    )
    tracking_max_age_s: float = parameter(
        2.0, "oldest fix from which an attitude is predicted", "s", allowed=(0.0, 3600.0)
    )
    deadline_ms: float = parameter(
        _SOLVE.deadline_ms, "give up on a frame after this time", "ms", allowed=(0.1, 60000.0)
    )
    keep_up: bool = parameter(
        True,
        "give up on a frame sooner where frames come faster: after 3/4 of the time between two",
    )
    max_centroids: int = parameter(
        _SOLVE.max_centroids,
        "of more centroids the brightest are searched, or an even sample",
        allowed=(MIN_STARS, 10000),
    )
    queue_depth: int = parameter(
        10, "frames that wait at most; the oldest ones are dropped", allowed=(1, 1000), fixed=True
    )
    catalog: str = parameter(
        "hipparcos",
        "hipparcos: for real skies; paper: the 4908 numbered stars; gaia: for 1.5 to 6 deg",
        choices=CATALOGS,
    )
    limiting_magnitude: float = parameter(
        0.0, "faintest guide stars of catalog hipparcos or gaia; 0 = as suits the camera", "mag",
        allowed=(0.0, GAIA_MAGNITUDE_RANGE[1]),
    )
    min_separation_deg: float = parameter(
        _AUTOMATIC, "closer stars are merged into one, but for catalog paper; -1 = as suits the "
        "camera", "deg", allowed=(_AUTOMATIC, MIN_SEPARATION_RANGE_DEG[1]),
    )
    epoch: float = parameter(
        REFERENCE_EPOCH, "epoch to which proper motion carries the guide stars", "Julian year",
        allowed=EPOCH_RANGE,
    )
    max_separation_deg: float = parameter(
        0.0, "largest separation of a guide-star pair; 0 = as suits the catalogue", "deg",
        allowed=(0.0, MAX_SEPARATION_RANGE_DEG[1]),
    )
    reference_frame: str = parameter("icrs", "frame_id of the attitude", fixed=True)
    camera_frame: str = parameter(
        "", "frame_id of the stars; empty = that of the centroids", fixed=True
    )
    publish_markers: bool = parameter(False, "publish markers for RViz and Foxglove")
    publish_quality: bool = parameter(
        False, "publish numbers of each frame for plots, each as a topic below quality", fixed=True
    )
    log_frames: bool = parameter(False, "a line of the log for each frame")

    def __post_init__(self) -> None:
        for name in ("cx_px", "cy_px"):
            value = getattr(self, name)
            if _MIDDLE < value < 0:
                raise ParameterError(f"parameter {name} is {value:g}: it must be -1 or >= 0 px")
        if self.rectified and not self.use_camera_info:
            raise ParameterError(
                "parameter rectified is true and use_camera_info false: where camera_info does "
                "not tell the camera, tell that of the rectified image, which has no distortion"
            )
        if 0 < self.fov_deg < FOV_RANGE_DEG[0]:
            raise ParameterError(
                f"parameter fov_deg is {self.fov_deg:g}: it must be 0 (find it out) or from "
                f"{FOV_RANGE_DEG[0]:g} to {FOV_RANGE_DEG[1]:g} deg"
            )
        if self.fov_min_deg > self.fov_max_deg:
            raise ParameterError(
                f"parameter fov_min_deg is {self.fov_min_deg:g}, more than fov_max_deg "
                f"{self.fov_max_deg:g}: give the narrowest and the widest field in question"
            )
        for name in ("width_px", "height_px"):
            value = getattr(self, name)
            if 0 < value < _SMALLEST_PX:
                raise ParameterError(
                    f"parameter {name} is {value}: it must be {_SMALLEST_PX} to {_LARGEST_PX} px"
                )
        if not (self.use_camera_info or self.camera_file or (self.width_px and self.height_px)):
            raise ParameterError(
                "parameters width_px and height_px are 0: tell the size of the image, or set "
                "use_camera_info to true"
            )

    @property
    def principal_point_px(self) -> tuple[float | None, float | None]:
        """The principal point; None for the middle of the image."""
        return tuple(None if value < 0 else value for value in (self.cx_px, self.cy_px))


@dataclass(frozen=True)
class IdentifyParameters(EarthParameters, TransformParameters, _SolverParameters):
    """What identify_node is told. Raises ValueError for values that do not go together."""

    def __post_init__(self) -> None:
        _SolverParameters.__post_init__(self)
        EarthParameters.__post_init__(self)


@dataclass(frozen=True)
class ReplayParameters:
    """What replay_node is told."""

    maps: tuple[int, ...] = parameter(
        (1, 2, 3, 4, 5, 6, 7, 8), "numbers of the star maps, in order", allowed=(1, 8), fixed=True
    )
    folder: str = parameter(
        "", "folder with map1.csv ... map8.csv; empty = the shipped maps", fixed=True
    )
    rate_hz: float = parameter(
        10.0, "frames per second", "Hz", allowed=(0.001, 10000.0), fixed=True
    )
    loop: bool = parameter(False, "start again after the last map, without end", fixed=True)
    noise_px: float = parameter(
        0.0, "standard deviation of noise added to x and y", "px", allowed=(0.0, 100.0), fixed=True
    )
    seed: int = parameter(
        0, "seed of noise and shuffling", allowed=(0, 2**31 - 1), fixed=True
    )
    shuffle: bool = parameter(
        False, "put the centroids of each frame in random order", fixed=True
    )
    publish_camera_info: bool = parameter(
        True, "publish camera_info too, and wait up to 3 s for its subscriber", fixed=True
    )
    camera_frame: str = parameter("camera", "frame_id of the frames", fixed=True)


IDENTIFY_PARAMETERS = parameters_of(IdentifyParameters)
REPLAY_PARAMETERS = parameters_of(ReplayParameters)
