"""What nodes cannot work with: exit code 2 and one line, which names the thing.

Each node is run as by its command, in the process of the tests.
"""

import shutil
import signal

import pytest
from processes import MAPS, assert_refused

from star_tracker.catalogue import catalog
from star_tracker.catalogue.catalog import CATALOG_FILE
from star_tracker.maps.star_map import STAR_MAPS_FOLDER
from star_tracker.nodes import identify_node, replay_node
from star_tracker.resources import resource_path


@pytest.fixture
def refused(capfd, solver_compiled):
    """A function that runs a node with ROS arguments to its end and looks at how it ends."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]

    def run(node, *arguments, text):
        code = node.main(["--ros-args", *map(str, arguments)])
        assert_refused(code, capfd.readouterr().err, text)

    yield run
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


# ---- parameters ------------------------------------------------------------------------------


@pytest.mark.parametrize(("node", "argument", "text"), [
    (identify_node, "fov_deg:=500.0",
     "parameter fov_deg is 500.0: it must be a number from 0 to 120 deg"),
    (identify_node, "fov_deg:=.nan",
     "parameter fov_deg is nan: it must be a number from 0 to 120 deg"),
    (identify_node, "catalog:=tycho",
     "parameter catalog is 'tycho': it must be one of paper, hipparcos, gaia"),
    (replay_node, "maps:=[9]",
     "parameter maps is [9]: it must be a list, each item a whole number from 1 to 8"),
    (replay_node, "folder:=/nowhere", "star map /nowhere/map1.csv cannot be read"),
])
def test_bad_parameter(refused, node, argument, text):
    refused(node, "-p", argument, text=text)


@pytest.mark.parametrize("arguments", [
    ["--no-such-option"], ["-p", "fov_deg"], ["-p", "fov_deg:="], ["--log-level", "nonsense"],
], ids=" ".join)
def test_unknown_ros_argument(refused, arguments):
    refused(identify_node, *arguments, text=arguments[-1])


@pytest.mark.parametrize("node", [identify_node, replay_node])
@pytest.mark.parametrize("content", [
    "/**:\n  ros__parameters:\n    fov_deg: [1\n",
    "/**:\n  ros__parameters:\n    fov_deg:\n",
    "/**:\n  ros__parameters:\n    pair_tolerance_px: [1, 2.5]\n",
    "fov_deg: 12.0\n",
    "\x00\x01",
    "cut",
    None,
], ids=["unclosed", "no value", "mixed types", "no node", "binary", "cut", "missing"])
def test_broken_parameter_file(refused, tmp_path, node, content):
    path = tmp_path / "broken.yaml"
    if content == "cut":  # the shipped file, in the middle of a line
        whole = resource_path("config/fov12.yaml").read_text(encoding="utf-8")
        content = whole[: whole.index("ros__parameters") + 7]
    if content is not None:
        path.write_text(content, encoding="utf-8")
    refused(node, "--params-file", path, text=path)


# ---- damaged files ---------------------------------------------------------------------------


@pytest.mark.parametrize("damage", [
    lambda content: content[: len(content) // 2],
    # The values of the first rows; their head is whole.
    lambda content: content[:400] + b"\xff" * 400 + content[800:],
    lambda _: b"",
    lambda _: b"junk",
], ids=["truncated", "flipped", "empty", "junk"])
def test_damaged_catalogue(refused, tmp_path, monkeypatch, damage):
    path = tmp_path / "catalogue.npy"
    path.write_bytes(damage(resource_path(CATALOG_FILE).read_bytes()))
    monkeypatch.setattr(catalog, "resource_path", lambda _: path)
    refused(identify_node, *MAPS, text=path)


@pytest.mark.parametrize("damage", [
    lambda text: text[: len(text) // 2].rsplit(b"\n", 1)[0] + b"\nA,1.0",
    lambda _: b"",
    lambda _: bytes(range(256)),
], ids=["truncated", "empty", "binary"])
def test_damaged_map(refused, tmp_path, damage):
    folder = tmp_path / "maps"
    shutil.copytree(resource_path(STAR_MAPS_FOLDER), folder)
    path = folder / "map3.csv"
    path.write_bytes(damage(path.read_bytes()))
    refused(replay_node, "-p", f"folder:={folder}", text=path)
