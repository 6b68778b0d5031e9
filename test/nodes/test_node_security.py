"""docs/sros2.md permits what the nodes really use, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from ros_helpers import open_bench

from star_tracker.nodes.centroid_node import CentroidNode
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.sky_image_node import SkyImageNode

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sros2.md"
NODES = {
    "identify_node": (IdentifyNode, {"use_camera_info": True}),
    "centroid_node": (CentroidNode, {}),
    "sky_image_node": (SkyImageNode, {}),
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
    """The absolute names that a node subscribes to, publishes and replies to."""
    make, parameters = NODES[name]
    with open_bench() as bench:
        node = bench.start(make, {**parameters, "use_sim_time": True})
        space = bench.namespace
        return (
            space, {s.topic_name for s in node.subscriptions},
            {p.topic_name for p in node.publishers}, {s.service_name for s in node.services},
        )


def permitted(profile, kind, attribute, space):
    """Return the absolute names of a policy's entries."""
    group = next(g for g in profile.iter(kind) if attribute in g.attrib)
    assert group.attrib == {attribute: "ALLOW"}
    names = [entry.text for entry in group]
    assert len(set(names)) == len(names)
    return {
        name if name.startswith("/") else f"{space}/{name.replace('~', profile.attrib['node'])}"
        for name in names
    }


def test_each_node_of_the_policy_is_looked_at():
    text = PAGE.read_text(encoding="utf-8")
    for node in NODES:
        assert text.count(f'node="{node}"') == 1
    assert text.count("<profile ") == len(NODES)


def test_subscribed_topics(profile, running):
    space, subscribed, _, _ = running
    assert permitted(profile, "topics", "subscribe", space) == subscribed


def test_published_topics(profile, running):
    space, _, published, _ = running
    # rosout's publisher is not among those that a node lists.
    assert permitted(profile, "topics", "publish", space) == published | {"/rosout"}


def test_services(name, profile, running):
    space, _, _, services = running
    # Made below rclpy, as the node itself does not list it.
    type_description = f"{space}/{name}/get_type_description"
    assert permitted(profile, "services", "reply", space) == services | {type_description}
