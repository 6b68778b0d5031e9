"""identify_node: star centroids in, attitude and identified stars out."""

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger

from msg_adapters import MessageError
from msg_adapters.health import status_from_health
from msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.attitude.prediction import Predictor
from star_tracker.calibration.hints import hint, wants_hint
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import Identification, StarState
from star_tracker.nodes.identify.configuration import Configuration
from star_tracker.nodes.identify.focal_length_watch import FocalLengthWatch
from star_tracker.nodes.identify.health import FrameRecord, Health, input_age_s
from star_tracker.nodes.identify.health_report import HealthReport
from star_tracker.nodes.identify.intake import Frame, Intake
from star_tracker.nodes.identify.outputs import Outputs
from star_tracker.nodes.identify.pace import Pace
from star_tracker.nodes.identify.runtime_parameters import RuntimeParameters
from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS, ParameterError, declare
from star_tracker.nodes.running import run
from star_tracker.optics.camera import Camera
from star_tracker.resources import package_version
from star_tracker.solution import Solution, Status
from star_tracker.tracker import StarTracker

#: Shortest time between two frames that are tried for a hint, s, and longest time for one, ms.
_HINT_S, _HINT_MS = 2.0, 100.0
#: The share of the deadline after which such a frame is given up, if the one before was unsolved.
_HINT_AFTER = 0.75
#: Frames in a row without a solution, after which a hint need not keep up with the stream.
_HOPELESS = 10


class IdentifyNode(Node):
    """Identifies each frame of `centroids` and publishes what it found under the frame's stamp.

    Raises ParameterError for a configuration that cannot be used.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__("identify_node", **node_options)
        #: Frames that were not searched, by reason.
        self.rejected: Counter[str] = Counter()
        self._hinted_s, self._n_unsolved = -_HINT_S, 0
        self._pace = Pace()
        try:
            self._configuration = Configuration.of(declare(self, IDENTIFY_PARAMETERS))
            database = self._configuration.build_database()
            self.get_logger().info(
                "loading the solver; the first start on a machine compiles it, for half a minute"
            )
            started = time.perf_counter()
            self._apply(self._configuration, database)
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        self.get_logger().info(
            f"solver compiled or loaded from its cache in {time.perf_counter() - started:.1f} s"
        )
        self._runtime = RuntimeParameters(self, self._configuration, database, self._apply)
        p = self._configuration.values
        self._watch = FocalLengthWatch(self, p["calibrate_focal_length"])
        self._outputs = Outputs(self, p["reference_frame"], p["camera_frame"])
        self._health = Health(time.monotonic())
        HealthReport(self, self._statuses)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._intake = Intake(
            self, lambda: self._configuration, self._identify, self._reject
        )

    def destroy_node(self) -> None:
        """End the node, and before it a database that is being built."""
        if hasattr(self, "_runtime"):
            self._runtime.finish()
        super().destroy_node()

    def set_parameters_atomically(self, parameter_list: list[Any]) -> SetParametersResult:
        """Set all parameters or none; unlike rclpy's own, name those that do not exist."""
        unknown = [p.name for p in parameter_list if not self.has_parameter(p.name)]
        if unknown:
            return SetParametersResult(
                successful=False, reason=f"there is no parameter {', '.join(unknown)}"
            )
        return super().set_parameters_atomically(parameter_list)

    def _apply(self, configuration: Configuration, database: FeatureDatabase) -> None:
        """Work with this configuration from now on. Raises ValueError and keeps the old one."""
        self._tracker = configuration.tracker(database)
        if not self.context.ok():  # told to end meanwhile
            self.destroy_node()
            raise ExternalShutdownException
        self._configuration, self._database = configuration, database
        if database.cache_note:
            self.get_logger().warning(database.cache_note)
        p = configuration.values
        self._predictor = Predictor(p["tracking_max_age_s"])
        source = "camera_info" if p["use_camera_info"] else (
            f"{p['fov_deg']:g} deg over {p['width_px']} px"
        )
        self.get_logger().info(
            f"ready: {database.catalog.description}, {database.pairs.n_pairs} pairs, "
            f"camera {source}, parity {p['parity']}, configuration {configuration.digest}"
        )

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._predictor.reset()
        response.success, response.message = True, "the next frame is searched lost in space"
        return response

    def _identify(self, frame: Frame, camera: Camera) -> None:
        try:
            self._solve(frame, camera)
        except MessageError as error:
            self._reject(frame, "malformed_cloud", str(error))
        except Exception as error:  # one frame must not end the node
            if not self.context.ok():  # told to end meanwhile: nothing can be published
                raise ExternalShutdownException from error
            self._reject(frame, "internal_error", f"{type(error).__name__}: {error}")

    def _solve(self, frame: Frame, camera: Camera) -> None:
        """Take one frame the whole way. Raises MessageError where it cannot be read."""
        p = self._configuration.values
        centroids = centroids_from_cloud(frame.message)
        stamp = frame.stamp_ns
        if camera.parity != p["parity"]:  # changed since the camera was announced
            camera = camera.with_parity(p["parity"])
        camera = self._watch.camera(camera)
        if camera != self._tracker.camera:
            self._tracker = StarTracker(
                self._database, camera, self._configuration.settings
            )
        predicted = self._predictor.predict(stamp) if p["mode"] == "auto" else None
        due = time.monotonic() - self._hinted_s >= _HINT_S
        deadline_ms = self._deadline_ms(frame, due)
        solution = self._tracker.solve(
            centroids.xy_px, centroids.intensity, predicted=predicted,
            # An empty sky takes all the time there is: leave some for a hint.
            deadline_ms=_HINT_AFTER * deadline_ms if due and self._n_unsolved else deadline_ms,
        )
        if solution.attitude is not None:
            self._predictor.add(stamp, solution.attitude.quaternion_xyzw)
        catalog = self._database.catalog
        self._watch.learn(camera, solution, centroids.xy_px, catalog)
        self._complain(solution)
        self._outputs.publish(
            solution, frame.header,
            self._hint(camera, solution, centroids.xy_px, deadline_ms - solution.solve_ms),
        )
        self._outputs.publish_stars(solution, centroids.xy_px, catalog, frame.header)
        if p["publish_markers"]:
            self._outputs.publish_markers(solution, camera, catalog, frame.header)
        self._record(frame, solution)

    def _deadline_ms(self, frame: Frame, hint_is_due: bool) -> float:
        """Return how long a frame may take: in step with the stream, if `keep_up` says so."""
        longest_ms = self._configuration.settings.deadline_ms
        in_step_ms = self._pace.deadline_ms(frame.received_s, longest_ms)
        # A hint takes longer than a fast stream leaves. Where nothing is solved, nothing is lost.
        at_leisure = hint_is_due and self._n_unsolved >= _HOPELESS
        keep_up = self._configuration.values["keep_up"] and not at_leisure
        return in_step_ms if keep_up else longest_ms

    def _hint(
        self, camera: Camera, solution: Solution, xy_px: Floats, left_ms: float
    ) -> str:
        """Return what would solve a frame, or solve it better, in what is left of its deadline."""
        unsolved = solution.status in (Status.NO_MATCH, Status.TIMEOUT)
        self._n_unsolved = self._n_unsolved + 1 if unsolved else 0
        now = time.monotonic()
        if now - self._hinted_s < _HINT_S or not wants_hint(solution) or left_ms <= 0:
            return ""
        self._hinted_s = now
        tried = camera, self._configuration.settings
        return hint(self._database, tried, xy_px, solution, min(left_ms, _HINT_MS))

    def _complain(self, solution: Solution) -> None:
        """Count and log what was wrong with a frame that could be read."""
        if solution.status is Status.BAD_INPUT:
            self.rejected["bad_centroids"] += 1
            self.get_logger().error(solution.reason, throttle_duration_sec=1.0)
        elif solution.n_ignored:
            self.rejected["ignored_centroids"] += solution.n_ignored
            self.get_logger().warning(
                f"{solution.n_ignored} centroids are non-finite or outside of the image and were "
                "left out: check the camera's size and the detector",
                throttle_duration_sec=1.0,
            )

    def _reject(self, frame: Frame | None, kind: str, reason: str) -> None:
        """Count what cannot be used and say why, in the log and for a frame to the subscribers."""
        self.rejected[kind] += 1
        self.get_logger().error(reason, throttle_duration_sec=1.0)
        if frame is None:
            return
        solution = Solution(Status.BAD_INPUT, reason, Identification.empty(0))
        self._outputs.publish(solution, frame.header)
        self._record(frame, solution)

    def _record(self, frame: Frame, solution: Solution) -> None:
        """Enter a frame that has been answered into the health statistics."""
        now = time.monotonic()
        state = solution.identification.state
        age_s = input_age_s(frame.stamp_ns, self.get_clock().now().nanoseconds)
        self._health.add(FrameRecord(
            solution.attitude is not None, f"{solution.status.value}: {solution.reason}",
            solution.mode, 1e3 * (now - frame.received_s), age_s, len(state),
            int((state == StarState.UNIDENTIFIED).sum()),
        ), now)

    def _statuses(self) -> Iterator[DiagnosticStatus]:
        """Yield what /diagnostics carries."""
        self._health.n_dropped = self._intake.n_dropped
        level, message, values = self._health.report(self.rejected, time.monotonic())
        values |= {
            "catalog": self._database.catalog.description,
            "configuration": self._configuration.digest,
            "version": package_version(),
        }
        name = self.get_fully_qualified_name()
        yield status_from_health(f"{name}: health", level, message, values)
        focal_length = self._watch.status()
        if focal_length is not None:
            yield focal_length


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("identify_node", IdentifyNode, args)


if __name__ == "__main__":
    sys.exit(main())
