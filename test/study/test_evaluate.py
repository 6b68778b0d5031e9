"""`star_tracker evaluate`: the command."""

import json
import os
import signal
import subprocess
import sys

import pytest
from processes import completed, popen
from waiting import longest_s

from star_tracker.commands import cli
from star_tracker.study.configuration import read_study
from star_tracker.study.plan import MAP, plan
from star_tracker.study.records import summarise

RUN = "import sys; sys.modules['rclpy'] = None; from star_tracker.commands import cli; cli.main()"


def test_json_of_the_command_in_a_process_without_ros(small, tmp_path):
    """Nothing but JSON on standard output, no progress bar where there is no terminal."""
    path = small.write(tmp_path, {
        **small.content, "cameras": ["12 deg"], "combined": [],
        "sweeps": {"noise_px": {"values": [0, 1]}},
    })
    arguments = [
        "evaluate", "--config", path, "--output", tmp_path / "out", "--jobs", "1", "--json",
    ]
    done = completed("-c", RUN, *arguments)
    assert (done.stderr, done.returncode) == ("", 0)
    found = json.loads(done.stdout)
    timed = {"median_cpu_ms", "p95_cpu_ms", "time_ratio"}
    study = read_study(path)
    here = summarise(study, small.run_here(plan(study), tmp_path / "here"))
    assert [{k: v for k, v in r.items() if k not in timed} for r in found] == [
        {k: v for k, v in vars(r).items() if k not in timed} for r in here
    ]
    assert {record.sweep for record in here} == {MAP, "noise_px"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "chunks", "curves.png", "report.html", "report.md", "results.csv"
    }


def test_what_is_left_out_is_told_and_reported(small, tmp_path, capsys):
    """Real images without a folder; a contestant that cannot do without a field of view."""
    content = {
        **small.content, "frames": 1, "maps": [], "combined": [], "cameras": ["12 deg"],
        "contestants": [{"method": "radial_cyclic"}],
        "sweeps": {"fov_error_percent": {"values": [0, "unknown"]}},
        "images": {"fov_error_percent": {"values": [0]}},
    }
    output = tmp_path / "out"
    path = small.write(tmp_path, content)
    assert cli.main([
        "evaluate", "--config", str(path), "--output", str(output), "--jobs", "1"
    ]) == 0
    told = capsys.readouterr()
    notes = (
        "real images are left out: give their folder with --images",
        "radial_cyclic is left out of 1 condition: it needs a field of view",
    )
    assert told.err == "".join(f"star_tracker evaluate: {note}\n" for note in notes)
    assert "view +0 %" in told.out
    assert "view not told" not in told.out
    text = (output / "report.md").read_text(encoding="utf-8")
    assert all(f"- {note}." in text for note in notes)


INTERRUPTED = """
import sys
from star_tracker.commands import cli
from star_tracker.study.store import Store
save = Store.save
def told(*arguments):
    save(*arguments)
    print("saved", flush=True)
Store.save = told
sys.exit(cli.main())
"""


@pytest.mark.slow
def test_an_interrupted_run_says_how_to_go_on(small, tmp_path):
    """Ctrl-C reaches all processes of the group, as in a terminal."""
    arguments = [
        "evaluate", "--config", small.write(tmp_path, {**small.content, "frames": 400}),
        "--output", tmp_path / "out", "--jobs", "2",
    ]
    with popen(
        "-c", INTERRUPTED, *arguments, stdout=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stdout.readline() == "saved\n"
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=longest_s())
    assert process.returncode == 130
    assert told == (
        "star_tracker evaluate: ended; start the same command again to go on from here\n"
    )
    assert {path.suffix for path in (tmp_path / "out" / "chunks").iterdir()} == {".json"}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--jobs", "-1"], "--jobs must be at least 1"),
        (["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers at tcp://127.0.0.1:9"),
        (["--scheduler", "here"], "--scheduler 'here' is no address"),
        (["--scheduler", "tcp://host:port"], "--scheduler 'tcp://host:port' is no address"),
        (["--output", "/dev/null/out"], "/dev/null/out/chunks cannot be made a folder"),
    ],
)
def test_an_option_that_cannot_be_used_is_one_line_and_exit_code_2(
    tmp_path, monkeypatch, capsys, arguments, expected
):
    if "--scheduler" in arguments:
        pytest.importorskip("distributed", reason="needs distributed, an extra")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["evaluate", "--quick", *arguments]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"star_tracker evaluate: {expected}")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("library", "module"), [("joblib", "execution"), ("jinja2", "report")]
)
def test_a_library_that_is_missing_is_named_with_the_remedy(monkeypatch, capsys, library, module):
    from star_tracker import study

    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"star_tracker.study.{module}")
    monkeypatch.delattr(study, module)
    assert cli.main(["evaluate"]) == 2
    assert capsys.readouterr().err == (
        f"star_tracker evaluate: evaluate needs {library}: apt install python3-{library}, or pip "
        "install matplotlib jinja2 joblib PyYAML\n"
    )


def test_a_cluster_without_distributed_is_named_with_the_remedy(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.main(["evaluate", "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert capsys.readouterr().err == (
        "star_tracker evaluate: --scheduler needs distributed: "
        "apt install python3-distributed, or pip install distributed\n"
    )
