"""What identify_node publishes of a frame, written to a bag."""

from collections.abc import Mapping
from functools import cache

from star_tracker.bags.reading import BagFrame
from star_tracker.bags.writing import BagWriter
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.identification.labels import Identification
from star_tracker.msg_adapters.attitude import boresight_from_attitude, quaternion_from_attitude
from star_tracker.msg_adapters.imu import imu_from_attitude
from star_tracker.msg_adapters.point_cloud import cloud_from_identification
from star_tracker.msg_adapters.solution import diagnostics_from_solution
from star_tracker.offline.solving import Result
from star_tracker.solution import Solution, Status

#: The topics, as identify_node has them in the root namespace, and their types.
TOPICS: Mapping[str, str] = {
    "/attitude": "geometry_msgs/QuaternionStamped",
    "/boresight_deg": "geometry_msgs/Vector3Stamped",
    "/imu": "sensor_msgs/Imu",
    "/solution": "diagnostic_msgs/DiagnosticArray",
    "/identified_stars": "sensor_msgs/PointCloud2",
}
#: Frame of the attitude, and who answers, as by default of the node.
_REFERENCE_FRAME, _NAME = "icrs", "identify_node"


@cache
def _any_catalog() -> StarCatalog:
    """Return the guide stars of a frame of which none was identified."""
    return StarCatalog.named("paper")


def declare_topics(writer: BagWriter) -> None:
    """Add the topics to a bag."""
    for topic, name in TOPICS.items():
        writer.declare(topic, name)


def write_result(writer: BagWriter, frame: BagFrame, result: Result) -> None:
    """Write what became of a frame, under its stamp, to a bag with `declare_topics`."""
    image = writer.header(frame.stamp_ns, frame.frame_id)
    sky = writer.header(frame.stamp_ns, _REFERENCE_FRAME)
    solution = result.solution or Solution(
        Status.BAD_INPUT, result.error, Identification.empty(0)
    )
    messages: dict[str, object] = {}
    if solution.attitude is not None:
        messages["/attitude"] = quaternion_from_attitude(solution.attitude, sky)
        messages["/boresight_deg"] = boresight_from_attitude(solution.attitude, sky)
        messages["/imu"] = imu_from_attitude(solution.attitude, image)
    messages["/solution"] = diagnostics_from_solution(solution, _NAME, image)
    if result.frame is not None:
        catalog = solution.catalog or _any_catalog()
        messages["/identified_stars"] = cloud_from_identification(
            solution.identification, result.frame.told_px, catalog, image
        )
    for topic, message in messages.items():
        writer.write(topic, message, frame.logged_ns)
