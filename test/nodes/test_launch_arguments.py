"""What the arguments of launch files say, and what launch makes of the files where it is there."""

import re
import runpy
from pathlib import Path

import pytest

from star_tracker.nodes.launch_arguments import (
    files,
    number,
    pixels,
    quality,
    resolved,
    switch,
    triple,
)

LAUNCH_FILES = sorted((Path(__file__).resolve().parents[2] / "launch").glob("*.launch.py"))
#: Launch files with each of their arguments that names a file of parameters.
FILES_OF_PARAMETERS = [
    (source, name) for source in LAUNCH_FILES for name in ("params_file", "sky_params_file")
    if f'"{name}": (' in source.read_text(encoding="utf-8")
]
#: Handed on to camera.launch.py, which looks.
HANDED_ON = ("simulated_sky.launch.py", "params_file")


@pytest.mark.parametrize(("read", "text", "value"), [
    (switch, "True", True), (switch, "false", False), (pixels, "1936", 1936),
    (number, "-1e3", -1000.0), (triple, "[0.5, -1, 2]", [0.5, -1.0, 2.0]), (files, "", []),
    (files, __file__, [__file__]),
])
def test_what_is_understood(read, text, value):
    assert read("name", text) == value


@pytest.mark.parametrize(("read", "text", "sentence"), [
    (switch, "yes", "name:=yes must be true or false"),
    (pixels, "12.5", "name:=12.5 must be a whole number of pixels"),
    (pixels, "\u0663", "name:=\u0663 must be a whole number of pixels"),
    (number, "fast", "name:=fast must be a number"),
    (triple, "[1, 2]", "name:=[1, 2] must be three numbers, [x, y, z]"),
    (files, "/nowhere.yaml", "name:=/nowhere.yaml is not there"),
])
def test_what_is_refused_in_one_line(read, text, sentence):
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        read("name", text)


@pytest.mark.parametrize(("namespace", "topic", "whole"), [
    ("", "image", "/image"), ("left", "image", "/left/image"), ("/a/b/", "x/y", "/a/b/x/y"),
    ("left", "/camera/image_raw", "/camera/image_raw"),
])
def test_a_topic_in_a_namespace(namespace, topic, whole):
    assert resolved(namespace, topic) == whole


def test_the_quality_of_a_topic():
    assert quality("image_reliability", "", "/image.subscription") == {}
    assert quality("info_durability", "transient_local", "/info.subscription") == {
        "qos_overrides./info.subscription.durability": "transient_local",
    }
    sentence = "image_reliability:=sure must be reliable or best_effort"
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        quality("image_reliability", "sure", "/image.subscription")


def started(source, **arguments):
    """Return what a launch file starts; nothing runs. Parameters are written as launch does."""
    launch = pytest.importorskip("launch", reason="launch is not installed")
    pytest.importorskip("launch_ros", reason="launch_ros is not installed")
    from launch.launch_description_sources import PythonLaunchDescriptionSource
    from launch_ros.actions import Node

    context = launch.LaunchContext()
    context.launch_configurations.update(arguments)
    description = PythonLaunchDescriptionSource(str(source)).get_launch_description(context)
    found = [
        action for entity in description.entities for action in entity.visit(context) or ()
    ]
    nodes = [action for action in found if isinstance(action, Node)]
    for node in nodes:
        node._perform_substitutions(context)
    return nodes


@pytest.mark.parametrize("source", LAUNCH_FILES, ids=lambda source: source.name)
def test_launch_takes_the_defaults_of_each_file(source):
    assert started(source)


@pytest.mark.parametrize(("source", "name"), [
    pytest.param(source, name, id=f"{source.name}-{name}")
    for source, name in FILES_OF_PARAMETERS if (source.name, name) != HANDED_ON
])
def test_a_file_that_is_not_there_ends_the_launch(source, name):
    assert f'files("{name}"' in source.read_text(encoding="utf-8")  # where launch is missing, too
    with pytest.raises(ValueError, match=rf"{name}:=/nowhere\.yaml is not there"):
        started(source, **{name: "/nowhere.yaml"})


def test_each_launch_file_takes_a_file_of_parameters():
    assert {source for source, _ in FILES_OF_PARAMETERS} == set(LAUNCH_FILES)


def test_the_quality_of_topics_goes_to_the_node_that_has_them():
    pytest.importorskip("launch_ros", reason="launch_ros is not installed")
    (source,) = [one for one in LAUNCH_FILES if one.name == "camera.launch.py"]
    camera = runpy.run_path(str(source))
    told = {name: default for name, (default, _) in camera["ARGUMENTS"].items()} | {
        "image": "eye/image_raw", "image_transport": "compressed", "namespace": "left",
        "camera_info": "/eye/info", "image_reliability": "best_effort",
        "camera_info_durability": "transient_local", "centroids_reliability": "best_effort",
    }
    centroid, identify = (sets[-1] for sets in camera["parameters"](told))
    given = {
        name: value for one in (centroid, identify) for name, value in one.items()
        if name.startswith("qos_overrides")
    }
    assert given == {
        "qos_overrides./left/eye/image_raw/compressed.subscription.reliability": "best_effort",
        "qos_overrides./left/centroids.publisher.reliability": "best_effort",
        "qos_overrides./eye/info.subscription.durability": "transient_local",
    }
    assert "qos_overrides./eye/info.subscription.durability" in identify
