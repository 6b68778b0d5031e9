"""What identify_node does with one frame: predict, solve in time, learn from it."""

from dataclasses import dataclass

from msg_adapters.point_cloud import Centroids
from star_tracker.attitude.prediction import Predictor
from star_tracker.calibration.learning import LearningTracker
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.nodes.identify.focal_length_follower import FocalLengthFollower
from star_tracker.nodes.identify.hinting import Hinter
from star_tracker.nodes.identify.pace import Pace
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution


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
        follower: what is known of the focal lengths.

    Raises ValueError where database and settings do not fit.
    """

    def __init__(
        self, setup: SolverSetup, database: FeatureDatabase, follower: FocalLengthFollower
    ) -> None:
        self.tracker = setup.tracker(database)
        self._database, self._told = database, setup.camera
        self._setup, self._follower = setup, follower
        self._predictor = Predictor(setup.parameters.tracking_max_age_s)
        self._pace, self._hinter = Pace(), Hinter()

    @property
    def catalog(self) -> StarCatalog:
        """The guide stars of frames that were not solved."""
        return self._database.catalog

    @property
    def camera(self) -> Camera | None:
        """The camera as it is believed now."""
        return self.tracker.camera

    def reset(self) -> None:
        """Forget the last fix: the next frame is searched lost in space."""
        self._predictor.reset()

    def solve(
        self, centroids: Centroids, camera: Camera | None, stamp_ns: int, received_s: float
    ) -> Answer:
        """Solve a frame.

        Args:
            centroids: of the frame.
            camera: that took it, None where it is to be found out.
            stamp_ns: when it was taken.
            received_s: when it was received, s of `time.monotonic`.
        """
        deadline_ms = self._deadline_ms(received_s)
        p = self._setup.parameters
        if camera is not None and p.use_camera_info and camera.parity != p.parity:
            camera = camera.with_parity(p.parity)  # changed since the camera was announced
        if camera is None or camera.tolerance_percent > 0:
            return self._learn(centroids, camera, stamp_ns, deadline_ms)
        camera = self._follower.camera(camera)
        if camera != self.tracker.camera:
            self.tracker = self._setup.tracker(self._database_for(camera), camera)
        solution = self.tracker.solve(
            centroids.xy_px, centroids.intensity,
            predicted=self._predictor.predict(stamp_ns) if p.mode == "auto" else None,
            deadline_ms=self._hinter.search_ms(deadline_ms),
        )
        if solution.attitude is not None:
            self._predictor.add(stamp_ns, solution.attitude.quaternion_xyzw)
        self._follower.learn(camera, solution, centroids.xy_px, self.catalog)
        hint = self._hinter.hint(self.tracker, centroids.xy_px, solution, deadline_ms)
        return Answer(solution, camera, hint)

    def _learn(
        self, centroids: Centroids, camera: Camera | None, stamp_ns: int, deadline_ms: float
    ) -> Answer:
        """Solve a frame of a camera that is learnt."""
        learns = isinstance(self.tracker, LearningTracker)
        if not learns or camera != self._told:
            self.tracker, self._told = self._setup.tracker(self._database, camera), camera
        predicted = None
        if self._setup.parameters.mode == "auto":
            predicted = self._predictor.predict(stamp_ns)
        solution = self.tracker.solve(
            centroids.xy_px, centroids.intensity, predicted=predicted, deadline_ms=deadline_ms
        )
        if solution.attitude is not None:
            self._predictor.add(stamp_ns, solution.attitude.quaternion_xyzw)
        news, self.tracker.news = tuple(self.tracker.news), []
        return Answer(solution, solution.camera or self.tracker.camera, news=news)

    def _database_for(self, camera: Camera) -> FeatureDatabase:
        """Return the guide stars for a camera that camera_info tells."""
        if self._setup.parameters.use_camera_info:
            self._database = self._setup.database_for(camera)
        return self._database

    def _deadline_ms(self, received_s: float) -> float:
        """Return how long a frame may take: in step with the stream, if `keep_up` says so."""
        longest_ms = self._setup.settings.deadline_ms
        in_step_ms = self._pace.deadline_ms(received_s, longest_ms)
        in_step = self._setup.parameters.keep_up and not self._hinter.at_leisure
        return in_step_ms if in_step else longest_ms
