"""identify_node: star centroids in, attitude and identified stars out."""

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from star_tracker.calibration.camera_file import write_camera
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.labels import Identification
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.health import status_from_health
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.nodes.declaring import (
    DeclaringNode,
    Parameter,
    ParameterError,
    declare,
    unknown_parameters,
)
from star_tracker.nodes.identify.camera_report import camera_report
from star_tracker.nodes.identify.earth import EarthOutput
from star_tracker.nodes.identify.frame_solver import Answer, FrameSolver
from star_tracker.nodes.identify.health import DiagnosticsPublisher
from star_tracker.nodes.identify.intake import IncomingFrame, Intake
from star_tracker.nodes.identify.journal import Journal
from star_tracker.nodes.identify.outputs import Outputs
from star_tracker.nodes.identify.runtime_parameters import RuntimeParameters
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.identify.starting import Starting
from star_tracker.nodes.identify.transforms import Mounting, TransformOutput
from star_tracker.nodes.listening import overrides_checked
from star_tracker.nodes.parameters import IdentifyParameters
from star_tracker.nodes.running import run
from star_tracker.optics.camera import Camera
from star_tracker.resources import package_version
from star_tracker.solution import Solution, Status


class IdentifyNode(DeclaringNode):
    """Identifies each frame of `centroids` and publishes what it found under the frame's stamp.

    It stands in the graph at once; a thread compiles or loads the solver, and frames wait for it.
    Raises ParameterError for a configuration that cannot be used: here, or out of spin where only
    the thread finds that out.

    Args:
        listens: whether it subscribes to `centroids`; else frames come by `take` alone, from a
            node in the same process.
        neighbours: parameters of that one.
    """

    _runtime: RuntimeParameters | None = None

    def __init__(
        self, *, listens: bool = True, neighbours: Sequence[Parameter] = (), **node_options: Any
    ) -> None:
        super().__init__(
            "identify_node", automatically_declare_parameters_from_overrides=True, **node_options
        )
        try:
            p, given = declare(self, IdentifyParameters)
            self._setup = SolverSetup.of(p)
            self._make_topics(p, listens)
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        for sentence in unknown_parameters(self, given, neighbours):
            self.get_logger().warning(sentence)
        self._runtime = RuntimeParameters(self, self._setup, self._apply)
        self._runtime.start()

    def _make_topics(self, p: IdentifyParameters, listens: bool) -> None:
        """Make all that stands in the graph. Raises ValueError."""
        self._solver: FrameSolver | None = None
        self._starting: Starting | None = Starting(self)
        self._journal = Journal(self)
        with overrides_checked():
            self._outputs = Outputs(self, p.reference_frame, p.camera_frame, p.publish_quality)
            self._intake = Intake(
                self, lambda: self._setup, self._identify, self._reject, listens
            )
            mounting = Mounting(self, p.base_frame)
            self._transform = (
                TransformOutput(self, p.reference_frame, mounting) if p.publish_tf else None
            )
            self._earth = (
                EarthOutput(self, p, p.reference_frame, mounting)
                if p.earth_frame != "none" else None
            )
        DiagnosticsPublisher(self, self._statuses)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/save_camera", self._on_save_camera)

    def take(self, message: PointCloud2) -> None:
        """Take a frame as if it had come on `centroids`; in the node's executor only."""
        self._intake.take(message)

    @property
    def rejected(self) -> Counter[str]:
        """Frames that were not searched, and centroids that were left out, by reason."""
        return self._journal.rejected

    @property
    def ready(self) -> bool:
        """Whether frames are solved: the solver has been compiled or loaded."""
        return self._solver is not None

    def destroy_node(self) -> None:
        """End the node, and before it a database that is being built; keep what was learnt."""
        if self._runtime is not None:
            self._runtime.finish()
            if self._setup.parameters.camera_file and self._solver and self._solver.has_learnt:
                saved, sentence = self._save_camera()
                (self.get_logger().info if saved else self.get_logger().error)(sentence)
        super().destroy_node()

    def _apply(self, setup: SolverSetup, database: FeatureDatabase) -> None:
        """Work with this setup from now on. Raises ValueError and keeps the one before."""
        self._solver = FrameSolver(setup, database, self._solver)
        self._setup = setup
        starting, self._starting = self._starting, None
        if database.cache_note and not (starting and starting.warned):
            self.get_logger().warning(database.cache_note)
        waited = ""
        if starting:
            starting.end()
            if self._intake.n_waiting:
                waited = f"; {self._intake.n_waiting} frames have waited"
        self.get_logger().info(
            f"ready: {database.catalog.description}, {database.pairs.n_pairs} pairs, camera "
            f"{setup.camera_source}, parity {setup.parameters.parity}, "
            f"configuration {setup.digest}{waited}"
        )
        if setup.settings.method == "auto" and database.patterns_note:
            self.get_logger().info(f"no fallback: {database.patterns_note}")
        self._intake.open()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._solver is not None:
            self._solver.reset()
        response.success, response.message = True, "the next frame is searched lost in space"
        return response

    def _on_save_camera(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._save_camera()
        return response

    def _save_camera(self) -> tuple[bool, str]:
        """Write the camera as it is believed now; return whether that went, and a sentence."""
        camera = None if self._solver is None else self._solver.camera
        named = self._setup.parameters.camera_file
        if not named:
            return False, "camera_file is empty: restart the node with it set to a path"
        if camera is None:
            return False, "no camera is known yet: show the node some stars"
        path = Path(named).expanduser()
        try:
            write_camera(self._setup.for_file(camera), path)
        except OSError as error:
            return False, f"{path} cannot be written: {error.strerror or error}"
        return True, f"camera of {camera.fov_deg:.4g} deg written to {path}"

    def _identify(self, frame: IncomingFrame, camera: Camera | None) -> None:
        try:
            self._solve(frame, camera)
        except MessageError as error:
            self._reject(frame, "malformed_cloud", str(error))
        except Exception as error:  # one frame must not end the node
            if not self.context.ok():  # told to end meanwhile: nothing can be published
                raise ExternalShutdownException from error
            self._reject(frame, "internal_error", f"{type(error).__name__}: {error}")

    def _solve(self, frame: IncomingFrame, camera: Camera | None) -> None:
        """Take one frame the whole way. Raises MessageError where it cannot be read."""
        solver, header, p = self._solver, frame.header, self._setup.parameters
        centroids = centroids_from_cloud(
            frame.message, x=p.x_field, y=p.y_field, intensity=p.intensity_field or None
        )
        answer = solver.solve(
            self._setup.counted(centroids), camera, frame.stamp_ns, frame.received_s
        )
        self._journal.read(answer)
        self._outputs.publish(answer.solution, header, answer.hint)
        catalog = answer.solution.catalog or solver.catalog
        self._publish_to_robot(answer.solution, self._outputs.in_the_image(header), p)
        self._outputs.publish_stars(answer.solution, centroids.xy_px, catalog, header)
        if p.publish_markers and answer.camera is not None:
            self._outputs.publish_markers(answer.solution, answer.camera, catalog, header)
        self._journal.answered(frame, answer, p.log_frames)

    def _publish_to_robot(
        self, solution: Solution, camera_header: Header, p: IdentifyParameters
    ) -> None:
        """Publish a solved frame as a transform and against the Earth, where that is wanted."""
        if solution.attitude is None:
            return
        if self._transform is not None:
            self._transform.publish(solution.attitude, camera_header)
        if self._earth is not None:
            self._earth.publish(solution, camera_header, p)

    def _reject(self, frame: IncomingFrame | None, kind: str, reason: str) -> None:
        """Count what cannot be used and say why, in the log and for a frame to the subscribers."""
        self._journal.refused(kind, reason)
        if frame is None:
            return
        solution = Solution(Status.BAD_INPUT, reason, Identification.empty(0))
        self._outputs.publish(solution, frame.header)
        p = self._setup.parameters
        self._journal.answered(frame, Answer(solution, self._setup.camera), p.log_frames)

    def _statuses(self) -> Iterator[DiagnosticStatus]:
        """Yield what /diagnostics carries."""
        health = self._journal.health
        health.n_dropped = self._intake.n_dropped
        level, message, values = health.report(self._journal.rejected, time.monotonic())
        if self._starting is not None:
            level, message = "warn", self._starting.sentence
        values |= {
            "catalog": self._solver.catalog.description if self._solver else None,
            "configuration": self._setup.digest,
            "version": package_version(),
        }
        if self._earth is not None:
            values["without_earth_attitude"] = self._earth.n_refused
        # Without the first slash, of which the diagnostics' aggregator would make a blank.
        name = self.get_fully_qualified_name().lstrip("/")
        hardware = self._setup.parameters.camera_frame or self._journal.frame_id
        reports = {"health": (level, message, values)}
        if self._solver is not None:
            reports["camera"] = camera_report(self._solver.tracker, self._setup.told)
        for kind, report in reports.items():
            status = status_from_health(f"{name}: {kind}", *report)
            status.hardware_id = hardware or name
            yield status


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("identify_node", IdentifyNode, args)


if __name__ == "__main__":
    sys.exit(main())
