"""Many files: stars detected in parallel, then solved in order, each with what was learnt before.

Detection takes most of the time and knows nothing of other files, so it is spread over processes
or a Dask cluster, to which the images are sent: its workers need not see the files. Solving takes
a millisecond a frame and is done in order in one process: the results do not depend on how many
processes there are.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from star_tracker.calibration.learning import LearningTracker, Sources
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.depth import Depth
from star_tracker.catalogue.ladder import LadderStep, ladder
from star_tracker.detection.centroids import DetectSettings
from star_tracker.identification.searcher import METHODS
from star_tracker.offline.frame_file import (
    FileFrame,
    OpenImage,
    detect_in,
    is_list,
    open_image,
    read_centroids,
)
from star_tracker.offline.spreading import Spread
from star_tracker.optics.camera import PIXEL_ORIGINS, Camera
from star_tracker.solution import Solution, SolveSettings, Status


@dataclass(frozen=True)
class Asked:
    """What the user says of the camera and the sky.

    Attributes:
        camera: from a file, None where there is none.
        fov_deg: across the width, 0 = not known.
        fov_tolerance_percent: how far off it may be.
        fov_range_deg: least and greatest field of view where it is not known.
        parity: of the image.
        size_px: of lists of centroids.
        pixel_origin: where these are counted from, and those of bags without CameraInfo, of
            `PIXEL_ORIGINS`; images, maps and `camera` are counted from the outer corner.
        catalog, epoch, limiting_magnitude: of the guide stars; 0 = as deep as suits the camera.
        independent: whether each file is solved without what others told.
        settings: of the solver.
        detect: of the detector.
        bayer: pattern of raw images.
    """

    camera: Camera | None = None
    fov_deg: float = 0.0
    fov_tolerance_percent: float = 5.0
    fov_range_deg: tuple[float, float] = (4.0, 70.0)
    parity: str = "auto"
    size_px: tuple[int, int] | None = None
    pixel_origin: str = "corner"
    catalog: str = "hipparcos"
    epoch: float = 2000.0
    limiting_magnitude: float = 0.0
    independent: bool = False
    settings: SolveSettings = field(
        default_factory=lambda: SolveSettings(method=METHODS[0], deadline_ms=5000.0)
    )
    detect: DetectSettings = field(default_factory=DetectSettings)
    bayer: str = ""

    @property
    def added_px(self) -> float:
        """What is added to the coordinates of lists, so that they are counted from the corner."""
        return PIXEL_ORIGINS[self.pixel_origin]

    @property
    def tells_camera(self) -> bool:
        """Whether the user says what the camera is."""
        return self.camera is not None or self.fov_deg > 0

    def told(self, size_px: tuple[int, int]) -> Camera | None:
        """Return the camera that is told for images of a size, None where none is.

        Raises ValueError for a camera of another size.
        """
        width, height = size_px
        camera = self.camera
        if camera is not None and (camera.width_px, camera.height_px) != size_px:
            raise ValueError(
                f"the camera file is for {camera.width_px} x {camera.height_px} px, the image "
                f"has {width} x {height}: leave the file out, or calibrate this size"
            )
        if camera is None and self.fov_deg > 0:
            camera = Camera.from_fov(
                self.fov_deg, width, height, parity=self.parity,
                tolerance_percent=self.fov_tolerance_percent,
            )
        return camera

    def tracker(self, size_px: tuple[int, int], camera: Camera | None) -> LearningTracker:
        """Return a tracker for images of a size and their camera, None = any."""
        sources = Sources(self.database_for, partial(_ladder, self, size_px))
        return LearningTracker(sources, camera, self.settings, parity=self.parity)

    def database_for(self, camera: Camera) -> FeatureDatabase:
        """Return the guide stars that suit a camera. Raises ValueError."""
        return FeatureDatabase.for_camera(
            camera, catalog=self.catalog, epoch=self.epoch, depth=self.depth,
            with_patterns=self.settings.method != METHODS[0],
        )

    @property
    def depth(self) -> Depth:
        """What of the catalogue is searched."""
        return Depth(self.limiting_magnitude)


@dataclass(frozen=True)
class Result:
    """What became of a file, or of a frame of a bag.

    Attributes:
        path: the file.
        frame, solution: None where it cannot be used.
        error: the sentence that says what is wrong with it then.
        place: where in the bag it is, None for a file that is one frame.
    """

    path: Path
    frame: FileFrame | None
    solution: Solution | None
    error: str = ""
    place: "Place | None" = None

    @property
    def is_solved(self) -> bool:
        """Whether there is an attitude."""
        return self.solution is not None and self.solution.status is Status.SOLVED

    @property
    def name(self) -> str:
        """What files about it are called after."""
        return self.path.name if self.place is None else f"{self.path.name}.{self.place.number}"


@dataclass(frozen=True)
class Place:
    """Where a frame is in a bag: its topic, number in it from 0, and stamp."""

    topic: str
    number: int
    stamp_ns: int


def frames_of(
    paths: Sequence[Path], asked: Asked, spread: Spread
) -> Iterator[FileFrame | ValueError]:
    """Yield the frames of files in order, or the error of one that cannot be used."""
    if spread.scheduler:
        yield from spread.map(partial(_detected, asked), map(partial(_opened, asked), paths))
    else:
        yield from spread.map(partial(_frame, asked), paths)


def solve_frames(
    paths: Sequence[Path], frames: Iterable[FileFrame | ValueError], asked: Asked,
    done: Callable[[], None] = lambda: None,
) -> list[Result]:
    """Solve frames in order; those that were not solved once more, with what others told."""
    trackers: dict[tuple[int, int], LearningTracker] = {}
    results = []
    for path, frame in zip(paths, frames, strict=True):
        results.append(_solved(path, frame, asked, trackers))
        done()
    if asked.independent:
        return results
    return [
        one if one.is_solved or one.frame is None
        else _solved(one.path, one.frame, asked, trackers)
        for one in results
    ]


def _opened(asked: Asked, path: Path) -> OpenImage | FileFrame | ValueError:
    try:
        if is_list(path):
            return read_centroids(path, asked.size_px, asked.added_px)
        return open_image(path)
    except ValueError as error:
        return error


def _detected(
    asked: Asked, opened: OpenImage | FileFrame | ValueError
) -> FileFrame | ValueError:
    if not isinstance(opened, OpenImage):
        return opened
    try:
        return detect_in(opened, asked.detect, asked.bayer)
    except ValueError as error:
        return error


def _frame(asked: Asked, path: Path) -> FileFrame | ValueError:
    return _detected(asked, _opened(asked, path))


def _solved(
    path: Path, frame: FileFrame | ValueError, asked: Asked,
    trackers: dict[tuple[int, int], LearningTracker],
) -> Result:
    if isinstance(frame, ValueError):
        return Result(path, None, None, str(frame))
    try:
        if asked.independent or frame.size_px not in trackers:
            trackers[frame.size_px] = asked.tracker(
                frame.size_px, asked.told(frame.size_px)
            )
        solution = trackers[frame.size_px].solve(frame.xy_px, frame.intensity)
    except ValueError as error:
        return Result(path, frame, None, f"{path}: {error}")
    return Result(path, frame, solution)


def _ladder(asked: Asked, size_px: tuple[int, int]) -> Sequence[LadderStep]:
    return ladder(
        asked.fov_range_deg, size_px, catalog=asked.catalog, epoch=asked.epoch, depth=asked.depth
    )
