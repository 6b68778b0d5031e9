"""`star_tracker compile`: what it says, and what it does where nothing can be kept."""

import json
import re
import threading

import pytest

from star_tracker.commands import cli
from star_tracker.commands import compile as module
from star_tracker.compiled import CacheState


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """Set the state of the cache that the command finds; `marked` is set when it is filled."""
    marked = threading.Event()

    def found(*, writable, warm):
        state = CacheState(tmp_path, writable=writable, warm=warm)
        monkeypatch.setattr(module, "cache_state", lambda: state)
        monkeypatch.setattr(module, "mark_warm", marked.set)
        return marked

    return found


def run(capsys, *words):
    code = cli.main(["compile", *words])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_warm_cache_is_said_to_be_there(cache, capsys, tmp_path):
    cache(writable=True, warm=True)
    assert run(capsys) == (0, f"the solver is compiled, in {tmp_path}\n", "")


def test_a_cold_cache_is_filled_and_the_progress_told(cache, capsys, monkeypatch, tmp_path):
    marked, lines, enough = cache(writable=True, warm=False), [], threading.Event()

    def told(line, **_):
        lines.append(line)
        if len(lines) >= 3:
            enough.set()

    monkeypatch.setattr(module, "exercise_solver", lambda: enough.wait(60))
    monkeypatch.setattr(module, "_PERIOD_S", 0.001)
    monkeypatch.setattr(module, "print", told, raising=False)
    assert run(capsys)[0] == 0
    *progress, last = lines
    assert len(progress) >= 3
    assert all(re.fullmatch(r"compiling the solver, \d+ s", line) for line in progress)
    assert re.fullmatch(rf"the solver was compiled in \d+ s, and is kept in {tmp_path}", last)
    assert marked.is_set()


def test_progress_begins_at_once(cache, capsys, monkeypatch):
    cache(writable=True, warm=False)
    monkeypatch.setattr(module, "exercise_solver", lambda: None)
    assert run(capsys)[2] == "compiling the solver, 0 s\n"


def test_machines_are_told_the_same(cache, capsys, tmp_path):
    cache(writable=True, warm=True)
    code, out, err = run(capsys, "--json")
    record = json.loads(out)
    assert (code, err) == (0, "")
    assert (record["folder"], record["was_compiled"]) == (str(tmp_path), True)
    assert record["seconds"] >= 0


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(cache, capsys, tmp_path):
    marked = cache(writable=False, warm=False)
    assert run(capsys) == (2, "", (
        f"star_tracker compile: compiled code cannot be kept in {tmp_path}: set NUMBA_CACHE_DIR "
        "to a folder that can be written\n"
    ))
    assert not marked.is_set()


def test_a_read_only_folder_that_is_filled_will_do(cache, capsys, tmp_path):
    cache(writable=False, warm=True)
    assert run(capsys) == (0, f"the solver is compiled, in {tmp_path}\n", "")
