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
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.labels import Identification, StarState
from star_tracker.nodes.declaring import (
    ParameterError,
    declare,
    no_such_parameter,
    unknown_parameters,
)
from star_tracker.nodes.identify.focal_length_follower import FocalLengthFollower
from star_tracker.nodes.identify.frame_solver import FrameSolver
from star_tracker.nodes.identify.health import (
    DiagnosticsPublisher,
    FrameRecord,
    Health,
    input_age_s,
)
from star_tracker.nodes.identify.intake import IncomingFrame, Intake
from star_tracker.nodes.identify.outputs import Outputs
from star_tracker.nodes.identify.runtime_parameters import RuntimeParameters
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.identify.starting import Starting
from star_tracker.nodes.parameters import IdentifyParameters
from star_tracker.nodes.running import run
from star_tracker.optics.camera import Camera
from star_tracker.resources import package_version
from star_tracker.solution import Solution, Status


class IdentifyNode(Node):
    """Identifies each frame of `centroids` and publishes what it found under the frame's stamp.

    It stands in the graph at once; a thread compiles or loads the solver, and frames wait for it.
    Raises ParameterError for a configuration that cannot be used: here, or out of spin where only
    the thread finds that out.
    """

    _runtime: RuntimeParameters | None = None

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "identify_node", automatically_declare_parameters_from_overrides=True, **node_options
        )
        #: Frames that were not searched, by reason.
        self.rejected: Counter[str] = Counter()
        try:
            p, given = declare(self, IdentifyParameters)
            self._setup = SolverSetup.of(p)
        except ValueError as error:
            self.destroy_node()
            raise ParameterError(str(error)) from error
        self._solver: FrameSolver | None = None
        self._starting: Starting | None = Starting(self)
        self._outputs = Outputs(self, p.reference_frame, p.camera_frame)
        self._follower = FocalLengthFollower(self, p.calibrate_focal_length)
        self._health = Health(time.monotonic())
        DiagnosticsPublisher(self, self._statuses)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._intake = Intake(self, lambda: self._setup, self._identify, self._reject)
        for sentence in unknown_parameters(self, given):
            self.get_logger().warning(sentence)
        self._runtime = RuntimeParameters(self, self._setup, self._apply)
        self._runtime.start()

    @property
    def ready(self) -> bool:
        """Whether frames are solved: the solver has been compiled or loaded."""
        return self._solver is not None

    def destroy_node(self) -> None:
        """End the node, and before it a database that is being built."""
        if self._runtime is not None:
            self._runtime.finish()
        super().destroy_node()

    def set_parameters_atomically(self, parameter_list: list[Any]) -> SetParametersResult:
        """Set all parameters or none; unlike rclpy's own, name those that do not exist."""
        unknown = [p.name for p in parameter_list if not self.has_parameter(p.name)]
        if unknown:
            return SetParametersResult(
                successful=False, reason="; ".join(no_such_parameter(self, n) for n in unknown)
            )
        return super().set_parameters_atomically(parameter_list)

    def _apply(self, setup: SolverSetup, database: FeatureDatabase) -> None:
        """Work with this setup from now on. Raises ValueError and keeps the one before."""
        self._solver = FrameSolver(setup, database, self._follower)
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
        self._intake.open()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._solver is not None:
            self._solver.reset()
        response.success, response.message = True, "the next frame is searched lost in space"
        return response

    def _identify(self, frame: IncomingFrame, camera: Camera) -> None:
        try:
            self._solve(frame, camera)
        except MessageError as error:
            self._reject(frame, "malformed_cloud", str(error))
        except Exception as error:  # one frame must not end the node
            if not self.context.ok():  # told to end meanwhile: nothing can be published
                raise ExternalShutdownException from error
            self._reject(frame, "internal_error", f"{type(error).__name__}: {error}")

    def _solve(self, frame: IncomingFrame, camera: Camera) -> None:
        """Take one frame the whole way. Raises MessageError where it cannot be read."""
        solver, header = self._solver, frame.header
        centroids = centroids_from_cloud(frame.message)
        answer = solver.solve(centroids, camera, frame.stamp_ns, frame.received_s)
        solution = answer.solution
        self._complain(solution)
        self._outputs.publish(solution, header, answer.hint)
        self._outputs.publish_stars(solution, centroids.xy_px, solver.catalog, header)
        if self._setup.parameters.publish_markers:
            self._outputs.publish_markers(solution, answer.camera, solver.catalog, header)
        self._record(frame, solution)

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

    def _reject(self, frame: IncomingFrame | None, kind: str, reason: str) -> None:
        """Count what cannot be used and say why, in the log and for a frame to the subscribers."""
        self.rejected[kind] += 1
        self.get_logger().error(reason, throttle_duration_sec=1.0)
        if frame is None:
            return
        solution = Solution(Status.BAD_INPUT, reason, Identification.empty(0))
        self._outputs.publish(solution, frame.header)
        self._record(frame, solution)

    def _record(self, frame: IncomingFrame, solution: Solution) -> None:
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
        if self._starting is not None:
            level, message = "warn", self._starting.sentence
        values |= {
            "catalog": self._solver.catalog.description if self._solver else None,
            "configuration": self._setup.digest,
            "version": package_version(),
        }
        name = self.get_fully_qualified_name()
        yield status_from_health(f"{name}: health", level, message, values)
        focal_length = self._follower.status()
        if focal_length is not None:
            yield focal_length


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("identify_node", IdentifyNode, args)


if __name__ == "__main__":
    sys.exit(main())
