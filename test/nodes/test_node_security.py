"""docs/sros2.md permits what the nodes really use, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from ros_helpers import open_bench
from std_msgs.msg import Empty

from star_tracker.nodes.centroid_node import CentroidNode
from star_tracker.nodes.identify import transforms
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.relay_node import RelayNode
from star_tracker.nodes.sky_image_node import SkyImageNode

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sros2.md"
#: Each node with parameters that make it use all that it can: one of each kind at a time.
NODES = {
    "identify_node": (IdentifyNode, [
        {"use_camera_info": True, "publish_quality": True},
        {"earth_frame": "enu", "use_fix": True, "publish_tf": True, "base_frame": "base_link"},
        {"earth_frame": "itrs", "use_velocity": True},
    ]),
    "centroid_node": (CentroidNode, [{}]),
    "sky_image_node": (SkyImageNode, [{}]),
    "relay_node": (RelayNode, [{"message_type": "geometry_msgs/PoseArray"}]),
}


@pytest.fixture(scope="module", params=NODES)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def profile(name):
    text = PAGE.read_text(encoding="utf-8")
    policy = text[text.index("<?xml") : text.index("</policy>") + len("</policy>")]
    profiles = ElementTree.fromstring(policy.encode()).iter("profile")
    (found,) = [one for one in profiles if one.attrib["node"] == name]
    return found


@pytest.fixture(scope="module")
def running(name):
    """The names that a node subscribes to, publishes and replies to; in its namespace relative."""
    make, choices = NODES[name]
    if len(choices) > 1:
        pytest.importorskip("erfa", reason="pyerfa is not installed")
    used = set(), set(), set()
    with pytest.MonkeyPatch.context() as patch:
        # tf2_msgs is no part of the wheels of ROS' messages: another type stands for it.
        patch.setattr(transforms, "_tf_type", lambda wanted_by: Empty)
        for parameters in choices:
            with open_bench() as bench:
                node = bench.start(make, {**parameters, "use_sim_time": True})
                for names, now in zip(used, (
                    {s.topic_name for s in node.subscriptions},
                    {p.topic_name for p in node.publishers},
                    {s.service_name for s in node.services},
                ), strict=True):
                    names |= {one.removeprefix(f"{bench.namespace}/") for one in now}
    return used


def permitted(profile, kind, attribute):
    """Return the names of a policy's entries, `~` written out."""
    group = next(g for g in profile.iter(kind) if attribute in g.attrib)
    assert group.attrib == {attribute: "ALLOW"}
    names = [entry.text for entry in group]
    assert len(set(names)) == len(names)
    return {name.replace("~", profile.attrib["node"]) for name in names}


def test_each_node_of_the_policy_is_looked_at():
    text = PAGE.read_text(encoding="utf-8")
    for node in NODES:
        assert text.count(f'node="{node}"') == 1
    assert text.count("<profile ") == len(NODES)


def test_subscribed_topics(profile, running):
    subscribed, _, _ = running
    assert permitted(profile, "topics", "subscribe") == subscribed


def test_published_topics(profile, running):
    _, published, _ = running
    # rosout's publisher is not among those that a node lists.
    assert permitted(profile, "topics", "publish") == published | {"/rosout"}


def test_services(name, profile, running):
    _, _, services = running
    # Made below rclpy, as the node itself does not list it.
    type_description = f"{name}/get_type_description"
    assert permitted(profile, "services", "reply") == services | {type_description}
