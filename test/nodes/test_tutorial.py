"""docs/tutorial.md as a reader follows it: its blocks in order, in one folder, with real nodes.

A comment above a block says what to do with it: `run` it, `start` it and leave it running (until
it has said what follows the colon), or save it as a `file`. `output` is what the block before
prints. From the first node on the steps are slow.
"""

import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from processes import ROOT, environment, wait_for_line
from waiting import longest_s

pytestmark = pytest.mark.usefixtures("solver_compiled")
BLOCK = re.compile(
    r"^<!-- (?P<order>run|start|file|output)(?:: (?P<what>[^\n]*))? -->\n"
    r"```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
#: The commands of the page, run by this Python from the sources under test.
PROGRAMS = {"python": "", "identify_node": "-m star_tracker.nodes.identify_node"}


@dataclass(frozen=True)
class Step:
    """A block of the page with what it prints, where the page shows that."""

    order: str
    what: str | None
    language: str
    text: str
    output: str | None


def steps_of(page):
    blocks = list(BLOCK.finditer(page))
    after = [*blocks[1:], None]
    return [
        Step(
            b["order"], b["what"], b["language"], b["text"],
            following["text"] if following and following["order"] == "output" else None,
        )
        for b, following in zip(blocks, after, strict=True) if b["order"] != "output"
    ]


PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
STEPS = steps_of(PAGE)


class Reader:
    """Follows the page in a folder. What has been started runs until `close`."""

    def __init__(self, folder):
        self.folder = folder
        self.names = {}
        self.printed = []
        self._running = contextlib.ExitStack()
        programs = folder / "bin"
        programs.mkdir()
        for name, arguments in PROGRAMS.items():
            script = programs / name
            script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments} "$@"\n')
            script.chmod(0o755)
        self._environment = environment(PATH=f"{programs}{os.pathsep}{os.environ['PATH']}")

    def close(self):
        self._running.close()

    def follow_to(self, i):
        """Follow the page to step `i`; return what that step prints."""
        while len(self.printed) <= i:
            step = STEPS[len(self.printed)]
            self.printed.append(getattr(self, f"_{step.order}")(step))
        return self.printed[i]

    def _file(self, step):
        (self.folder / step.what).write_text(step.text, encoding="utf-8")
        return ""

    def _run(self, step):
        if step.language == "python":
            out = io.StringIO()
            before = Path.cwd()
            os.chdir(self.folder)
            try:
                with contextlib.redirect_stdout(out):
                    exec(compile(step.text, "tutorial.md", "exec"), self.names)
            finally:
                os.chdir(before)
            return out.getvalue()
        return subprocess.run(
            ["sh", "-e", "-c", step.text], cwd=self.folder, env=self._environment, check=True,
            stdout=subprocess.PIPE, text=True, timeout=longest_s(),
        ).stdout

    def _start(self, step):
        process = subprocess.Popen(
            shlex.split(step.text), cwd=self.folder, env=self._environment,
            stderr=subprocess.PIPE, text=True,
        )
        self._running.callback(self._end, process)
        if step.what is not None:
            wait_for_line(process, step.what)
        return ""

    def _end(self, process):
        """End it as Ctrl-C does, and see that it ends well."""
        process.send_signal(signal.SIGINT)
        _, messages = process.communicate(timeout=longest_s())
        assert "Traceback" not in messages
        assert process.returncode == 0


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    reader = Reader(tmp_path_factory.mktemp("tutorial"))
    yield reader
    reader.close()


def same(shown, printed):
    """Return whether outputs agree: words exactly, numbers to 2 units of the last digit shown."""
    if NUMBER.split(shown) != NUMBER.split(printed):
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= 2.001 * unit(a) for a, b in pairs)


def unit(number):
    """Return one unit of a number's last digit; whole numbers must be equal."""
    mantissa, _, exponent = number.partition("e")
    if "." not in mantissa and not exponent:
        return 0.0
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def test_the_page_has_all_its_steps():
    orders = [step.order for step in STEPS]
    assert {order: orders.count(order) for order in orders} == {"run": 9, "start": 4, "file": 5}
    assert sum(step.output is not None for step in STEPS) == 9
    # Only installing, in two ways, is shown without being run.
    every = re.findall(r"^```\w*\n.*?^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert len(every) - len(BLOCK.findall(PAGE)) == 2


def each_step():
    """The places of the steps; each from the first one on that starts a process is slow."""
    marks = []
    for i, step in enumerate(STEPS):
        marks = [pytest.mark.slow] if step.order == "start" else marks
        yield pytest.param(i, id=f"{i + 1}-{step.order}", marks=marks)


@pytest.mark.parametrize("i", each_step())
def test_a_step_does_what_the_page_says(i, reader):
    printed = reader.follow_to(i)
    if STEPS[i].output is not None:
        assert same(STEPS[i].output, printed), f"the page shows\n{STEPS[i].output}not\n{printed}"


@pytest.mark.parametrize(
    ("shown", "printed", "expected"),
    [
        ("RA 1.00 deg", "RA 1.02 deg", True), ("RA 1.00 deg", "RA 1.03 deg", False),
        ("3 stars", "4 stars", False), ("2e-05", "3e-05", True), ("2e-05", "2e-04", False),
        ("SOLVED", "NO_MATCH", False), ("1.0 2.0", "1.0", False),
    ],
)
def test_outputs_are_compared_to_the_digits_shown(shown, printed, expected):
    assert same(shown, printed) is expected
