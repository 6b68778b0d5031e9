"""`star_tracker render` and `make-bag`: the image and its truth, and what is refused."""

import json

import numpy as np
import pytest

from star_tracker.commands import cli
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.offline.image_file import read_image

#: Small, and of a field with bright stars: Orion's belt.
ORION = ("--ra-deg", "84", "--dec-deg", "-1", "--width-px", "200", "--height-px", "150")


def run(capsys, *arguments):
    """Return exit code, output and messages."""
    code = cli.main([*map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def rendered(capsys, *arguments):
    """Return the records that are printed."""
    code, out, err = run(capsys, "render", *arguments, *ORION, "--json")
    assert (code, err) == (0, "")
    return [json.loads(line) for line in out.splitlines()]


def test_the_truth_is_where_the_detector_finds_the_stars(tmp_path, capsys):
    (truth,) = rendered(capsys, tmp_path / "sky.npy")
    stars = truth["stars"]
    assert stars == sorted(stars, key=lambda star: -star["electrons"])
    assert {star["hip"] for star in stars[:6]} >= {26727, 26311, 25930}  # the belt
    found = detect_stars(np.load(tmp_path / "sky.npy")).xy_px
    for star in stars[:3]:
        away = np.hypot(*(found - (star["x_px"], star["y_px"])).T)
        assert away.min() < 0.1


def test_a_seed_gives_its_image_again_and_another_file_has_another(tmp_path, capsys):
    files = [tmp_path / f"{name}.npy" for name in "abc"]
    assert [one["seed"] for one in rendered(capsys, *files[:2], "--seed", 5)] == [5, 6]
    rendered(capsys, files[2], "--seed", 6)
    a, b, c = (np.load(path) for path in files)
    assert np.array_equal(b, c)
    assert not np.array_equal(a, b)


@pytest.mark.parametrize("ending", ["png", "tif", "fits", "npy"])
@pytest.mark.parametrize("bits", [8, 16])
def test_every_format_holds_the_same_image(ending, bits, tmp_path, capsys):
    if ending == "fits":
        pytest.importorskip("astropy", reason="needs astropy, an extra")
    if ending in ("png", "tif"):
        pytest.importorskip("PIL", reason="needs Pillow, an extra")
    files = [tmp_path / "sky.npy", tmp_path / f"other.{ending}"]
    for path in files:
        rendered(capsys, path, "--bits", bits)
    first, other = map(read_image, files)
    assert first.dtype == {8: np.uint8, 16: np.uint16}[bits]
    assert np.array_equal(first, other)


def test_options_reach_the_image(tmp_path, capsys):
    """The bias is the level of a dark image; a planet and a well are as told."""
    path = tmp_path / "sky.npy"
    (truth,) = rendered(
        capsys, path, "--bias-dn", 100, "--sky-e-per-s", 0, "--full-well-e", 5000,
        "--planet", "84,-1,-4", "--limiting-magnitude", 3,
    )
    image = np.load(path)
    assert np.median(image) == 100
    assert truth["saturation"] == image.max() == 100 + 5000 / RenderSettings().gain_e_per_dn
    planet = truth["stars"][0]
    assert planet["hip"] is None
    assert (planet["x_px"], planet["y_px"]) == pytest.approx((100, 75))


@pytest.mark.parametrize(("arguments", "text"), [
    (["sky.gif"], "sky.gif names no format that is written: let it end in .png, "),
    (["no/such/sky.npy"], "no/such/sky.npy cannot be written: "),
    (["sky.npy", "--exposure-s", "0"], "exposure_s must be greater than 0"),
    (["sky.npy", "--bits", "7"], "bits must be from 8 to 16"),
    (["sky.npy", "--dec-deg", "91"], "--dec-deg 91 is none: give -90 to 90"),
    (["sky.npy", "--ra-deg", "nan"], "--ra-deg, --dec-deg and --roll-deg must be finite"),
    (["sky.npy", "--planet", "1,2"], "--planet '1,2' must be 3 numbers with commas between"),
    (["sky.npy", "--sky-gradient", "a,b"], "--sky-gradient 'a,b' must be 2 numbers with"),
    (["sky.npy", "--rate-deg-s=-1,nan,0"], "--rate-deg-s '-1,nan,0' must be 3 numbers"),
    (["sky.npy", "--seed", "-1"], "--seed must be 0 or more"),
    (["sky.npy", "--width-px", "0"], "--width-px must be a number greater than 0"),
    (["sky.npy", "--fov-deg", "200"], ""),
    (["sky.bmp"], "sky.bmp cannot hold uint16: BMP has 8 bits, write PNG or TIFF"),
])
def test_what_cannot_be_rendered_is_refused_in_one_line(
    arguments, text, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "render", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"star_tracker render: {text}")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("arguments", "text"), [
    (["bag.mcap", "--maps", "1,9"], "there is no map 9: the maps are numbered 1 to 8"),
    (["bag.mcap", "--maps", "one"], "--maps 'one' is no list of numbers: give some of 1 to 8"),
    (["bag.mcap", "--rate-hz", "0"], "--rate-hz must be a number greater than 0"),
    (["bag.mcap", "--images", "--bits", "99"], "bits must be from 8 to 16"),
    (["bag.db3", "--storage", "mcap"], "bag.db3 cannot be of storage mcap: .db3 is sqlite3"),
    (["no/such/bag"], "no/such/bag cannot be written: "),
])
def test_what_is_no_bag_is_refused_in_one_line(arguments, text, tmp_path, monkeypatch, capsys):
    pytest.importorskip("rosbags", reason="needs rosbags, an extra")
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "make-bag", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"star_tracker make-bag: {text}")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
