"""What identify_node publishes of each frame."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.node import Node
from sensor_msgs.msg import Imu, PointCloud2
from std_msgs.msg import Float64, Header
from visualization_msgs.msg import MarkerArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters.attitude import boresight_from_attitude, quaternion_from_attitude
from star_tracker.msg_adapters.imu import imu_from_attitude
from star_tracker.msg_adapters.markers import markers_from_solution
from star_tracker.msg_adapters.point_cloud import cloud_from_identification
from star_tracker.msg_adapters.solution import (
    QUALITIES,
    diagnostics_from_solution,
    quality_from_solution,
)
from star_tracker.nodes.listening import PUBLISHED
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

_QUEUE_DEPTH = 50


class Outputs:
    """The publishers of one node.

    Args:
        node: what publishes.
        reference_frame: frame_id of what stands in the sky.
        camera_frame: frame_id of what stands in the image; empty = that of the input.
        quality: whether the numbers for plots are published.
    """

    def __init__(
        self, node: Node, reference_frame: str, camera_frame: str, quality: bool = False
    ) -> None:
        self._name = node.get_name()
        self._reference_frame, self._camera_frame = reference_frame, camera_frame
        make = partial(node.create_publisher, qos_overriding_options=PUBLISHED)
        self._attitude = make(QuaternionStamped, "attitude", _QUEUE_DEPTH)
        self._imu = make(Imu, "imu", _QUEUE_DEPTH)
        self._boresight = make(Vector3Stamped, "boresight_deg", _QUEUE_DEPTH)
        self._stars = make(PointCloud2, "identified_stars", _QUEUE_DEPTH)
        self._solution = make(DiagnosticArray, "solution", _QUEUE_DEPTH)
        self._markers = make(MarkerArray, "markers", _QUEUE_DEPTH)
        self._quality = {
            name: make(Float64, f"quality/{name}", _QUEUE_DEPTH) for name in QUALITIES if quality
        }

    def publish(self, solution: Solution, header: Header, hint: str = "") -> None:
        """Publish how a frame ended and, where it was solved, its attitude.

        Args:
            solution: the frame's.
            header: the frame's.
            hint: what would solve it, where that is known.
        """
        if solution.attitude is not None:
            reference = self._in_the_sky(header)
            self._attitude.publish(quaternion_from_attitude(solution.attitude, reference))
            self._boresight.publish(boresight_from_attitude(solution.attitude, reference))
            self._imu.publish(imu_from_attitude(solution.attitude, self.in_the_image(header)))
        self._solution.publish(diagnostics_from_solution(solution, self._name, header, hint))
        if self._quality:
            for name, number in quality_from_solution(solution).items():
                self._quality[name].publish(number)

    def publish_stars(
        self, solution: Solution, xy_px: Floats, catalog: StarCatalog, header: Header
    ) -> None:
        """Publish the labels of a frame's centroids (n, 2)."""
        self._stars.publish(cloud_from_identification(
            solution.identification, xy_px, catalog, self.in_the_image(header)
        ))

    def publish_markers(
        self, solution: Solution, camera: Camera, catalog: StarCatalog, header: Header
    ) -> None:
        """Publish a frame's drawing for RViz and Foxglove."""
        self._markers.publish(
            markers_from_solution(solution, camera, catalog, self._in_the_sky(header))
        )

    def _in_the_sky(self, header: Header) -> Header:
        return Header(stamp=header.stamp, frame_id=self._reference_frame)

    def in_the_image(self, header: Header) -> Header:
        """Return the header of a frame with the frame_id of its camera."""
        return Header(stamp=header.stamp, frame_id=self._camera_frame or header.frame_id)
