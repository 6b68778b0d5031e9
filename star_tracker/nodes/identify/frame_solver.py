"""What identify_node does with one frame: predict, solve in time, learn from it."""

from dataclasses import dataclass

from star_tracker.attitude.prediction import Predictor
from star_tracker.calibration.learning import LearningTracker
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.msg_adapters.point_cloud import Centroids
from star_tracker.nodes.identify.pace import Pace
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

#: Cameras of camera_info whose trackers are kept, 10 MB each.
_MOST_CAMERAS = 4


@dataclass(frozen=True)
class Answer:
    """How a frame ended.

    Attributes:
        solution: of the frame.
        camera: that it was solved with, None where none is known.
        hint: what would solve it, or solve it better.
        news: what was found out about the camera, for the log.
    """

    solution: Solution
    camera: Camera | None
    hint: str = ""
    news: tuple[str, ...] = ()


class FrameSolver:
    """Solves frames one after the other.

    Args:
        setup: camera, settings and how they are used.
        database: the guide stars and their features.
        before: what has solved frames until now; what it has learnt is used further, where the
            same is told of the camera.

    Raises ValueError where database and settings do not fit.

    Attributes:
        setup, database: as given.
        trackers: by the camera as told, None where none is, the one that was made last at the end.
    """

    def __init__(
        self, setup: SolverSetup, database: FeatureDatabase, before: "FrameSolver | None" = None
    ) -> None:
        self.setup, self.database = setup, database
        self.trackers: dict[Camera | None, LearningTracker] = {}
        self._camera = setup.camera
        if not setup.parameters.use_camera_info:
            self.trackers[setup.camera] = setup.tracker(database)
        self._predictor = Predictor(setup.parameters.tracking_max_age_s)
        self._pace = Pace()
        if before is not None and setup.told_of_camera == before.setup.told_of_camera:
            self._go_on_from(before)

    def _go_on_from(self, before: "FrameSolver") -> None:
        """Go on with what was learnt, and where nothing is searched in another way with all."""
        self._camera = before.told_last
        if self.database is before.database and self.setup.settings == before.setup.settings:
            self.trackers = before.trackers
            return
        for camera, tracker in before.trackers.items():
            if camera not in self.trackers:
                self.trackers[camera] = self.setup.tracker(self.database, camera)
            self.trackers[camera].go_on_from(tracker.learnt)

    @property
    def told_last(self) -> Camera | None:
        """The camera of the last frame as it was told."""
        return self._camera

    @property
    def catalog(self) -> StarCatalog:
        """The guide stars of frames that were not solved."""
        return self.database.catalog

    @property
    def tracker(self) -> LearningTracker | None:
        """What solved the last frame; None where camera_info has not told a camera yet."""
        return self.trackers.get(self._camera)

    @property
    def camera(self) -> Camera | None:
        """The camera as it is believed now."""
        return None if self.tracker is None else self.tracker.camera

    @property
    def has_learnt(self) -> bool:
        """Whether frames have shown another camera than was told."""
        return self.tracker is not None and self.tracker.has_learnt

    def reset(self) -> None:
        """Forget last fix and noise: the next frame is searched lost in space, as a first one."""
        self._predictor.reset()
        for tracker in self.trackers.values():
            tracker.noise.forget()

    def solve(
        self, centroids: Centroids, camera: Camera | None, stamp_ns: int, received_s: float
    ) -> Answer:
        """Solve a frame.

        Args:
            centroids: of the frame.
            camera: that took it as told, None where it is to be found out.
            stamp_ns: when it was taken.
            received_s: when it was received, s of `time.monotonic`.
        """
        p = self.setup.parameters
        if camera is not None and p.use_camera_info:
            camera = self.setup.announced(camera)
        tracker = self._tracker_for(camera)
        solution = tracker.solve(
            centroids.xy_px, centroids.intensity,
            predicted=self._predictor.predict(stamp_ns) if p.mode == "auto" else None,
            deadline_ms=self._deadline_ms(received_s, tracker),
        )
        if solution.attitude is not None:
            self._predictor.add(stamp_ns, solution.attitude.quaternion_xyzw)
        news, tracker.news = tuple(tracker.news), []
        return Answer(solution, solution.camera or tracker.camera, tracker.hint, news)

    def _tracker_for(self, camera: Camera | None) -> LearningTracker:
        """Return the tracker of a camera, with what it has learnt; the oldest one may go."""
        if camera not in self.trackers:
            if len(self.trackers) >= _MOST_CAMERAS:
                self.trackers.pop(next(iter(self.trackers)))
            self.trackers[camera] = self.setup.tracker(self.database, camera)
        self._camera = camera
        return self.trackers[camera]

    def _deadline_ms(self, received_s: float, tracker: LearningTracker) -> float:
        """Return how long a frame may take: in step with the stream, if `keep_up` says so.

        Where nothing is solved nothing is lost: some frames may then take longer.
        """
        longest_ms = self.setup.settings.deadline_ms
        in_step_ms = self._pace.deadline_ms(received_s, longest_ms)
        in_step = self.setup.parameters.keep_up and not tracker.at_a_loss
        return in_step_ms if in_step else longest_ms
