"""A bag solved without ROS gives what the nodes give, bit for bit; ROS reads what is written."""

import numpy as np
import pytest
from bag_files import HERE, asked_for, maps_bag, raw_messages

pytest.importorskip("rclpy", reason="rclpy is not installed")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.serialization import deserialize_message
from ros_helpers import IdentifyClient, open_bench, stamp_ns
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from std_msgs.msg import Header

from star_tracker.bags.frames import Reading, read_frames
from star_tracker.bags.output import declare_topics, write_result
from star_tracker.bags.reading import Announced, Wanted, open_bag
from star_tracker.bags.solving import BagSolver
from star_tracker.bags.topics import IMAGE
from star_tracker.bags.writing import new_bag
from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import camera_from_info, info_from_camera
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud, cloud_from_centroids
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.nodes.centroid_node import CentroidNode
from star_tracker.nodes.identify.camera_feed import CameraFeed
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.optics.camera import Camera

KINDS = {
    "/attitude": QuaternionStamped, "/boresight_deg": Vector3Stamped, "/imu": Imu,
    "/identified_stars": PointCloud2, "/solution": DiagnosticArray,
    "/camera_info": CameraInfo, "/centroids": PointCloud2, "/image": Image,
}
#: What identify_node does by itself where it listens to camera_info; frames have all the time.
DEFAULTS = {
    "use_camera_info": True, "camera_info_tolerance_percent": 1.0, "catalog": "hipparcos",
    "parity": "auto", "fov_deg": 0.0, "fov_tolerance_percent": 5.0, "width_px": 0,
    "height_px": 0, "deadline_ms": 60_000.0, "keep_up": False, "camera_info_wait_ms": 10_000.0,
}


@pytest.mark.parametrize("n_cameras", [1, 3])
def test_a_bag_and_a_node_take_the_same_camera_for_a_stamp(n_cameras):
    """In any order of the announcements, as long as the node remembers them all."""
    rng = np.random.default_rng(n_cameras)
    cameras = [Camera.from_fov(10.0 + i, 512, 512) for i in range(n_cameras)]
    for _ in range(200):
        feed, infos = CameraFeed(), []
        for stamp in rng.integers(0, 12, rng.integers(1, 9)).tolist():
            info = info_from_camera(
                cameras[rng.integers(n_cameras)], Header(stamp=Time(nanosec=stamp))
            )
            feed.announce(stamp, camera_from_info(info, "normal"))
            infos.append(info)
        of_bag = Announced(infos, "normal")
        for stamp in range(13):
            of_node = feed.best(stamp)
            if of_node is None:
                with pytest.raises(ValueError, match="all CameraInfo are younger than this frame"):
                    of_bag.at(stamp, "camera")
            else:
                assert of_bag.at(stamp, "camera") == of_node


def messages_of(path):
    """Return the messages of a bag, as ROS reads them, by topic."""
    found = {}
    for topic, _, _, raw in raw_messages(path):
        found.setdefault(topic, []).append(deserialize_message(raw, KINDS[topic]))
    return found


def of_the_node(frames, infos):
    """Send frames with their camera through an identify_node; return its messages by topic."""
    with open_bench() as bench:
        client = IdentifyClient(bench)
        imus = bench.inbox(Imu, "imu")
        bench.start(IdentifyNode, DEFAULTS)
        outbox = bench.connected_outbox(CameraInfo, "camera_info")
        client.connect()
        for frame, info in zip(frames, infos, strict=True):
            outbox.publish(info)
            client.send(frame)
        bench.until(lambda: len(imus.messages) == len(client.attitudes.messages), "last imu")
        return {
            "/attitude": client.attitudes.messages, "/imu": imus.messages,
            "/boresight_deg": client.boresights.messages, "/solution": client.solutions.messages,
            "/identified_stars": client.clouds.messages,
        }


def of_centroid_node(image):
    """Send an image through a centroid_node; return its centroids."""
    with open_bench() as bench:
        clouds = bench.inbox(PointCloud2, "centroids")
        node = bench.start(CentroidNode)
        bench.until(lambda: clouds.n_publishers, "publisher of centroids")
        outbox = bench.connected_outbox(Image, "image")
        bench.until_true(lambda: node.ready, "detector")
        outbox.publish(image)
        bench.until(lambda: clouds.at(stamp_ns(image.header)), "centroids of the image")
        return clouds.at(stamp_ns(image.header))[0]


def without_times(message):
    values = values_from_diagnostics(message)
    del values["solve_ms"]
    return stamp_ns(message.header), message.header.frame_id, values


@pytest.mark.parametrize("ending", ["mcap", pytest.param("db3", marks=pytest.mark.slow)])
def test_the_eight_maps_come_out_as_of_identify_node(tmp_path, ending, solver_compiled):
    """Attitudes, covariances, labels and all that is said of a frame, from either storage."""
    path = maps_bag(tmp_path / f"maps.{ending}")
    output = tmp_path / "out.mcap"
    with open_bag(path, Wanted()) as bag, new_bag(output) as writer:
        declare_topics(writer)
        for frame, result in BagSolver(bag, asked_for()).results(HERE):
            write_result(writer, frame, result)
    of_bag, sent = messages_of(output), messages_of(path)
    of_node = of_the_node(sent["/centroids"], sent["/camera_info"])
    assert len(of_bag["/attitude"]) == 8
    for topic in set(of_node) - {"/solution"}:
        assert of_bag[topic] == of_node[topic], topic
    assert [*map(without_times, of_bag["/solution"])] == [
        *map(without_times, of_node["/solution"])
    ]


def test_ros_reads_the_maps_as_replay_node_sends_them(tmp_path):
    sent = messages_of(maps_bag(tmp_path / "maps", storage="sqlite3"))
    for star_map, cloud, info in zip(
        paper_maps(), sent["/centroids"], sent["/camera_info"], strict=True
    ):
        assert info == info_from_camera(star_map.camera, cloud.header)
        centroids = centroids_from_cloud(cloud)
        assert centroids.xy_px.tolist() == star_map.xy_px.tolist()
        assert cloud == cloud_from_centroids(centroids, cloud.header)


@pytest.mark.parametrize("bits", [8, 12])
def test_images_become_the_centroids_of_centroid_node(tmp_path, bits):
    """Rounded as in its message, and counted from the middle of the first pixel."""
    path = maps_bag(tmp_path / "image.mcap", (1,), rendered=RenderSettings(bits=bits))
    (image,) = messages_of(path)["/image"]
    assert image.encoding == {8: "mono8", 12: "mono16"}[bits]
    published = centroids_from_cloud(of_centroid_node(image))
    reading = Reading(path, DetectSettings(), from_center=True)
    with open_bag(path, Wanted()) as bag:
        (read,) = read_frames(bag.frames(), IMAGE, reading, HERE)
    assert read.found.xy_px.tolist() == published.xy_px.tolist()
    assert read.found.intensity.tolist() == published.intensity.tolist()
    assert read.found.size_px == (512, 512)
