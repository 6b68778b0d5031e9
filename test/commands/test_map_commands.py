"""`star_tracker boresight`, `calibrate` and `geometry`: values, tables, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processes import completed

from star_tracker.commands import cli, matched_map
from star_tracker.maps.star_map import paper_maps, write_star_map

ROOT = Path(__file__).resolve().parents[2]


def run(capsys, *arguments):
    """Return what a command prints."""
    assert cli.main(arguments) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def record_of(capsys, *arguments):
    return json.loads(run(capsys, *arguments, "--json"))


def refusal(capsys, *arguments):
    """Return the one line of a command that cannot do what it is asked."""
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err.rstrip("\n")


def map_file(tmp_path, **changes):
    """Write map 1, changed, and return the file's name."""
    path = tmp_path / "frame.csv"
    write_star_map(replace(paper_maps((1,))[0], **changes), path)
    return str(path)


def unnumbered(tmp_path):
    return map_file(tmp_path, star_number=np.zeros(15, np.int64), pose=None, name="frame")


# boresight


def test_boresight_of_the_first_three_stars(capsys):
    record = record_of(capsys, "boresight", "1", "--stars", "A01,A02,A03")
    linear, spherical, unknown = record["boresight"]
    assert record["stars"] == ["A01", "A02", "A03"]
    for answer in (linear, spherical, unknown):
        assert answer["ra_deg"] == pytest.approx(109.6, abs=2 / 3600 / 0.82)
        assert answer["dec_deg"] == pytest.approx(34.5, abs=2 / 3600)
        assert answer["error_arcsec"] < 2
    assert linear["ra_deg"] == pytest.approx(spherical["ra_deg"], abs=1e-9)
    assert linear["standard_error_focal_length_px"] is None
    assert unknown["focal_length_px"] == pytest.approx(2435.677, rel=1e-4)
    assert unknown["norm_of_m"] == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("f", ["2313.9", "2557.5"])
def test_the_focal_length_is_found_from_five_percent_off(capsys, f):
    arguments = ("boresight", "1", "--stars", "A01,A02,A03", "--focal-length-px", f)
    linear, _, unknown = record_of(capsys, *arguments)["boresight"]
    assert unknown["error_arcsec"] < 2
    assert unknown["focal_length_px"] == pytest.approx(2435.677, rel=1e-4)
    assert linear["focal_length_px"] == float(f)
    assert linear["error_arcsec"] > 1000


def test_without_labels_the_best_triple_is_taken(capsys):
    best = record_of(capsys, "geometry", "1", "--top", "1")["best"][0]["stars"]
    assert record_of(capsys, "boresight", "1")["stars"] == best


def test_standard_errors_grow_with_the_noise(capsys):
    one, two = (
        record_of(capsys, "boresight", "1", "--sigma-px", sigma)["boresight"][0]
        for sigma in ("0.1", "0.3")
    )
    for key in ("standard_error_east_arcsec", "standard_error_north_arcsec"):
        assert two[key] == pytest.approx(3 * one[key])


def test_a_refused_focal_length_is_said_and_the_rest_given(capsys):
    # The circle through these passes near the boresight.
    arguments = ("boresight", "1", "--stars", "A01,A03,A10")
    answers = record_of(capsys, *arguments)["boresight"]
    assert answers[0]["error_arcsec"] < 20
    assert set(answers[2]) == {"method", "refused"}
    text = " ".join(run(capsys, *arguments).split())
    assert "refused: no focal length or two within 10%" in text


def test_the_table_of_boresight_names_units_and_standard_errors(capsys):
    text = run(capsys, "boresight", "1", "--stars", "A01,A02,A03")
    for part in ("109.600", "+/- east", "arcsec", "deg", "px", "focal length", "|m|", "K = "):
        assert part in text
    assert max(map(len, text.splitlines())) <= 80


# calibrate


def test_calibrate_gives_the_focal_length_with_its_error(capsys):
    record = record_of(capsys, "calibrate", "7", "--focal-length-px", "2990")
    rows = {row["parameter"]: row for row in record["parameters"]}
    assert (record["stars"], record["terms"], record["terms_given"]) == (41, [], False)
    assert set(rows) == {"focal_length_px", "fov_deg", "ra_deg", "dec_deg", "roll_deg"}
    truth = {
        "focal_length_px": 2903.69629, "fov_deg": 20, "ra_deg": 112.6, "dec_deg": 34.5,
        "roll_deg": 90,
    }
    for name, row in rows.items():
        assert abs(row["fitted"] - truth[name]) < 4 * row["standard_error"]
    assert rows["focal_length_px"]["given"] == 2990
    # The standard error of the field of view is that of the focal length, in other units.
    ratio = rows["fov_deg"]["standard_error"] / rows["focal_length_px"]["standard_error"]
    fov_deg = [2 * np.degrees(np.arctan(512 / f)) for f in (2903.2, 2904.2)]
    assert ratio == pytest.approx(fov_deg[0] - fov_deg[1], rel=1e-3)
    assert record["sigma_px"] == pytest.approx(0.01 / 12**0.5, rel=0.3)


def test_calibrate_fits_the_terms_that_are_asked_for(capsys):
    record = record_of(capsys, "calibrate", "7", "--terms", "k1,principal_point")
    assert record["terms"] == ["principal_point", "k1"]
    assert record["terms_given"] is True
    assert record_of(capsys, "calibrate", "7", "--terms", "none")["terms"] == []


def test_the_table_of_calibrate_says_what_the_data_support(capsys):
    text = " ".join(run(capsys, "calibrate", "1").split())
    assert "supported by the data: none; not fitted: principal_point, k1, k2" in text
    assert "26 degrees of freedom" in text
    for part in ("focal length", "2435.68", "+/-", "px", "deg"):
        assert part in text


# geometry


def test_geometry_ranks_the_triples(capsys):
    record = record_of(capsys, "geometry", "1", "--top", "3")
    assert (record["triples"], record["by"], len(record["best"])) == (455, "error", 3)
    errors = [row["boresight_error_arcsec"] for row in record["best"]]
    assert errors == sorted(errors)
    exact, published, bound = record["all_stars"]
    assert bound["boresight_error_arcsec"] <= exact["boresight_error_arcsec"] < errors[0]
    assert published["roll_error_arcsec"] == pytest.approx(exact["roll_error_arcsec"], rel=0.02)


@pytest.mark.parametrize(("by", "key", "sign"), [("k", "k", 1), ("volume", "volume", -1)])
def test_geometry_ranks_by_other_figures(capsys, by, key, sign):
    best = record_of(capsys, "geometry", "4", "--by", by)["best"]
    values = [sign * row[key] for row in best]
    assert len(best) == 5
    assert values == sorted(values)


def test_the_tables_of_geometry(capsys):
    text = run(capsys, "geometry", "1")
    for part in ("A05, A08, A12", "volume", "arcsec", "Cramer-Rao bound"):
        assert part in text
    assert "6 triples are refused: K > 1000" in " ".join(text.split())


# The map


def test_a_file_with_star_numbers_is_used_as_it_is(capsys, tmp_path):
    shipped = record_of(capsys, "calibrate", "1")
    own = record_of(capsys, "calibrate", map_file(tmp_path))
    assert own["source"] == "star numbers of the map"
    assert own["parameters"] == shipped["parameters"]


def test_a_file_without_star_numbers_is_identified(capsys, tmp_path):
    record = record_of(capsys, "boresight", unnumbered(tmp_path))
    assert record["source"] == "identified: match_group"
    assert record["boresight"][0]["ra_deg"] == pytest.approx(109.6, abs=0.001)
    assert record["boresight"][0]["error_arcsec"] is None


def test_displaced_stars_are_left_out():
    assert matched_map.load("3").labels == ("C01", "C03", "C05", "C07")


def test_a_map_that_cannot_be_identified_is_refused(capsys, tmp_path):
    path = map_file(
        tmp_path, star_number=np.zeros(15, np.int64), name="frame",
        xy_px=np.random.default_rng(1).random((15, 2)) * 512,
    )
    text = refusal(capsys, "geometry", path)
    assert text.startswith("star_tracker geometry: frame has no star numbers and was not ident")


def test_an_unknown_star_number_is_refused(capsys, tmp_path):
    number = paper_maps((1,))[0].star_number.copy()
    number[3] = 4909
    text = refusal(capsys, "calibrate", map_file(tmp_path, star_number=number))
    assert text == "star_tracker calibrate: star number 4909 is not in the catalogue of the paper"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("boresight", "9"), "there is no map 9: the maps are numbered 1 to 8"),
        (("boresight", "1", "--stars", "A01,A02"), "--stars takes three labels, for instance"),
        (("boresight", "1", "--stars", "A01,A02,Z9"), "map 1 has no matched star 'Z9'"),
        (("boresight", "1", "--stars", "A01,A02,A01"), "stars 1 and 3 have the same direction"),
        (("boresight", "1", "--stars", "A04,A06,A07"), "the three stars lie nearly on one great"),
        (("boresight", "1", "--sigma-px", "0"), "--sigma-px must be a number greater than 0"),
        (("boresight", "1", "--focal-length-px", "nan"), "--focal-length-px must be a number"),
        (("calibrate", "1", "--focal-length-px", "-5"), "--focal-length-px must be a number"),
        (("calibrate", "1", "--terms", "k9"), "term 'k9' is unknown: use principal_point, k1"),
        (("calibrate", "3", "--terms", "principal_point,k1,k2"), "4 stars do not determine 8"),
        (("geometry", "1", "--top", "0"), "--top must be a number greater than 0"),
        (("geometry", "no/such/file.csv"), "star map no/such/file.csv cannot be read"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_exit_code_2(capsys, arguments, text):
    assert refusal(capsys, *arguments).startswith(f"star_tracker {arguments[0]}: {text}")


@pytest.mark.parametrize("command", ["boresight", "geometry"])
def test_help_says_what_the_map_is_and_names_the_defaults(capsys, command):
    with pytest.raises(SystemExit) as stopped:
        cli.main([command, "--help"])
    assert stopped.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "number of a map, 1 to 8, or a star map file" in text
    assert "print JSON instead of a table" in text


def test_the_commands_are_listed_and_need_no_ros():
    done = completed("-m", "star_tracker.commands.cli", "calibrate", "1", "--json")
    assert (done.stderr, done.returncode) == ("", 0)
    assert json.loads(done.stdout)["map"] == "map 1"


def test_the_page_about_the_boresight_shows_the_real_output(capsys):
    page = ROOT / "docs" / "boresight.md"
    if not page.is_file():
        pytest.skip("the page is only in a source checkout")
    shown = page.read_text(encoding="utf-8").split("```\n")[1]
    printed = run(capsys, "boresight", "1", "--stars", "A01,A02,A03")
    assert [line.split() for line in shown.splitlines()] == [
        line.split() for line in printed.splitlines()
    ]
