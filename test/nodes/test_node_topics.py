"""The tables of topics have what identify_node really publishes and subscribes to."""

import re
from pathlib import Path

import pytest
from ros_helpers import open_bench
from std_msgs.msg import Empty

from star_tracker.nodes.identify import transforms
from star_tracker.nodes.identify_node import IdentifyNode

ROOT = Path(__file__).resolve().parents[2]
README = "README.md", "### Topics of `identify_node`"
ASKED_FOR = "docs/frames.md", "## Topics"
FOR_PLOTS = "docs/watch.md", "## Plots and recordings"
#: tf2_msgs is no part of the wheels of ROS' messages: another type stands for it here.
TF = {"std_msgs/Empty": "tf2_msgs/TFMessage"}
#: What every node of ROS has besides.
OF_EVERY_NODE = {("pub", "/parameter_events", "rcl_interfaces/ParameterEvent")}
PLACE = {"earth_frame": "enu", "use_fix": True, "publish_tf": True, "base_frame": "base_link"}
VELOCITY = {"earth_frame": "itrs", "use_velocity": True}


def told(name, heading):
    """Return kind, topic and type of each row of a table of topics."""
    section = (ROOT / name).read_text(encoding="utf-8").split(f"{heading}\n")[1].split("\n#")[0]
    return set(re.findall(r"^\| (pub|sub) `([\w/]+)` \| `([\w/]+)` \|", section, re.MULTILINE))


def real(parameters):
    """Return kind, topic and type of each topic of a node with these parameters."""
    with open_bench() as bench:
        node = bench.start(IdentifyNode, {"use_camera_info": True, **parameters})
        space = f"{bench.namespace}/"
        return {
            (kind, topic.topic_name.removeprefix(space), type_of(topic.msg_type))
            for kind, topics in (("pub", node.publishers), ("sub", node.subscriptions))
            for topic in topics
        } - OF_EVERY_NODE


def type_of(message):
    package, _, _ = message.__module__.partition(".")
    name = f"{package}/{message.__name__}"
    return TF.get(name, name)


def test_the_readme_has_the_topics_that_need_not_be_asked_for():
    assert told(*README) == real({})


def test_the_page_of_the_frames_has_the_others(monkeypatch):
    pytest.importorskip("erfa", reason="pyerfa is not installed")
    monkeypatch.setattr(transforms, "_tf_type", lambda wanted_by: Empty)
    assert told(*README) | told(*ASKED_FOR) == real(PLACE) | real(VELOCITY)


def test_the_page_of_watching_has_those_for_plots():
    assert told(*README) | told(*FOR_PLOTS) == real({"publish_quality": True})
