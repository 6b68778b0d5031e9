"""docs/sros2.md permits what identify_node really uses, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from ros_helpers import open_bench

from star_tracker.nodes.identify_node import IdentifyNode

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sros2.md"


@pytest.fixture(scope="module")
def profile():
    text = PAGE.read_text(encoding="utf-8")
    policy = text[text.index("<?xml") : text.index("</policy>") + len("</policy>")]
    (found,) = ElementTree.fromstring(policy.encode()).iter("profile")
    return found


@pytest.fixture(scope="module")
def running():
    """The absolute names that a node subscribes to, publishes and replies to."""
    with open_bench() as bench:
        node = bench.start(IdentifyNode, {"use_camera_info": True, "use_sim_time": True})
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
        name if name.startswith("/") else f"{space}/{name.replace('~', 'identify_node')}"
        for name in names
    }


def test_subscribed_topics(profile, running):
    space, subscribed, _, _ = running
    assert permitted(profile, "topics", "subscribe", space) == subscribed


def test_published_topics(profile, running):
    space, _, published, _ = running
    # rosout's publisher is not among those that a node lists.
    assert permitted(profile, "topics", "publish", space) == published | {"/rosout"}


def test_services(profile, running):
    space, _, _, services = running
    # Made below rclpy, as the node itself does not list it.
    type_description = f"{space}/identify_node/get_type_description"
    assert permitted(profile, "services", "reply", space) == services | {type_description}
