"""Damaged files, and signals at any stage, for nodes as processes: how they end, what they say."""

import os
import re
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from ros_helpers import frame_of, new_header, stamp_ns
from test_processes import (
    IDENTIFY,
    MAPS,
    REPLAY,
    TIMEOUT_S,
    ended,
    identify_process,
    lines_of_the_node,
    run_to_the_end,
    running,
    start,
    wait_for_line,
)

from star_tracker.catalogue.catalog import CATALOG_FILE
from star_tracker.maps.star_map import STAR_MAPS_FOLDER, paper_maps
from star_tracker.resources import resource_path

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


def assert_refused(code, messages, path):
    """Exit code 2 and one sentence that names the file."""
    assert code == 2, messages
    assert len(lines_of_the_node(messages)) == 1, messages
    assert "[FATAL]" in messages
    assert str(path) in messages
    assert "Traceback" not in messages


# ---- damaged files ---------------------------------------------------------------------------

#: identify_node with another catalogue file: it has no parameter for that.
OTHER_CATALOG = """
import sys
from pathlib import Path
from star_tracker.catalogue import catalog
from star_tracker.nodes import identify_node
catalog.resource_path = lambda name: Path({path!r})
sys.exit(identify_node.main())
"""


def truncated(content):
    return content[: len(content) // 2]


def flipped(content):
    """Damage the values of the first rows; their head is whole."""
    return content[:400] + b"\xff" * 400 + content[800:]


@pytest.mark.parametrize("damage", [truncated, flipped, lambda _: b"", lambda _: b"junk"],
                         ids=["truncated", "flipped", "empty", "junk"])
def test_damaged_catalogue(tmp_path, damage):
    path = tmp_path / "catalogue.npy"
    path.write_bytes(damage(resource_path(CATALOG_FILE).read_bytes()))
    with start(["-c", OTHER_CATALOG.format(path=str(path))]) as process:
        try:
            code, messages = ended(process)
        finally:
            process.kill()
    assert_refused(code, messages, path)


@pytest.mark.parametrize("damage", [
    lambda text: text[: len(text) // 2].rsplit(b"\n", 1)[0] + b"\nA,1.0", lambda _: b"",
    lambda _: bytes(range(256)),
], ids=["truncated", "empty", "binary"])
def test_damaged_map(tmp_path, damage):
    folder = tmp_path / "maps"
    shutil.copytree(resource_path(STAR_MAPS_FOLDER), folder)
    path = folder / "map3.csv"
    path.write_bytes(damage(path.read_bytes()))
    assert_refused(*run_to_the_end(REPLAY, "-p", f"folder:={folder}"), path)


@pytest.mark.parametrize("module", [IDENTIFY, REPLAY])
def test_truncated_parameter_file(tmp_path, module):
    """The shipped file, cut in the middle of a line."""
    whole = resource_path("config/fov12.yaml").read_text(encoding="utf-8")
    path = tmp_path / "cut.yaml"
    path.write_text(whole[: whole.index("ros__parameters") + 7], encoding="utf-8")
    assert_refused(*run_to_the_end(module, "--params-file", str(path)), path)


# ---- the cache of features -------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache of features for the processes of a test; compiled code stays in the usual one."""
    usual = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    monkeypatch.setenv("NUMBA_CACHE_DIR", os.environ.get("NUMBA_CACHE_DIR") or usual)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "star_tracker"


def started(namespace):
    """Start identify_node, wait until it is ready and return its messages at the end."""
    with running(IDENTIFY, namespace, MAPS) as process:
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "ready: " in line:
                break
        process.send_signal(signal.SIGTERM)
        code, rest = ended(process)
    messages = "".join(lines) + rest
    assert code == 0, messages
    assert "ready: " in messages
    assert "Traceback" not in messages
    return messages


def test_damaged_cache_is_named_in_one_line_and_built_again(cache):
    assert "feature file" not in started("/first")
    (path,) = cache.glob("features-*.npz")
    whole = path.read_bytes()
    path.write_bytes(whole[:-1000])
    messages = started("/second")
    (line,) = (line for line in messages.splitlines() if "feature file" in line)
    assert re.search(rf"\[WARN\].* feature file {re.escape(str(path))} cannot be read: .+; "
                     r"it is built again$", line)
    assert path.read_bytes() == whole
    assert "feature file" not in started("/third")


def test_cache_that_cannot_be_written_is_named_in_one_line(cache):
    cache.touch()  # a file where the folder has to be
    messages = started("/unsaved")
    lines = [line for line in messages.splitlines() if "feature file" in line]
    assert len(lines) == 1, messages
    assert f"feature file {cache}/features-" in lines[0]
    assert "cannot be saved: " in lines[0]


# ---- signals ---------------------------------------------------------------------------------

#: A node that signals itself when a function is first entered, and goes on.
SIGNAL_AT = """
import os, sys
from star_tracker.nodes import {module} as node_module
def signalled(owner, name):
    before = getattr(owner, name)
    def wrapper(*args, **kwargs):
        setattr(owner, name, before)
        os.kill(os.getpid(), {number})
        return before(*args, **kwargs)
    setattr(owner, name, wrapper)
signalled({owner}, {name!r})
sys.exit(node_module.main())
"""
INT, TERM = int(signal.SIGINT), int(signal.SIGTERM)
#: Each stage with one signal, in turn: `test_processes.py` has both while the database is made.
STAGES = [
    ("identify_node", "node_module", "declare", INT),
    ("identify_node", "node_module.IdentifyNode", "_apply", TERM),
    ("identify_node", "node_module", "Outputs", INT),
    ("identify_node", "node_module", "Intake", TERM),
    ("replay_node", "node_module", "declare", TERM),
    ("replay_node", "node_module", "paper_maps", INT),
]


@pytest.mark.parametrize(("module", "owner", "name", "number"), STAGES)
def test_signal_at_any_stage_of_the_start(module, owner, name, number):
    script = SIGNAL_AT.format(module=module, owner=owner, name=name, number=number)
    with start(["-c", script]) as process:
        try:
            code, messages = ended(process)
        finally:
            process.kill()
    assert code == 0, messages
    assert "Traceback" not in messages
    assert "FATAL" not in messages


#: A console command that signals itself when it comes to import numpy, as heavy as it gets.
SIGNAL_AT_IMPORT = """
import os, sys
from star_tracker.nodes import entry_points
class Finder:
    def find_spec(name, path=None, target=None):
        if name == "numpy":
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Finder)
sys.exit(entry_points.{node}())
"""


@SIGNALS
@pytest.mark.parametrize("node", ["identify_node", "replay_node"])
def test_signal_to_a_console_command_that_still_imports(node, number):
    with start(["-c", SIGNAL_AT_IMPORT.format(node=node, number=int(number))]) as process:
        try:
            code, messages = ended(process)
        finally:
            process.kill()
    assert (code, messages) == (0, "")


def test_console_command_passes_arguments_and_exit_code_on():
    script = "import sys; from star_tracker.nodes import entry_points as e; sys.exit(e.{}())"
    with start(["-c", script.format("replay_node")], "", ["-p", "rate_hz:=-1.0"]) as process:
        code, messages = ended(process)
    assert_refused(code, messages, "rate_hz")


#: A node that is still compiling, for as long as it takes, when a signal comes.
SIGNAL_WHILE_COMPILING = """
import os, sys, threading
from star_tracker.nodes import identify_node as node_module
def compiling(*_):
    os.kill(os.getpid(), {number})
    threading.Event().wait()
node_module.IdentifyNode._apply = compiling
sys.exit(node_module.main())
"""


@SIGNALS
def test_signal_to_a_node_that_compiles(number):
    with start(["-c", SIGNAL_WHILE_COMPILING.format(number=int(number))]) as process:
        try:
            code, messages = ended(process)
        finally:
            process.kill()
    assert code == 0, messages
    assert "Traceback" not in messages


#: A node that gets a second signal while it ends, as below launch when Ctrl-C is typed.
SIGNAL_TWICE = """
import os, sys
from star_tracker.nodes import identify_node as node_module
end = node_module.IdentifyNode.destroy_node
def again(node):
    os.kill(os.getpid(), {number})
    end(node)
node_module.IdentifyNode.destroy_node = again
sys.exit(node_module.main())
"""


@SIGNALS
def test_second_signal_while_the_node_ends(number):
    script = SIGNAL_TWICE.format(number=int(number))
    with start(["-c", script], "/twice", MAPS) as process:
        try:
            wait_for_line(process, "ready: ")
            process.send_signal(number)
            code, messages = ended(process)
        finally:
            process.kill()
    assert code == 0, messages
    assert "Traceback" not in messages


#: A node that is refused, with a signal's handler that shuts down just when the node does.
SHUT_DOWN_TWICE = """
import sys
import rclpy
from star_tracker.nodes import replay_node
def both():
    context = rclpy.get_default_context()
    context.shutdown()
    context.shutdown()
rclpy.try_shutdown = both
sys.exit(replay_node.main(["--ros-args", "-p", "rate_hz:=-1.0"]))
"""


def test_shutdown_that_comes_second():
    with start(["-c", SHUT_DOWN_TWICE]) as process:
        try:
            code, messages = ended(process)
        finally:
            process.kill()
    assert_refused(code, messages, "rate_hz")


@SIGNALS
def test_signal_to_an_idle_node(number):
    with running(IDENTIFY, "/idle", MAPS) as process:
        wait_for_line(process, "ready: ")
        process.send_signal(number)
        code, messages = ended(process)
    assert code == 0, messages
    assert "Traceback" not in messages


@SIGNALS
def test_signal_while_frames_are_solved(number):
    """Frames of noise, of which each takes long, are still waiting when the signal comes."""
    noise = np.random.default_rng(1).uniform(0, 512, (60, 2))
    with identify_process() as (process, client):
        good = frame_of(paper_maps((1,))[0].xy_px, new_header())
        client.publish(good)
        client.bench.until(lambda: client.attitudes.at(stamp_ns(good.header)), "attitude")
        for _ in range(40):
            client.publish(frame_of(noise))
        before = len(client.solutions.messages)
        client.bench.until(lambda: len(client.solutions.messages) > before, "one answer")
        process.send_signal(number)
        code, messages = ended(process)
    assert code == 0, messages
    assert "Traceback" not in messages


def test_two_nodes_start_with_one_empty_cache(cache):
    both = [start(["-m", IDENTIFY], f"/twin{n}", MAPS) for n in (1, 2)]
    try:
        for process in both:
            wait_for_line(process, "ready: ")
            process.send_signal(signal.SIGTERM)
        for process in both:
            code, messages = ended(process)
            assert code == 0, messages
            assert "Traceback" not in messages
    finally:
        for process in both:
            process.kill()
            process.communicate(timeout=TIMEOUT_S)
    assert len(list(cache.iterdir())) == 1
