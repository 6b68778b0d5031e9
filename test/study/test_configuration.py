"""A study's YAML file: what it holds, and what is refused."""

from pathlib import Path

import pytest

from star_tracker.commands import cli
from star_tracker.maps.simulation import CAMERAS
from star_tracker.resources import resource_path
from star_tracker.study.configuration import read_study
from star_tracker.study.paper_forms import PaperForm
from star_tracker.study.peers import RustStarTracker, Tetra3
from star_tracker.study.plan import absences, places, plan
from star_tracker.study.quantities import NAMED, QUANTITIES

DEFAULT = resource_path("config/evaluation.yaml")
BENCHMARK = Path(__file__).resolve().parents[2] / "benchmark" / "benchmark.yaml"


def test_the_shipped_study_has_the_papers_cameras_and_contestants():
    study = read_study(DEFAULT)
    assert dict(study.cameras) == CAMERAS
    assert [sweep.quantity for sweep in study.sweeps] == [
        key for key in QUANTITIES if key != "lens_k1"
    ]
    assert study.maps == (1, 2, 3, 4, 5, 6, 7, 8)
    assert [one.title for one in study.contestants] == [
        "match_group", "match_group, paper", "radial_cyclic", "radial_cyclic, paper"
    ]


def test_the_benchmark_has_all_named_conditions_and_says_who_cannot_take_part():
    study = read_study(BENCHMARK)
    assert study.combined == tuple(NAMED)
    kinds = [type(one).__name__ for one in study.contestants]
    assert kinds == ["OwnMethod", *["Tetra3"] * 4, "RustStarTracker", "OwnMethod"]
    assert Tetra3(
        "tetra3rs .01 strong", pattern_max_error=0.01, match_threshold=0.001,
        patterns_per_field=500,
    ) in study.contestants
    told = absences(study)
    # At both cameras.
    assert "ruststartracker is left out of 2 conditions: it needs a field of view" in told
    assert not any(line.startswith(("tetra3rs", "star_tracker")) for line in told)
    assert all(
        "ruststartracker" not in {one.title for one in chunk.contestants}
        for chunk in plan(study) if chunk.condition.fov_error_percent
    )


def test_the_quick_study_has_the_first_middle_and_last_values():
    quick = read_study(DEFAULT).quick()
    assert quick.frames < read_study(DEFAULT).frames
    values = {sweep.quantity: sweep.values for sweep in quick.sweeps}
    assert values["principal_point_offset_px"] == (0, 0.5, 2)
    assert values["noise_px"] == (0, 1, 5)


def test_a_condition_that_sweeps_share_is_run_once(small):
    study = read_study(DEFAULT)
    clean = [p for p in places(study) if p.condition.name == "clean" and p.camera == "12 deg"]
    assert len(clean) > 1
    assert sum(
        chunk.place == ("12 deg", "clean") and chunk.block == 0
        for chunk in plan(study) if hasattr(chunk, "block")
    ) == len(study.contestants)
    assert len(plan(small.study)) == 2 * 2 + 5 * 2 * 2 * 2


def test_words_follow_numbers_and_all_settings_are_read(small, tmp_path):
    study = read_study(small.write(tmp_path, {
        **small.content, "interleave": True, "correct_noises": 0, "brightness_noise_mag": 0.1,
        "title": "T", "images": {"fov_error_percent": {"values": ["unknown", 5, 0]}},
        "contestants": [
            {"peer": "tetra3rs", "pattern_max_error": 1, "brightness": False},
            {"peer": "ruststartracker", "every": 3, "name": "rust"},
            {"method": "radial_cyclic", "form": "paper", "name": "f_T"},
        ],
    }))
    assert study.images[0].values == (0, 5, "unknown")
    assert study.contestants == (
        Tetra3(pattern_max_error=1.0, brightness=False), RustStarTracker("rust", 3),
        PaperForm("f_T", method="radial_cyclic"),
    )
    assert [one.title for one in study.contestants] == ["tetra3rs", "rust", "f_T"]
    assert (study.interleave, study.correct_noises, study.title) == (True, 0.0, "T")
    measured = {place.condition.brightness_noise_mag for place in places(study)}
    assert measured == {None, 0.1}  # maps and images have what they have


def swept(quantity, **content):
    return {"sweeps": {quantity: content}}


def contestants(*content):
    return {"contestants": list(content)}


def cameras(**content):
    wide = {"name": "wide", "fov_deg": 20, "width_px": 900, "height_px": 700}
    return {"cameras": ["12 deg", {**wide, **content}]}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"frame": 3}, "the file has an unknown key 'frame': use frames, "),
        ({"seed": ...}, "the file has no key 'seed': add it"),
        ({"frames": 0}, "frames is 0: give a whole number from 1 to 1000000"),
        ({"frames": True}, "frames is True: give a whole number"),
        ({"quick_frames": 1.5}, "quick_frames is 1.5: give a whole number"),
        ({"block_frames": "2"}, "block_frames is '2': give a whole number"),
        ({"seed": -1}, "seed is -1: give a whole number from 0"),
        ({"deadline_ms": 0}, "deadline_ms is 0: give a number greater than 0, .inf for no"),
        ({"deadline_ms": float("nan")}, "deadline_ms is nan: give a number greater than 0"),
        ({"interleave": 1}, "interleave is 1: give true or false"),
        ({"correct_noises": -1}, "correct_noises is -1: give a number from 0"),
        ({"title": 5}, "title is 5: give a word"),
        ({"contestants": []}, "contestants must be a list of one item or more"),
        (contestants({"method": "vote"}),
         "contestants: method 'vote' is unknown: use auto, match_group, radial_cyclic"),
        (contestants({"method": "auto", "form": "paper"}),
         "contestants: method auto has no form paper: use form own"),
        (contestants({"method": "auto", "form": "new"}),
         "contestants: form 'new' is unknown: use own or paper"),
        (contestants({"form": "own"}), "contestants: a contestant has no key 'method': add it"),
        (contestants({"peer": "lost"}),
         "contestants: peer 'lost' is unknown: use tetra3rs or ruststartracker"),
        (contestants({"peer": "tetra3rs", "method": "auto"}), "has an unknown key 'method': use"),
        (contestants({"peer": "tetra3rs", "every": 0}), "every is 0: give a whole number from 1"),
        (contestants({"method": "auto", "name": "x"}, {"method": "match_group", "name": "x"}),
         "contestants gives the name 'x' twice: choose another"),
        (contestants("auto"), "contestants: a contestant must hold keys with values"),
        ({"cameras": ["13 deg"]}, "cameras: there is no camera '13 deg': use 12 deg, 20 deg"),
        ({"cameras": ["12 deg", "12 deg"]}, "cameras lists '12 deg' twice: leave one"),
        (cameras(name="12 deg"), "cameras gives the name '12 deg' twice: choose another"),
        (cameras(fov_deg=300), "cameras: fov_deg 300 is outside of 0.5 to 120"),
        (cameras(fov_deg="x"), "cameras: fov_deg is 'x'"),
        (cameras(width_px=3), "cameras: width_px is 3"),
        ({"maps": [9]}, "maps: a map is 9: give a whole number from 1 to 8"),
        ({"maps": 3}, "maps must be a list"),
        ({"combined": ["worse"]}, "combined: there is no condition 'worse': use clean, 0.5 px, "),
        ({"sweeps": {"noise": {}}}, "sweeps has an unknown key 'noise': use noise_px, "),
        ({"images": {"noise_px": {}}},
         "images has an unknown key 'noise_px': use fov_error_percent"),
        (swept("noise_px"), "sweep noise_px has no key 'values': add it"),
        (swept("noise_px", values=[]), "sweep noise_px must be a list of one item or more"),
        (swept("noise_px", values=[1, 1.0]), "sweep noise_px lists 1.0 twice: leave one"),
        (swept("noise_px", values=[1, 1.0000001]), "sweep noise_px lists 1.0000001 twice"),
        (swept("noise_px", values=[-1]),
         "sweep noise_px: noise_px is -1: give numbers from 0 to 100"),
        (swept("noise_px", values=[True]), "sweep noise_px: noise_px is True: give numbers"),
        (swept("missing_fraction", values=[1.2]), "missing_fraction is 1.2: give numbers from 0"),
        (swept("fov_error_percent", values=["no"]),
         "fov_error_percent is 'no': give numbers from -50 to 50 or unknown"),
        (swept("mirrored_sky_parity", values=["up"]),
         "mirrored_sky_parity is 'up': give normal or mirrored or auto"),
        (swept("mirrored_sky_parity", values=[0]), "mirrored_sky_parity is 0: give normal or"),
        (swept("noise_px", values=[0], steps=3),
         "sweep noise_px has an unknown key 'steps': use values, with"),
        (swept("noise_px", values=[0], **{"with": {"noise_px": 1}}),
         "with of sweep noise_px has an unknown key 'noise_px': use missing_fraction, "),
        (swept("noise_px", values=[0], **{"with": {"false_stars": -1}}),
         "false_stars is -1: give numbers from 0 to 20"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_a_wrong_configuration_is_one_line(small, tmp_path, changes, expected):
    content = {k: v for k, v in {**small.content, **changes}.items() if v is not ...}
    path = small.write(tmp_path, content)
    with pytest.raises(ValueError) as caught:  # noqa: PT011  looked at below
        read_study(path)
    told = str(caught.value)
    assert told.startswith(f"{path}: ")
    assert expected in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[]", ": the file must hold keys with values: frames, "),
        (b"frames: [", " is no YAML, mend this place: while parsing"),
        (b"\xff\xfe\xfd", " cannot be read: "),
        (None, " cannot be read: "),
    ],
)
def test_a_file_that_is_no_study_is_one_line_and_exit_code_2(tmp_path, capsys, content, expected):
    path = tmp_path / "study.yaml"
    if content is not None:
        path.write_bytes(content)
    output = tmp_path / "out"
    assert cli.main(["evaluate", "--config", str(path), "--output", str(output)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"star_tracker evaluate: {path}{expected}")
    assert told.count("\n") == 1
    assert not output.exists()
