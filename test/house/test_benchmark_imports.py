"""What the scripts of `benchmark/` import is there: they run too seldom to tell by themselves."""

import ast
import importlib
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).parents[2] / "benchmark").glob("*.py"))


def imported(path):
    """Modules of the package that a script imports, each with the names that it takes of it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("star_tracker"):
            yield node.module, [alias.name for alias in node.names]


def test_there_are_scripts():
    assert len(SCRIPTS) > 20


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_what_a_script_imports_is_there(path):
    for module, names in imported(path):
        there = importlib.import_module(module)
        for name in names:
            if not hasattr(there, name):  # a module of the folder, then
                importlib.import_module(f"{module}.{name}")
