"""The demo's image: rendered, its stars detected, identified, and held against the truth."""

from contextlib import ExitStack

import numpy as np
import rclpy
from geometry_msgs.msg import QuaternionStamped
from rclpy.executors import SingleThreadedExecutor

from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.geometry.spherical import Floats, separation, unit_vectors
from star_tracker.identification.labels import StarState
from star_tracker.msg_adapters.attitude import array_from_quaternion
from star_tracker.msg_adapters.stamp import nanoseconds_from_header
from star_tracker.nodes.demo_frames import TIMEOUT_S, Collector, Result, Row, process
from star_tracker.nodes.sky_parameters import SkyImageParameters
from star_tracker.optics.camera import PIXEL_ORIGINS

#: Largest error of the boresight. A right solution is a hundred times better.
_BORESIGHT_LIMIT_DEG = 0.1
#: A label is right where the star belongs so near to its centroid: some ten times the residuals.
_LABEL_LIMIT_PX = 1.0
_SKY = SkyImageParameters(rate_hz=2.0)
#: The camera is told by camera_info, and a busy machine may take its time.
_IDENTIFY = [
    "-p", "use_camera_info:=true", "-p", "camera_info_wait_ms:=1000.0",
    "-p", "deadline_ms:=10000.0", "-p", "keep_up:=false",
]


class ImageCollector(Collector):
    """Gathers the answers to rendered images, and the truth."""

    def __init__(self) -> None:
        super().__init__(expected=1)
        self._truth: dict[int, Floats] = {}
        self.create_subscription(QuaternionStamped, "truth/attitude", self._on_truth, 50)

    @property
    def answered(self) -> tuple[Result, Floats] | None:
        """The first image whose answer and truth have both come whole; None before."""
        for stamp in sorted(set(self._stars) & set(self._values) & set(self._truth)):
            solved = self._values[stamp]["status"] == "SOLVED"
            if not solved or stamp in self._boresight:
                result = Result(
                    self._values[stamp], self._stars[stamp], self._boresight.get(stamp)
                )
                return result, self._truth[stamp]
        return None

    def _on_truth(self, message: QuaternionStamped) -> None:
        self._truth[nanoseconds_from_header(message.header)] = array_from_quaternion(message)
        self._look()

    def _look(self) -> None:
        if self.answered is not None and not self.complete.done():
            self.complete.set_result(True)


def collect_image() -> tuple[Result, Floats]:
    """Send a rendered image through three processes; return the answer and the true quaternion.

    Images are sent until one is answered: those before all connections are made are lost. Raises
    TimeoutError where none is.
    """
    with ExitStack() as stack:
        stack.enter_context(process("identify_node", _IDENTIFY))
        stack.enter_context(process("centroid_node", []))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        collector, executor = ImageCollector(), SingleThreadedExecutor()
        executor.add_node(collector)
        stack.callback(executor.shutdown)
        stack.callback(collector.destroy_node)
        executor.spin_until_future_complete(collector.connected, timeout_sec=TIMEOUT_S)
        stack.enter_context(process("sky_image_node", ["-p", f"rate_hz:={_SKY.rate_hz}"]))
        executor.spin_until_future_complete(collector.complete, timeout_sec=TIMEOUT_S)
        if collector.answered is None:
            raise TimeoutError(f"no rendered image was answered within {TIMEOUT_S:g} s")
        return collector.answered


def grade_image(result: Result, truth: Floats) -> Row:
    """Hold an answer against the true quaternion (4,) of its image."""
    rotation, camera, stars = rotation_matrix(truth), _SKY.camera, result.stars
    known = stars[stars["state"] == StarState.IDENTIFIED]
    places = camera.pixels(
        unit_vectors(np.radians(known["ra_deg"]), np.radians(known["dec_deg"])) @ rotation
    ) - PIXEL_ORIGINS["center"]
    off_px = np.hypot(*(places - np.column_stack([known["x"], known["y"]])).T)
    n_right = int((off_px <= _LABEL_LIMIT_PX).sum())
    faults, error_deg = [], float("nan")
    if result.boresight_deg is None:
        faults.append(f"no attitude: {result.values.get('reason', 'no reason given')}")
    else:
        found = unit_vectors(*np.radians(result.boresight_deg[:2]))
        error_deg = float(np.degrees(separation(rotation[:, 2], found)))
        if not error_deg <= _BORESIGHT_LIMIT_DEG:
            faults.append(
                f"boresight is {error_deg:.3f} deg off, more than {_BORESIGHT_LIMIT_DEG:g}"
            )
    if n_right < len(known):
        faults.append(f"{len(known) - n_right} of {len(known)} labels are wrong")
    pose = np.full(3, np.nan) if result.boresight_deg is None else result.boresight_deg
    cells = (
        "image", f"{camera.fov_deg:.0f} deg/{camera.width_px}", f"{n_right}/{len(known)}",
        str(len(known)), str(int((stars["state"] == StarState.DISPLACED).sum())),
        *(f"{angle:.4f}" for angle in pose), f"{3600 * error_deg:.2f}",
        result.values.get("log10_false_alarms", "-"), result.values.get("solve_ms", "-"),
    )
    return Row(cells, n_right, len(known), 0, tuple(faults))
