"""Rules that the tests themselves keep."""

import re
from collections import Counter
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
SOURCES = sorted(TESTS.rglob("*.py"))
#: A number of seconds as a limit of a wait.
LIMIT = re.compile(r"\b(?:timeout|timeout_sec|timeout_s)=\d|Timer\(\d")


def test_no_two_files_have_one_name():
    """pytest imports test files by their names alone."""
    names = Counter(path.name for path in SOURCES if path.name.startswith("test_"))
    assert [name for name, n in names.items() if n > 1] == []


def test_how_long_a_test_waits_stands_in_one_place():
    """In `waiting.py`, which knows of busy machines."""
    found = [
        f"{path.relative_to(TESTS)}: {line.strip()}"
        for path in SOURCES for line in path.read_text(encoding="utf-8").splitlines()
        if LIMIT.search(line)
    ]
    assert found == []
