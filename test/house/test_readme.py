"""README.md and docs/parameters.md say what the code does."""

import re
from pathlib import Path

import numpy as np
import pytest

from star_tracker.solution import Status

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PARAMETERS = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


def parameters():
    """Return the parameters of each node, as declared."""
    pytest.importorskip("rclpy", reason="rclpy is not installed")
    from star_tracker.nodes.centroid.parameters import CENTROID_PARAMETERS
    from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS, REPLAY_PARAMETERS
    from star_tracker.nodes.sky_parameters import SKY_IMAGE_PARAMETERS

    return {
        "identify_node": IDENTIFY_PARAMETERS, "replay_node": REPLAY_PARAMETERS,
        "centroid_node": CENTROID_PARAMETERS, "sky_image_node": SKY_IMAGE_PARAMETERS,
    }


def as_markdown(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    return '""' if value == "" else str(value)


def declared(parameters):
    return [(p.name, as_markdown(p.default), p.unit) for p in parameters]


def rows_of(text, heading):
    """Return name, default and unit of each row of the table under a heading."""
    section = text.split(f"{heading}\n")[1].split("\n#")[0]
    rows = re.findall(r"^\| `(\w+)` \| `(.*?)` \| (.*?) \|", section, re.MULTILINE)
    return [(name, default, unit.strip()) for name, default, unit in rows]


def test_the_page_lists_each_parameter_with_default_and_unit():
    for node, of_node in parameters().items():
        assert rows_of(PARAMETERS, f"## Parameters of `{node}`") == declared(of_node)


def test_the_readme_lists_ten_of_them():
    rows = rows_of(README, "### The ten parameters that people set")
    assert len(rows) == 10
    assert set(rows) <= set(declared(parameters()["identify_node"]))


def test_the_readme_is_short():
    assert README.count("\n") <= 220


def test_the_readme_names_each_folder_of_the_package():
    folders = {path.parent.name for path in (ROOT / "star_tracker").glob("*/__init__.py")}
    assert set(re.findall(r"^\| `(\w+)/` \|", README, re.MULTILINE)) == folders


def test_the_python_of_the_readme_solves_the_frame_of_the_tutorial(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (frame,) = re.findall(r"^x,y,intensity\n(.*?)```", TUTORIAL, re.MULTILINE | re.DOTALL)
    table = np.array([row.split(",") for row in frame.split()], float)
    names = {"xy_px": table[:, :2], "intensity": table[:, 2]}
    exec(compile(code, "README.md", "exec"), names)
    assert names["solution"].status is Status.SOLVED
    assert str(names["solution"].status) in capsys.readouterr().out
