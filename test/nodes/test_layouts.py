"""The layouts for Foxglove and RViz: they name what exists, here and there."""

import json
import re

import pytest
import yaml
from ros_helpers import open_bench

from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.resources import resource_path

#: Types of panels of Foxglove's app, by which a layout names them: `type` of the built-in panels
#: in packages/studio-base/src/panels/index.ts of github.com/foxglove/studio, and "Tab" for
#: TAB_PANEL_TYPE.
PANELS = {
    "3D", "DiagnosticStatusPanel", "DiagnosticSummary", "Gauge", "Image", "Indicator", "map",
    "Parameters", "Plot", "Publish", "RawMessages", "RosOut", "StateTransitions", "Tab", "Table",
    "Teleop", "TopicGraph",
}
#: Keys of a 3D panel's configuration: RendererConfig in panels/ThreeDeeRender/IRenderer.ts there,
#: of cameraState: CameraState in panels/ThreeDeeRender/camera.ts. All panels may have a title.
PANEL_3D = {
    "cameraState", "followTf", "followMode", "scene", "publish", "transforms", "topics", "layers",
    "imageMode", "foxglovePanelTitle",
}
CAMERA_STATE = {
    "distance", "perspective", "phi", "target", "targetOffset", "targetOrientation", "thetaOffset",
    "fovy", "near", "far",
}
#: Classes that plugins_description.xml of rviz_default_plugins in github.com/ros2/rviz declares,
#: and the panels of rviz_common (rviz_common/default.rviz there).
RVIZ_CLASSES = {
    *(f"rviz_default_plugins/{name}" for name in (
        "Axes", "Camera", "Grid", "Marker", "MarkerArray", "PointCloud2", "Pose", "TF",
        "FocusCamera", "Interact", "Measure", "MoveCamera", "PublishPoint", "Select",
        "FPS", "Orbit", "TopDownOrtho", "XYOrbit",
    )),
    *(f"rviz_common/{name}" for name in (
        "Displays", "Group", "Selection", "Time", "Tool Properties", "Views",
    )),
}
#: Fields of the messages that are plotted by a field, not by key and value.
FIELDS = {"vector.x", "vector.y", "vector.z"}
PAIR = re.compile(r'values\[:\]\{key=="(?P<key>\w+)"\}\.value$')


@pytest.fixture(scope="module")
def foxglove():
    return json.loads(resource_path("config/foxglove_layout.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def rviz():
    path = resource_path("config/star_tracker.rviz")
    return yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def published():
    """What a real node publishes, as if in the root namespace: topics with types, and keys."""
    with open_bench() as bench:
        node = bench.start(IdentifyNode)
        topics = {
            topic.removeprefix(bench.namespace): types[0]
            for topic, types in node.get_publisher_names_and_types_by_node(
                node.get_name(), bench.namespace
            )
        }
        (health,) = node._statuses()
    return topics, {pair.key for pair in health.values}


def every(value, key):
    """Yield what stands under a key, anywhere in nested lists and mappings."""
    if isinstance(value, dict):
        if key in value:
            yield value[key]
        for inner in value.values():
            yield from every(inner, key)
    elif isinstance(value, list):
        for inner in value:
            yield from every(inner, key)


def leaves(layout):
    """Yield the panels that a layout shows, those of splits."""
    if isinstance(layout, str):
        yield layout
        return
    assert set(layout) <= {"direction", "splitPercentage", "first", "second"}
    assert layout["direction"] in ("row", "column")
    yield from leaves(layout["first"])
    yield from leaves(layout["second"])


def paths(foxglove):
    """Return the message paths of all panels; a topic alone is one too."""
    plots = [path["value"] for found in every(foxglove, "paths") for path in found]
    topics = [topic for panel in every(foxglove, "topics") for topic in panel]
    return [*plots, *topics, *every(foxglove, "topicToRender"), *every(foxglove, "topicPath")]


def test_foxglove_panels_are_of_known_types(foxglove):
    assert {name.split("!")[0] for name in foxglove["configById"]} <= PANELS
    assert set(foxglove) == {
        "configById", "globalVariables", "userNodes", "playbackConfig", "layout",
    }


def test_foxglove_3d_panels_have_known_keys_and_the_nodes_frame(foxglove):
    panels = [c for name, c in foxglove["configById"].items() if name.startswith("3D!")]
    assert panels
    for panel in panels:
        assert set(panel) <= PANEL_3D
        assert set(panel["cameraState"]) <= CAMERA_STATE
        assert panel["followTf"] == "icrs"


def test_foxglove_shows_each_panel_that_it_describes(foxglove):
    shown = set(leaves(foxglove["layout"]))
    for tabs in every(foxglove["configById"], "tabs"):
        for tab in tabs:
            shown |= set(leaves(tab["layout"]))
    assert shown == set(foxglove["configById"])


def test_foxglove_topics_are_published(foxglove, published):
    topics, _ = published
    named = {path.split(".")[0].split("[")[0] for path in paths(foxglove)}
    assert named <= set(topics)
    assert {"/markers", "/solution", "/diagnostics", "/boresight_deg", "/attitude"} <= named


def test_foxglove_plots_name_fields_and_keys_that_exist(foxglove, published):
    _, health = published
    # What a solution tells is known from its adapter; here from the words of the README.
    solution = {"rms_px", "solve_ms", "matched", "total"}
    for path in [path["value"] for found in every(foxglove, "paths") for path in found]:
        topic, _, field = path.partition(".")
        pair = PAIR.search(path)
        if pair is None:
            assert (topic, field in FIELDS) == ("/boresight_deg", True)
        elif topic == "/solution":
            assert pair["key"] in solution
        else:
            assert path.startswith('/diagnostics.status[:]{name=="identify_node: health"}.')
            assert pair["key"] in health


def test_rviz_classes_are_of_the_default_plugins(rviz):
    classes = {name for name in every(rviz, "Class") if name}
    assert classes <= RVIZ_CLASSES


def test_rviz_draws_the_markers_in_their_frame(rviz, published):
    topics, _ = published
    manager = rviz["Visualization Manager"]
    drawn = [d["Topic"]["Value"] for d in manager["Displays"] if "Topic" in d]
    # Relative, so that it follows the namespace in which RViz is started.
    assert drawn == ["markers"]
    assert topics["/markers"] == "visualization_msgs/msg/MarkerArray"
    assert manager["Global Options"]["Fixed Frame"] == "icrs"
