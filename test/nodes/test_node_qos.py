"""QoS of topics that a user overrides by parameters, as ROS 2 has it for every node."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_helpers import open_bench

from star_tracker.nodes.camera_to_attitude import make_nodes
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.launch_arguments import quality, resolved
from star_tracker.nodes.replay_node import ReplayNode


def qos_of(infos):
    (info,) = infos
    return info.qos_profile.reliability, info.qos_profile.durability


def test_publishers_and_subscriptions_take_what_is_overridden():
    with open_bench() as bench:
        space = bench.namespace
        node = bench.start(IdentifyNode, {
            f"qos_overrides.{space}/solution.publisher.reliability": "best_effort",
            f"qos_overrides.{space}/imu.publisher.depth": 3,
            f"qos_overrides.{space}/camera_info.subscription.durability": "transient_local",
            f"qos_overrides.{space}/centroids.subscription.reliability": "best_effort",
            "use_camera_info": True,
        })
        imu = f"qos_overrides.{space}/imu.publisher.depth"
        assert node.get_parameter(imu).value == 3
        assert node.describe_parameter(imu).read_only
        assert qos_of(node.get_publishers_info_by_topic(f"{space}/solution"))[0] == (
            ReliabilityPolicy.BEST_EFFORT
        )
        assert qos_of(node.get_subscriptions_info_by_topic(f"{space}/centroids"))[0] == (
            ReliabilityPolicy.BEST_EFFORT
        )
        assert qos_of(node.get_subscriptions_info_by_topic(f"{space}/camera_info"))[1] == (
            DurabilityPolicy.TRANSIENT_LOCAL
        )


def test_overridden_durability_is_not_changed_for_a_latched_publisher():
    from sensor_msgs.msg import CameraInfo

    with open_bench() as bench:
        name = f"{bench.namespace}/camera_info"
        node = bench.start(IdentifyNode, {
            f"qos_overrides.{name}.subscription.durability": "volatile", "use_camera_info": True,
        })
        bench.connected_outbox(
            CameraInfo, "camera_info", ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        )
        assert qos_of(node.get_subscriptions_info_by_topic(name))[1] == DurabilityPolicy.VOLATILE


@pytest.mark.parametrize("make", [IdentifyNode, ReplayNode])
@pytest.mark.parametrize("value", ["sometimes", 3])
def test_what_is_no_policy_is_refused(make, value):
    with open_bench() as bench:
        topic = "solution" if make is IdentifyNode else "centroids"
        name = f"qos_overrides.{bench.namespace}/{topic}.publisher.reliability"
        with pytest.raises(ParameterError, match="reliability"):
            bench.start(make, {name: value})


def test_a_topic_that_is_not_there_is_named(capfd):
    with open_bench() as bench:
        bench.start(IdentifyNode, {"qos_overrides./nowhere.publisher.depth": 3})
    assert "there is no parameter qos_overrides./nowhere.publisher.depth" in capfd.readouterr().err


def test_diagnostics_are_heard_whatever_is_overridden():
    with open_bench() as bench:
        reports = bench.inbox(DiagnosticArray, "/diagnostics")
        bench.start(IdentifyNode, {
            f"qos_overrides.{bench.namespace}/solution.publisher.durability": "transient_local",
        })
        bench.until(lambda: reports.messages, "report in /diagnostics")


def test_the_arguments_of_camera_launch_reach_the_topics_of_both_nodes(capfd):
    """Each node of the process hears what is for the other one, and does not complain."""
    with open_bench() as bench:
        space = bench.namespace
        image, info, centroids = (
            resolved(space, topic) for topic in ("eye/image_raw", "eye/info", "centroids")
        )
        told = {
            **quality("image_reliability", "best_effort", f"{image}.subscription"),
            **quality("camera_info_durability", "transient_local", f"{info}.subscription"),
            **quality("centroids_reliability", "best_effort", f"{centroids}.publisher"),
            "use_camera_info": True,
        }
        centroid, identify = (bench._add(node) for node in make_nodes(
            context=bench.context, namespace=space,
            parameter_overrides=[Parameter(name, value=value) for name, value in told.items()],
            cli_args=["--ros-args", "-r", "image:=eye/image_raw", "-r", "camera_info:=eye/info"],
        ))
        assert qos_of(centroid.get_subscriptions_info_by_topic(image))[0] == (
            ReliabilityPolicy.BEST_EFFORT
        )
        assert qos_of(identify.get_subscriptions_info_by_topic(info))[1] == (
            DurabilityPolicy.TRANSIENT_LOCAL
        )
        assert qos_of(centroid.get_publishers_info_by_topic(centroids))[0] == (
            ReliabilityPolicy.BEST_EFFORT
        )
    assert "there is no parameter" not in capfd.readouterr().err
