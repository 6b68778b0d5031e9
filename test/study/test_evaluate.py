"""`star_tracker evaluate`: the robustness study, on few frames."""

import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from processes import completed, popen
from waiting import longest_s

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.commands import cli, evaluate
from star_tracker.maps.simulation import CAMERAS, Condition, frames
from star_tracker.resources import resource_path
from star_tracker.study import execution
from star_tracker.study.chunks import (
    IDENTIFIED,
    WRONG,
    FramesChunk,
    MapChunk,
    conditions,
    database,
    key,
    plan,
    run,
    version,
)
from star_tracker.study.configuration import read_study
from star_tracker.study.contestants import Contestant
from star_tracker.study.figures import write_overview
from star_tracker.study.page import balances, write_page
from star_tracker.study.records import MAP, read_csv, summarise, wilson, write_csv
from star_tracker.study.scoring import Score
from star_tracker.study.store import Store
from star_tracker.study.troubles import QUANTITIES, Trouble

DEFAULT = resource_path("config/evaluation.yaml")
SMALL = {
    "frames": 3, "quick_frames": 1, "block_frames": 2, "seed": 7, "deadline_ms": float("inf"),
    "contestants": [{"method": "match_group"}, {"method": "match_group", "form": "paper"}],
    "cameras": ["12 deg", {"name": "wide", "fov_deg": 20, "width_px": 900, "height_px": 700}],
    "maps": [1, 3], "combined": ["comb"],
    "sweeps": {
        "noise_px": {"values": [0, 1]},
        "mirrored_sky_parity": {"values": ["normal", "auto"], "with": {"noise_px": 0.5}},
    },
}
OWN = Contestant("match_group")


def written(folder, content):
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def without_times(results):
    return {chunk: replace(result, cpu_ms=[]) for chunk, result in results.items()}


def run_here(chunks, folder, ran=None):
    """Run chunks in this process; those that the folder lacks are added to `ran`."""
    local = execution.local(1)

    def execute(missing):
        (ran if ran is not None else []).extend(missing)
        return local(missing)

    return execution.run_all(chunks, Store(folder), execute, lambda n: None)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return read_study(written(tmp_path_factory.mktemp("study"), SMALL))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("chunks")


@pytest.fixture(scope="module")
def results(study, folder):
    return run_here(plan(study), folder)


@pytest.fixture(scope="module")
def records(study, results):
    return summarise(study, results)


# ---- the same results however they are run ---------------------------------------------------


def test_two_processes_give_what_one_gives(study, results, tmp_path):
    two = execution.run_all(plan(study), Store(tmp_path), execution.local(2), lambda n: None)
    assert without_times(two) == without_times(results)


def test_a_chunk_alone_gives_what_it_gives_among_others(results):
    chunk, expected = list(results.items())[-1]
    assert without_times({chunk: chunk.solve()}) == without_times({chunk: expected})


def test_contestants_see_the_same_frames_and_blocks_others(study):
    chunks = [chunk for chunk in plan(study) if isinstance(chunk, FramesChunk)]
    states = {
        chunk: tuple(chunk.seed_sequence().generate_state(4).tolist()) for chunk in chunks
    }
    for chunk, state in states.items():
        same = {other for other in chunks if states[other] == state}
        assert same == {replace(chunk, contestant=one) for one in study.contestants}
        assert replace(chunk, seed=8).seed_sequence().generate_state(4).tolist() != list(state)


def test_a_dask_cluster_gives_what_this_process_gives(study, results, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        scheduler_port=0,
    ) as cluster:
        execute = execution.on_cluster(cluster.scheduler_address)
        found = execution.run_all(plan(study), Store(tmp_path), execute, lambda n: None)
    assert without_times(found) == without_times(results)
    assert len(list(tmp_path.iterdir())) == len(results)


def test_a_worker_with_other_sources_is_refused(results):
    with pytest.raises(ValueError, match="install the same one everywhere"):
        run(next(iter(results)), "other sources")


# ---- stored results --------------------------------------------------------------------------


def damage(path, how):
    text = path.read_text(encoding="utf-8")
    content = json.loads(text)
    if how == "deleted":
        path.unlink()
    elif how == "truncated":
        path.write_text(text[: len(text) // 2], encoding="utf-8")
    elif how == "empty":
        path.write_text("", encoding="utf-8")
    elif how == "short":
        content["result"]["cpu_ms"].pop()
        path.write_text(json.dumps(content), encoding="utf-8")
    else:
        content["chunk"]["seed"] = 99
        path.write_text(json.dumps(content), encoding="utf-8")


def test_only_what_is_missing_or_damaged_is_run_again(study, results, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    chunks = plan(study)
    broken = dict(zip(
        chunks[-5:], ("deleted", "truncated", "empty", "short", "another"), strict=True
    ))
    for chunk, how in broken.items():
        damage(tmp_path / f"{key(chunk)}.json", how)
    ran = []
    found = run_here(chunks, tmp_path, ran)
    assert ran == list(broken)
    assert without_times(found) == without_times(results)
    ran.clear()
    assert run_here(chunks, tmp_path, ran) == found
    assert ran == []


def test_damaged_files_are_told(study, results, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    chunk = plan(study)[-1]
    damage(tmp_path / f"{key(chunk)}.json", "truncated")
    store = Store(tmp_path)
    assert store.load(chunk) is None
    assert store.damaged == [f"{key(chunk)}.json"]


def test_files_are_written_whole(folder, results):
    assert {path.suffix for path in folder.iterdir()} == {".json"}
    assert len(list(folder.iterdir())) == len(results)


def test_the_key_tells_all_that_a_result_depends_on(study, monkeypatch):
    chunk = plan(study)[-1]
    keys = {
        key(one) for one in (
            chunk, replace(chunk, seed=8), replace(chunk, n=9), replace(chunk, block=5),
            replace(chunk, deadline_ms=5.0), replace(chunk, camera=CAMERAS["20 deg"]),
            replace(chunk, contestant=Contestant("auto")),
            replace(chunk, condition=Trouble.of({"noise_px": 3.0})),
        )
    }
    monkeypatch.setattr("star_tracker.study.chunks.version", lambda: "9.9.9")
    assert len(keys | {key(chunk)}) == 9


def test_the_version_is_that_of_the_package():
    assert f"<version>{version()}</version>" in resource_path("package.xml").read_text()


@pytest.mark.parametrize("place", ["file", "file/folder"])
def test_a_folder_that_cannot_be_made_is_told(tmp_path, place):
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="choose another --output"):
        Store(tmp_path / place)


# ---- the configuration -----------------------------------------------------------------------


def test_the_shipped_study_has_the_papers_cameras_and_all_quantities():
    study = read_study(DEFAULT)
    assert dict(study.cameras) == CAMERAS
    assert [sweep.quantity for sweep in study.sweeps] == list(QUANTITIES)
    assert study.maps == (1, 2, 3, 4, 5, 6, 7, 8)
    assert [one.name for one in study.contestants] == [
        "match_group", "match_group, paper", "radial_cyclic", "radial_cyclic, paper"
    ]


def test_the_quick_study_has_the_first_middle_and_last_values():
    quick = read_study(DEFAULT).quick()
    assert quick.frames < read_study(DEFAULT).frames
    values = {sweep.quantity: sweep.values for sweep in quick.sweeps}
    assert values["principal_point_offset_px"] == (0, 0.5, 2)
    assert values["noise_px"] == (0, 1, 5)


def test_a_condition_that_sweeps_share_is_run_once(study):
    names = [condition.name for condition in conditions(read_study(DEFAULT))]
    assert names.count("clean") == names.count("0.5 px") == 1
    assert len(plan(study)) == 2 * 2 + 5 * 2 * 2 * 2


def changed(**changes):
    return {**SMALL, **changes}


def swept(quantity, **content):
    return changed(sweeps={quantity: content})


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ([], "the file must hold keys with values: frames, "),
        ({**SMALL, "frame": 3}, "the file has an unknown key 'frame': use frames, "),
        ({k: v for k, v in SMALL.items() if k != "seed"}, "the file has no key 'seed': add it"),
        (changed(frames=0), "frames is 0: give a whole number from 1 to 1000000"),
        (changed(frames=True), "frames is True: give a whole number"),
        (changed(quick_frames=1.5), "quick_frames is 1.5: give a whole number"),
        (changed(block_frames="2"), "block_frames is '2': give a whole number"),
        (changed(seed=-1), "seed is -1: give a whole number from 0"),
        (changed(deadline_ms=0), "deadline_ms is 0: give a number greater than 0, .inf for no"),
        (changed(deadline_ms=float("nan")), "deadline_ms is nan: give a number greater than 0"),
        (changed(contestants=[]), "contestants must be a list of one item or more"),
        (changed(contestants=[{"method": "vote"}]),
         "contestants: method 'vote' is unknown: use auto, match_group, radial_cyclic"),
        (changed(contestants=[{"method": "auto", "form": "paper"}]),
         "contestants: method auto has no form paper: use form own"),
        (changed(contestants=[{"method": "auto", "form": "new"}]),
         "contestants: form 'new' is unknown: use own or paper"),
        (changed(contestants=["auto"]), "contestants: a contestant must hold keys with values"),
        (changed(cameras=["13 deg"]), "cameras: there is no camera '13 deg': use 12 deg, 20 deg"),
        (changed(cameras=["12 deg", "12 deg"]), "cameras lists '12 deg' twice: leave one"),
        (changed(cameras=["12 deg", {**SMALL["cameras"][1], "name": "12 deg"}]),
         "cameras gives the name '12 deg' twice: choose another"),
        (changed(cameras=[{**SMALL["cameras"][1], "fov_deg": 300}]),
         "cameras: fov_deg 300 is outside of 0.5 to 120"),
        (changed(cameras=[{**SMALL["cameras"][1], "fov_deg": "x"}]), "cameras: fov_deg is 'x'"),
        (changed(cameras=[{**SMALL["cameras"][1], "width_px": 3}]), "cameras: width_px is 3"),
        (changed(maps=[9]), "maps: a map is 9: give a whole number from 1 to 8"),
        (changed(maps=3), "maps must be a list"),
        (changed(combined=["worse"]), "combined: there is no condition 'worse': use m40, m60, "),
        (changed(sweeps={"noise": {}}), "sweeps has an unknown key 'noise': use noise_px, "),
        (swept("noise_px"), "sweep noise_px has no key 'values': add it"),
        (swept("noise_px", values=[]), "sweep noise_px must be a list of one item or more"),
        (swept("noise_px", values=[1, 1.0]), "sweep noise_px lists 1.0 twice: leave one"),
        (swept("noise_px", values=[1, 1.0000001]), "sweep noise_px lists 1.0000001 twice"),
        (swept("noise_px", values=[-1]), "sweep noise_px: noise_px is -1: give numbers from 0"),
        (swept("noise_px", values=[True]), "sweep noise_px: noise_px is True: give numbers"),
        (swept("missing_fraction", values=[1.2]), "missing_fraction is 1.2: give numbers from 0"),
        (swept("mirrored_sky_parity", values=["up"]),
         "mirrored_sky_parity is 'up': use normal, mirrored, auto"),
        (swept("noise_px", values=[0], steps=3),
         "sweep noise_px has an unknown key 'steps': use values, with"),
        (swept("noise_px", values=[0], **{"with": {"noise_px": 1}}),
         "with of sweep noise_px has an unknown key 'noise_px': use missing_fraction, "),
        (swept("noise_px", values=[0], **{"with": {"false_stars": -1}}),
         "false_stars is -1: give numbers from 0 to 20"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_a_wrong_configuration_is_one_line_and_exit_code_2(tmp_path, capsys, content, expected):
    path = written(tmp_path, content)
    assert cli.main(["evaluate", "--config", str(path), "--output", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"star_tracker evaluate: {path}: ")
    assert expected in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"frames: [", "is no YAML, mend this place: while parsing"),
        (b"\xff\xfe\xfd", "cannot be read: "),
        (None, "cannot be read: "),
    ],
)
def test_a_file_that_is_no_yaml_is_one_line_and_exit_code_2(tmp_path, capsys, content, expected):
    path = tmp_path / "study.yaml"
    if content is not None:
        path.write_bytes(content)
    assert cli.main(["evaluate", "--config", str(path)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"star_tracker evaluate: {path} {expected}")
    assert told.count("\n") == 1


# ---- what is measured ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("contestant", "lost"),
    [
        (Contestant("match_group"), []),
        # The paper says maps 3 and 6; map 5, which it reports as solved, fails too.
        (Contestant("match_group", "paper"), [3, 5, 6]),
        (Contestant("radial_cyclic"), []),
        # The paper says maps 4, 5 and 8. Map 8 is solved here, and map 6 is not.
        (Contestant("radial_cyclic", "paper"), [4, 5, 6]),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_maps_lost_by_each_contestant(contestant, lost):
    outcomes = {
        number: MapChunk(contestant, number, float("inf")).solve().outcomes
        for number in range(1, 9)
    }
    assert [number for number, stars in outcomes.items() if IDENTIFIED not in stars] == lost
    assert not any(WRONG in stars for stars in outcomes.values())
    if not lost:
        assert sum(stars.count(IDENTIFIED) for stars in outcomes.values()) == 141


def solved(n=12, contestant=OWN, **values):
    return FramesChunk(
        contestant, "12 deg", CAMERAS["12 deg"], Trouble.of(values), 0, n, 3, float("inf")
    ).solve()


def test_half_a_pixel_is_right_and_its_angle_an_error():
    """The sky does not move in the detector's frame, but the tracker looks from another point."""
    found = solved(principal_point_offset_px=0.5)
    assert found.outcomes == [IDENTIFIED] * 12
    angle_deg = np.degrees(np.arctan(np.hypot(0.5, 0.5) / CAMERAS["12 deg"].fx_px))
    np.testing.assert_allclose(found.error_deg, angle_deg, rtol=0.02)
    assert angle_deg == pytest.approx(0.0166, rel=0.01)


def test_an_offset_beyond_the_tolerance_is_wrong():
    found = solved(principal_point_offset_px=5)
    assert set(found.outcomes) <= {WRONG, "AMBIGUOUS", "NO_MATCH"}
    assert found.outcomes.count(WRONG) > 6


@pytest.mark.parametrize(
    ("parity", "right"), [("normal", 0), ("auto", 12), ("mirrored", 12)]
)
def test_a_mirrored_sky_is_solved_where_the_parity_is_known_or_asked_for(parity, right):
    found = solved(mirrored_sky_parity=parity, noise_px=0.5)
    assert found.outcomes.count(IDENTIFIED) == right
    assert WRONG not in found.outcomes


def test_a_wrong_field_of_view_is_told_and_the_true_one_seen():
    camera = CAMERAS["12 deg"]
    trouble = Trouble.of({"fov_error_percent": 2.0})
    assert trouble.told_camera(camera).fov_deg == pytest.approx(12.24)
    assert trouble.true_camera(camera) == camera
    assert solved(fov_error_percent=1).outcomes == [IDENTIFIED] * 12


def test_brightness_is_told_with_the_noise_asked_for():
    catalog = StarCatalog.paper()

    def magnitudes(**values):
        seed = np.random.SeedSequence(5)
        for frame, intensity in Trouble.of(values).frames(catalog, CAMERAS["20 deg"], 40, seed):
            if intensity is not None:
                true = frame.catalog_index >= 0
                yield from (
                    -2.5 * np.log10(intensity[true]) - catalog.v_mag[frame.catalog_index[true]]
                )

    assert list(magnitudes(noise_px=1)) == []
    np.testing.assert_allclose(list(magnitudes(brightness_noise_mag=0)), 0, atol=1e-9)
    assert np.std(list(magnitudes(brightness_noise_mag=0.5, false_stars=1))) == (
        pytest.approx(0.5, rel=0.05)
    )


def test_features_have_the_sizes_of_the_database():
    pairs, patterns = database().pairs, 4908 * 31
    # Both directions of each pair in two tables, of 8 and of 9 bytes, and where their parts begin.
    votes = 2 * 149_423 * (8 + 9) + pairs.bin_start.nbytes + 8 * 4909
    sizes = [
        Contestant(method).storage_bytes(database())
        for method in ("match_group", "radial_cyclic", "auto")
    ]
    assert sizes == [votes, patterns, votes + patterns]


def test_equal_seeds_give_equal_frames():
    condition = Condition("any", 1.0, 0.2, 0.5)
    one, two = (
        [f.xy_px for f in frames(StarCatalog.paper(), CAMERAS["12 deg"], condition, 3, 5)]
        for _ in range(2)
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_percentages_and_times_of_a_score():
    score = Score(8, 4, 2, np.array([1.0, 2.0, 9.0]))
    assert (score.correct_percent, score.wrong_percent, score.median_ms) == (50.0, 25.0, 2.0)
    assert 2.0 < score.p95_ms <= 9.0


# ---- records ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    # From the closed form; 0 of n ends at z^2 / (n + z^2).
    [(0, 10, 0.0, 0.27753), (5, 10, 0.23659, 0.76341), (10, 10, 0.72247, 1.0),
     (1, 100, 0.00177, 0.05449)],
)
def test_wilson_interval(k, n, low, high):
    assert wilson(k, n) == pytest.approx((low, high), abs=1e-5)


def test_every_contestant_meets_every_condition_on_every_camera(study, records):
    met = {(r.camera, r.condition, r.contestant) for r in records}
    cells = [("maps", "map 1"), ("maps", "map 3")] + [
        (name, c.name) for name, _ in study.cameras for c in conditions(study)
    ]
    assert met == {(*cell, one) for cell in cells for one in study.contestants}
    assert len(records) == len(met)


def test_the_rates_of_a_record_are_those_of_its_chunks(results, records):
    for record in records:
        name = record.contestant.name
        cell = name, record.camera, record.condition
        outcomes = [o for c, result in results.items() if c.cell == cell for o in result.outcomes]
        assert record.n == len(outcomes) == (record.n if record.sweep == MAP else 3)
        assert record.identified_percent == pytest.approx(
            100 * outcomes.count(IDENTIFIED) / record.n
        )
        total = record.identified_percent + record.wrong_percent + record.unanswered_percent
        assert total == pytest.approx(100)
        assert record.identified_low_percent <= record.identified_percent
        assert record.identified_percent <= record.identified_high_percent
        assert 0 < record.median_cpu_ms <= record.p95_cpu_ms


def test_records_survive_the_csv(records, tmp_path):
    path = tmp_path / "results.csv"
    write_csv(records, path)
    assert read_csv(path) == records
    assert any(record.tolerance_deg is None for record in records)
    head = path.read_text(encoding="utf-8").splitlines()[0]
    assert head.startswith("method,form,camera,sweep,value,condition,n,identified_percent,")


@pytest.mark.parametrize("name", ["results.csv", "report.html"])
def test_a_file_that_cannot_be_written_is_told(study, records, tmp_path, name):
    path = tmp_path / name
    path.mkdir()
    with pytest.raises(ValueError, match=f"{name} cannot be written: Is a directory"):
        write_csv(records, path) if name.endswith("csv") else write_page(study, records, path)


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "method,form\nx,\n"])
def test_a_csv_of_something_else_is_refused(tmp_path, text):
    path = tmp_path / "other.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="is no table of results"):
        read_csv(path)


def test_the_balance_counts_maps_and_frames_once(study, records):
    own, paper = balances(study, records)
    assert (own.maps_right, own.maps_lost) == ("2 of 2", "none")
    assert (paper.maps_right, paper.maps_lost) == ("1 of 2", "3")
    assert own.n_frames == 3 * len(conditions(study)) * len(study.cameras)


def test_the_tables_go_into_80_columns(study, records):
    from rich.console import Console

    console = Console(width=200, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    with console.file:
        for table in evaluate._tables(study, records):
            console.print(table)
    lines = console.export_text().splitlines()
    assert max(len(line.rstrip()) for line in lines if "wrong but" not in line) <= 80
    assert sum(line.startswith("map ") for line in lines) == 2


def test_the_overview_is_a_small_picture(records, tmp_path):
    write_overview(records, tmp_path / "curves.png")
    content = (tmp_path / "curves.png").read_bytes()
    assert content.startswith(b"\x89PNG")
    assert len(content) < 200_000


# ---- the command -----------------------------------------------------------------------------


def test_json_of_the_command_in_a_process_without_ros(tmp_path, records):
    """Nothing but JSON on standard output, no progress bar where there is no terminal."""
    script = (
        "import sys; sys.modules['rclpy'] = None; "
        "from star_tracker.commands import cli; cli.main()"
    )
    arguments = [
        "evaluate", "--config", written(tmp_path, SMALL), "--output", tmp_path / "out",
        "--jobs", "1", "--json",
    ]
    done = completed("-c", script, *arguments)
    assert (done.stderr, done.returncode) == ("", 0)
    found = json.loads(done.stdout)
    timed = {"median_cpu_ms", "p95_cpu_ms"}
    assert [{k: v for k, v in r.items() if k not in timed} for r in found] == [
        {k: v for k, v in vars(r).items() if k not in timed} for r in records
    ]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "chunks", "report.html", "results.csv"
    }


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


def test_an_interrupted_run_says_how_to_go_on(tmp_path):
    """Ctrl-C reaches all processes of the group, as in a terminal."""
    arguments = [
        "evaluate", "--config", written(tmp_path, changed(frames=400)), "--output",
        tmp_path / "out", "--jobs", "2",
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
    monkeypatch.chdir(tmp_path)
    assert cli.main(["evaluate", "--quick", *arguments]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"star_tracker evaluate: {expected}")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("library", "module"), [("joblib", "execution"), ("yaml", "configuration")]
)
def test_a_library_that_is_missing_is_named_with_its_extra(monkeypatch, capsys, library, module):
    from star_tracker import study

    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"star_tracker.study.{module}")
    monkeypatch.delattr(study, module)
    assert cli.main(["evaluate"]) == 2
    assert capsys.readouterr().err == (
        f"star_tracker evaluate: evaluate needs {library}: pip install 'star_tracker[report]'\n"
    )


def test_a_cluster_without_distributed_is_named_with_its_extra(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.main(["evaluate", "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert capsys.readouterr().err == (
        "star_tracker evaluate: --scheduler needs distributed: "
        "pip install 'star_tracker[dask]'\n"
    )


# ---- the page in a browser -------------------------------------------------------------------


def chromium(playwright):
    """Return the path of a Chromium, or skip."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    found = next((path for path in map(shutil.which, names) if path), None)
    own = Path(playwright.chromium.executable_path)
    if found is None and not own.exists():
        pytest.skip("no Chromium: requirements/browser.sh installs one")
    return found or str(own)


@pytest.fixture(scope="module")
def page_path(study, records, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(study, records, path)
    return path


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=chromium(playwright),
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        yield started
        started.close()


@pytest.mark.parametrize("width_px", [1280, 400])
def test_the_page_in_a_browser(page_path, browser, study, width_px):
    page = browser.new_page(viewport={"width": width_px, "height": 900})
    trouble = []
    page.on("console", lambda message: trouble.append(message.text))
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("requestfailed", lambda request: trouble.append(request.url))
    page.goto(page_path.as_uri())
    assert trouble == []
    pictures = page.eval_on_selector_all(
        "figure img", "all => all.map(i => [i.naturalWidth, i.clientWidth, i.clientHeight, i.alt])"
    )
    assert len(pictures) == len(study.sweeps) * len(study.cameras)
    for natural, width, height, words in pictures:
        assert min(natural, width, height) > 200
        assert "match_group, paper identifies (%)" in words
    # Also where all tables are open, only they scroll.
    page.eval_on_selector_all("details", "all => all.forEach(d => { d.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width_px
    assert page.locator("table").count() == 1 + len(study.sweeps) + 2
    page.close()


def test_the_page_needs_nothing_else(page_path):
    text = page_path.read_text(encoding="utf-8")
    assert "<script" not in text
    assert "http" not in text.replace("http-equiv", "")


def test_the_page_escapes_what_the_user_wrote(study, records, tmp_path):
    name = "<b>wide</b>"
    renamed = [replace(r, camera=name) if r.camera == "wide" else r for r in records]
    path = tmp_path / "report.html"
    write_page(study, renamed, path)
    text = path.read_text(encoding="utf-8")
    assert "&lt;b&gt;wide&lt;/b&gt;" in text
    assert name not in text
