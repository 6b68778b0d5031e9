"""relay_node: what detectors send becomes centroids, which identify_node solves."""

import numpy as np
import pytest
from geometry_msgs.msg import Point32, PolygonStamped, Pose, PoseArray
from rclpy.parameter import Parameter
from ros_helpers import IdentifyClient, new_header, open_bench, stamp_ns
from sensor_msgs.msg import PointCloud2

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.nodes import relay_node
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.relay_node import RELAY_PARAMETERS, RelayNode

MAP1 = paper_maps((1,))[0]


def polygon(header):
    message = PolygonStamped(header=header)
    message.polygon.points = [Point32(x=x, y=y, z=7.0) for x, y in MAP1.xy_px.tolist()]
    return message


def poses(header):
    message = PoseArray(header=header)
    for x, y in MAP1.xy_px.tolist():
        pose = Pose()
        pose.position.x, pose.position.y = x, y
        message.poses.append(pose)
    return message


TYPES = [
    ("geometry_msgs/PolygonStamped", PolygonStamped, polygon),
    ("geometry_msgs/PoseArray", PoseArray, poses),
]


@pytest.mark.parametrize(("name", "kind", "make"), TYPES)
def test_each_message_becomes_the_centroids_of_its_header(name, kind, make):
    with open_bench() as bench:
        clouds = bench.inbox(PointCloud2, "centroids")
        bench.start(RelayNode, {"message_type": name})
        bench.until(lambda: clouds.n_publishers, "publisher of centroids")
        message = make(new_header("star_camera"))
        bench.connected_outbox(kind, "detections").publish(message)
        bench.until(lambda: clouds.messages, "centroids")
    (cloud,) = clouds.messages
    assert cloud.header == message.header
    np.testing.assert_allclose(centroids_from_cloud(cloud).xy_px, MAP1.xy_px, rtol=1e-6)


def test_identify_node_solves_what_comes_through():
    with open_bench() as bench:
        client = IdentifyClient(bench)
        relay = RelayNode(
            context=bench.context, namespace=bench.namespace,
            parameter_overrides=[Parameter("message_type", value="geometry_msgs/PoseArray")],
        )
        bench._add(relay)
        bench.start(IdentifyNode, {"parity": "mirrored", "deadline_ms": 60_000.0})
        client.connect()
        detections = bench.connected_outbox(PoseArray, "detections")
        message = poses(new_header())
        detections.publish(message)
        stamp = stamp_ns(message.header)
        bench.until(lambda: client.attitudes.at(stamp), "attitude of the detections")


def test_a_type_whose_package_is_missing_is_refused_in_one_line(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(relay_node, "import_module", missing)
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(RelayNode)
    assert str(caught.value) == (
        "message_type vision_msgs/Detection2DArray needs vision_msgs, which cannot be imported "
        "(No module named 'vision_msgs.msg'): install ros-jazzy-vision-msgs"
    )


def test_another_type_is_refused():
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(RelayNode, {"message_type": "sensor_msgs/Image"})
    assert str(caught.value).startswith("parameter message_type is 'sensor_msgs/Image': it must")


def test_parameters_are_described_and_fixed():
    assert all(parameter.fixed and parameter.description for parameter in RELAY_PARAMETERS)
