"""The README's tables are those of the code."""

import re

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from star_tracker.nodes.parameters import IDENTIFY_PARAMETERS, REPLAY_PARAMETERS
from star_tracker.resources import resource_path


def as_markdown(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    return '""' if value == "" else str(value)


@pytest.mark.parametrize(
    ("heading", "parameters"),
    [
        ("### Parameters of `identify_node`", IDENTIFY_PARAMETERS),
        ("### Parameters of `replay_node`", REPLAY_PARAMETERS),
    ],
)
def test_readme_lists_each_parameter_with_default_and_unit(heading, parameters):
    path = resource_path("data").parent / "README.md"
    if not path.is_file():
        pytest.skip("the README is only in a source checkout")
    section = path.read_text(encoding="utf-8").split(heading)[1].split("\n#")[0]
    rows = re.findall(r"^\| `(\w+)` \| `(.*?)` \| (.*?) \|", section, re.MULTILINE)
    assert [(name, default, unit.strip()) for name, default, unit in rows] == [
        (p.name, as_markdown(p.default), p.unit) for p in parameters
    ]
