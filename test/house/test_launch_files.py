"""The launch files name what there is. Launch itself comes with ROS and is not needed here."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))
#: Programs of other packages.
OTHERS = {"rviz2", "ekf_node"}


def commands():
    """Return the console commands of the package with the functions that they call."""
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    return dict(re.findall(r'"(\w+) = [\w.]+:(\w+)"', text))


def arguments_of(source):
    """Return the names of a launch file's own dictionary of arguments."""
    for node in ast.parse(source.read_text(encoding="utf-8")).body:
        names = [target.id for target in getattr(node, "targets", []) if hasattr(target, "id")]
        if names == ["ARGUMENTS"]:
            return [key.value for key in node.value.keys if key is not None]
    pytest.fail(f"{source.name} has no ARGUMENTS")


@pytest.mark.parametrize("source", LAUNCH_FILES, ids=lambda source: source.name)
def test_what_a_launch_file_starts_is_installed(source):
    text = source.read_text(encoding="utf-8")
    named = re.findall(r'(?:executable=|\bnode\()"(\w+)"', text)
    assert named
    assert set(named) - OTHERS <= set(commands())


def test_each_node_has_its_command():
    text = (ROOT / "star_tracker" / "nodes" / "running.py").read_text(encoding="utf-8")
    defined = set(re.findall(r'^def (\w+)\(\) -> int:', text, re.MULTILINE))
    nodes = {name for name in commands() if not name.startswith("star_tracker")}
    assert nodes == defined
    for name in nodes:
        assert commands()[name] == name
        assert (ROOT / "star_tracker" / "nodes" / f"{name}.py").is_file()


def test_the_page_has_each_argument_of_camera_launch():
    page = (ROOT / "docs" / "camera.md").read_text(encoding="utf-8")
    table = page.split("| argument |")[1].split("\n\n")[0]
    rows = [row.split("|")[1] for row in table.splitlines() if row.startswith("| `")]
    named = {name for cell in rows for name in re.findall(r"`(\w+)`", cell)}
    assert named == set(arguments_of(ROOT / "launch" / "camera.launch.py"))
