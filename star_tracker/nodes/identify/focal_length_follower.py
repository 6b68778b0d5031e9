"""How identify_node follows the focal length: its status, the service, and what it applies."""

import time

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from msg_adapters.focal_length import sentence_from_focal_length, status_from_focal_length
from star_tracker.calibration.focal_length import FocalLengthEstimator
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

#: Shortest time between two frames that go in, s: a fit takes 2 ms.
_FRAME_S = 0.1
#: Cameras that are remembered; the oldest is forgotten.
_CAMERAS = 16


class FocalLengthFollower:
    """The estimates of one node, one for each camera that it meets.

    Args:
        node: what serves.
        mode: `off`, `report` or `apply`.
    """

    def __init__(self, node: Node, mode: str) -> None:
        self._mode = mode
        self._estimators: dict[Camera, FocalLengthEstimator] = {}
        self._last: FocalLengthEstimator | None = None
        self._last_frame_s = -_FRAME_S
        node.create_service(Trigger, "~/calibrate", self._on_calibrate)

    def camera(self, nominal: Camera) -> Camera:
        """Return the camera to solve a frame with that was taken with a nominal camera."""
        if self._mode == "off":
            return nominal
        estimator = self._estimators.get(nominal)
        if estimator is None:
            if len(self._estimators) >= _CAMERAS:
                self._estimators.pop(next(iter(self._estimators)))
            estimator = self._estimators[nominal] = FocalLengthEstimator(nominal)
        self._last = estimator
        return estimator.apply() if self._mode == "apply" else nominal

    def learn(self, camera: Camera, solution: Solution, xy_px: Floats, stars: StarCatalog) -> None:
        """Take in a frame that was solved with the camera that `camera` returned last."""
        now = time.monotonic()
        due = now - self._last_frame_s >= _FRAME_S
        if self._last is None or solution.attitude is None or not due:
            return
        self._last_frame_s = now
        found = solution.identification
        which = found.identified
        self._last.add(
            camera.with_parity(solution.parity), xy_px[which],
            stars.vectors[found.catalog_index[which]],
        )

    def status(self, name: str) -> DiagnosticStatus | None:
        """Return the estimate of the camera of the last frame, None where there is none."""
        if self._last is None:
            return None
        return status_from_focal_length(self._last.estimate, name)

    def _on_calibrate(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Answer with the estimate of the camera of the last frame."""
        if self._mode == "off":
            response.success = False
            response.message = (
                "calibrate_focal_length is off: restart the node with it set to report or apply"
            )
        elif self._last is None:
            response.success, response.message = False, "no frame has come yet"
        else:
            estimate = self._last.estimate
            response.success = estimate.n_frames > 0
            response.message = sentence_from_focal_length(estimate)
        return response
