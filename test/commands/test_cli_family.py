"""The commands `star_tracker ...` are one family: help, units, defaults, JSON, errors, endings.

All of it is asked of each command of COMMANDS, so of a new one too.
"""

import json
import os
import re
import shlex
import signal
from importlib import import_module
from xml.etree import ElementTree

import pytest
from processes import ROOT, completed, ended, popen
from waiting import last_resort

from star_tracker.commands import cli

#: Commands whose examples take too long to be run here, or need a node that runs.
SLOW = {"evaluate", "watch"}
#: The unit that an option's name ends with, as its help has it.
UNITS = {"px": "px", "deg": "deg", "ms": "ms", "s": "s", "hz": "Hz", "arcsec": "arcsec"}
NAMES = sorted(cli.COMMANDS)
each_command = pytest.mark.parametrize("name", NAMES)


def parser_of(name):
    """Return a command's own parser, with all of its options."""
    (commands,) = cli.make_parser(name)._subparsers._group_actions
    return commands.choices[name]


def actions_of(name):
    return [a for a in parser_of(name)._actions if a.dest != "help"]


def run_main(capsys, *arguments):
    """Return exit code, output and messages of a command in this process."""
    try:
        code = cli.main(arguments)
    except SystemExit as end:
        code = end.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def started(*arguments, **options):
    """Start a command as a process of its own."""
    return popen("-m", "star_tracker.commands.cli", *arguments, **options)


# What a command says of itself


def test_each_command_has_its_module_and_each_module_its_command():
    modules = {path.stem for path in (ROOT / "star_tracker" / "commands").glob("[!_]*.py")}
    commands = {name.replace("-", "_") for name in NAMES}
    assert commands <= modules
    for name in modules - commands:
        assert not hasattr(import_module(f"star_tracker.commands.{name}"), "execute")


@each_command
def test_a_command_has_a_line_of_help_and_a_description(name):
    command = cli.COMMANDS[name]
    assert re.fullmatch(r"[a-z].{10,60}[^.]", command.summary)
    assert re.fullmatch(r"[A-Z].{30,}\.", command.description)


@each_command
def test_the_help_ends_with_an_example_that_can_be_parsed(name):
    example = cli.COMMANDS[name].example
    program, command, *_ = words = shlex.split(example)
    assert (program, command) == ("star_tracker", name)
    assert cli.make_parser(name).parse_args(words[1:]).command == name
    assert " ".join(parser_of(name).format_help().split()).endswith(f"example: {example}")


@each_command
def test_a_command_can_print_json(name):
    (action,) = (a for a in actions_of(name) if a.option_strings == ["--json"])
    assert action.nargs == 0
    assert action.help.startswith("print JSON")


@each_command
def test_all_that_a_command_takes_has_a_help_in_the_same_style(name):
    for action in actions_of(name):
        assert action.help, f"{name}: {action.dest} has no help"
        assert re.match(r"[a-z]|[A-Z]{2}|K\b", action.help), f"{name}: {action.help}"
        assert not action.help.endswith("."), f"{name}: {action.help}"


def options_of(name):
    """Return a command's options that take a value."""
    return [a for a in actions_of(name) if a.option_strings and a.nargs != 0]


@each_command
def test_an_option_tells_its_unit_and_its_default_in_parentheses(name):
    for action in options_of(name):
        option = action.option_strings[-1]
        text = action.help % {"default": action.default}
        default = re.search(r"\(([^()]+)\)$", text)
        assert default, f"{option}: the help must end with the default in parentheses: {text}"
        if action.default is not None:
            shown = action.default
            assert str(shown) in default[1] or f"{shown:g}" == default[1], option
        unit = UNITS.get(option.rsplit("-", 1)[-1])
        if unit is not None:
            assert re.search(rf"\b{unit}\b", text), f"{option}: the help must tell {unit}"
        if action.choices is None:
            assert action.metavar, f"{option}: give a metavar, the unit or N"


def test_the_help_lists_all_commands_and_an_example(capsys):
    code, out, err = run_main(capsys, "--help")
    assert (code, err) == (0, "")
    for name, command in cli.COMMANDS.items():
        assert re.search(rf"^ +{name} +{re.escape(command.summary)}$", out, re.MULTILINE)
    assert out.rstrip().splitlines()[-1].startswith("example: star_tracker ")


def test_the_version_is_that_of_package_xml(capsys):
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert run_main(capsys, "--version") == (0, f"star_tracker {version}\n", "")


def test_no_other_file_has_the_version_number():
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    sources = [ROOT / "setup.py", ROOT / "docs/conf.py", *(ROOT / "star_tracker").rglob("*.py")]
    assert [path for path in sources if version in path.read_text(encoding="utf-8")] == []


def test_a_command_does_not_load_the_modules_of_another():
    code = (
        "import sys, star_tracker.commands.cli as cli; cli.make_parser('geometry');"
        "print([n for n in cli.COMMANDS if f'star_tracker.commands.{n}' in sys.modules])"
    )
    assert completed("-c", code).stdout == "['geometry']\n"


# What it does


@pytest.mark.parametrize("name", sorted(set(NAMES) - SLOW))
def test_the_example_runs_for_people_and_for_machines(
    name, request, capsys, tmp_path, monkeypatch
):
    if name == "make-bag":
        pytest.importorskip("rosbags", reason="needs rosbags, an extra")
    if name == "compile":  # says how it gets on where nobody has compiled before
        request.getfixturevalue("solver_compiled")
    monkeypatch.chdir(tmp_path)
    words = shlex.split(cli.COMMANDS[name].example)[1:]
    code, out, err = run_main(capsys, *words)
    assert (code, err) == (0, "")
    assert out
    code, out, err = run_main(capsys, *words, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)


@each_command
def test_an_option_that_is_not_there_is_refused_in_one_line(name, capsys):
    words = shlex.split(cli.COMMANDS[name].example)[1:]
    code, out, err = run_main(capsys, *words, "--no-such-option")
    assert (code, out) == (2, "")
    assert err == (
        "star_tracker: unrecognized arguments: --no-such-option (see star_tracker --help)\n"
    )


@each_command
def test_an_option_without_its_value_is_refused_in_one_line(name, capsys):
    words = shlex.split(cli.COMMANDS[name].example)[1:]
    for option in (action.option_strings[-1] for action in options_of(name)):
        code, out, err = run_main(capsys, *words, option)
        assert (code, out) == (2, "")
        assert re.fullmatch(
            rf"star_tracker {name}: argument {option}: .* \(see star_tracker {name} --help\)\n",
            err,
        )


@pytest.mark.parametrize("words", [[], ["no-such-command"], ["--json"]])
def test_no_command_is_refused_in_one_line(words, capsys):
    code, out, err = run_main(capsys, *words)
    assert (code, out) == (2, "")
    assert re.fullmatch(r"star_tracker: .* \(see star_tracker --help\)\n", err)


@pytest.mark.parametrize("path", [".", "no/such/file.csv"])
def test_a_file_that_cannot_be_read_is_refused_in_one_line(path, capsys):
    code, out, err = run_main(capsys, "geometry", path)
    assert (code, out) == (2, "")
    assert re.fullmatch(r"star_tracker geometry: .+\n", err)


@pytest.mark.parametrize("form", [[], pytest.param(["--json"], marks=pytest.mark.slow)])
def test_a_reader_that_has_gone_ends_a_command_quietly(form):
    read, write = os.pipe()
    os.close(read)
    with started("geometry", "1", *form, stdout=write) as process:
        os.close(write)
        assert ended(process) == (cli.NO_READER, "")


def test_ctrl_c_ends_a_command_quietly(tmp_path):
    """It comes while the command waits for a map that somebody else is about to write."""
    fifo = tmp_path / "map.csv"
    os.mkfifo(fifo)
    with started("geometry", fifo) as process:
        # Lets the open() below return should the command have ended before it reads.
        with last_resort(lambda: os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)), fifo.open("w"):
            process.send_signal(signal.SIGINT)
        # Closed: a signal that came just before the reading is noticed after it.
        assert ended(process) == (cli.INTERRUPTED, "")
