"""`star_tracker calibrate FRAME...`: one camera from the lists of centroids that it gave."""

import json
from dataclasses import replace

import numpy as np
import pytest

from star_tracker.calibration.camera_file import read_camera
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.commands import cli
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

SIZE = ["--width-px", "640", "--height-px", "480"]
CAMERA = replace(
    Camera.from_fov(30.0, 640, 480, parity="mirrored"),
    distortion=Distortion("plumb_bob", (-0.2, 0.0, 0.0, 0.0, 0.0)),
)


#: Its lens 20 px off the middle.
DECENTRED = replace(CAMERA, cx_px=308.0, cy_px=256.0)


def lists_of(camera, folder):
    """Write lists of centroids of random attitudes, noise 0.1 px."""
    rng, sky = np.random.default_rng(7), StarCatalog.hipparcos(limiting_magnitude=5.5)
    paths = []
    while len(paths) < 6:
        frame = synthetic_field(sky, camera, random_rotation(rng), rng, Condition(noise_px=0.1))
        if len(frame.xy_px) >= 15:
            paths.append(str(folder / f"frame{len(paths)}.csv"))
            np.savetxt(paths[-1], frame.xy_px, delimiter=",", header="x,y", comments="")
    return paths


@pytest.fixture(scope="module")
def lists(tmp_path_factory):
    """Lists of the camera's frames."""
    return lists_of(CAMERA, tmp_path_factory.mktemp("lists"))


def run(capsys, *arguments):
    """Return exit code, output and messages."""
    try:
        code = cli.main(["calibrate", "--jobs", "1", *map(str, arguments)])
    except SystemExit as end:
        code = end.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_focal_length_and_lens_with_residuals_before_and_after(lists, capsys, tmp_path):
    yaml = pytest.importorskip("yaml", reason="reading camera files needs PyYAML")
    path = tmp_path / "camera.yaml"
    code, out, err = run(capsys, *lists, *SIZE, "--fov-deg", "29", "--output", path, "--json")
    record = json.loads(out)
    assert (code, err) == (0, "")
    assert (record["frames"], record["frames_used"], record["left_out"]) == (6, 6, [])
    assert (record["parity"], record["written_to"]) == ("mirrored", str(path))
    assert record["rms_after_px"] == pytest.approx(0.1 * np.sqrt(2), rel=0.25)
    assert record["rms_before_px"] > 3 * record["rms_after_px"]
    rows = {row["parameter"]: row for row in record["parameters"]}
    for name, true in (("focal_length_px", CAMERA.focal_length_px), ("k1", -0.2), ("k2", 0.0)):
        assert abs(rows[name]["fitted"] - true) < 4 * rows[name]["standard_error"]
    assert rows["fov_deg"]["before"] == pytest.approx(29.0)
    written = read_camera(path)
    assert written.focal_length_px == pytest.approx(rows["focal_length_px"]["fitted"])
    assert written.parity == "mirrored"
    # The principal point as told, the middle, counted in the file as ROS counts it.
    middle = CAMERA.width_px / 2, CAMERA.height_px / 2
    assert (written.cx_px, written.cy_px) == middle
    told = yaml.safe_load(path.read_text())["camera_matrix"]["data"]
    assert (told[2], told[5]) == (middle[0] - 0.5, middle[1] - 0.5)


def test_the_table_says_what_was_fitted(lists, capsys):
    code, out, _ = run(capsys, *lists, *SIZE, "--fov-deg", "30")
    text = " ".join(out.split())
    assert code == 0
    for part in ("in 6 of 6 frames", "before", "after", "+/-", "the principal point stays"):
        assert part in text


def test_the_principal_point_is_fitted_where_that_is_asked_for(capsys, tmp_path):
    pytest.importorskip("yaml", reason="reading camera files needs PyYAML")
    path, asked = tmp_path / "camera.yaml", (*SIZE, "--fov-deg", "29.5")
    paths = lists_of(DECENTRED, tmp_path)
    code, out, err = run(
        capsys, *paths, *asked, "--principal-point", "--output", path, "--json"
    )
    assert (code, err) == (0, "")
    rows, written = {row["parameter"]: row for row in json.loads(out)["parameters"]}, {}
    for name, middle in (("cx_px", 320.0), ("cy_px", 240.0)):
        row = rows[name]
        assert row["before"] == middle
        assert abs(row["fitted"] - getattr(DECENTRED, name)) < 4 * row["standard_error"] < 10.0
        written[name] = row["fitted"]
    camera = read_camera(path)
    assert {"cx_px": camera.cx_px, "cy_px": camera.cy_px} == pytest.approx(written)
    assert "principal point" not in run(capsys, *paths, *asked, "--principal-point")[1]


def test_a_principal_point_that_the_stars_do_not_show_is_said_to_stay(lists, capsys):
    code, out, _ = run(capsys, *lists, *SIZE, "--fov-deg", "29.5", "--principal-point")
    text = " ".join(out.split())
    assert code == 0
    assert "the principal point stays where it was told: the stars, which tell it to" in text
    assert "px, show no other" in text
    assert "cx_px" not in text


def test_a_file_that_cannot_be_read_is_named_and_the_others_are_used(lists, capsys, tmp_path):
    missing = tmp_path / "missing.png"
    code, out, err = run(capsys, missing, *lists, *SIZE, "--fov-deg", "30", "--json")
    assert code == 1
    assert json.loads(out)["frames_used"] == 6
    assert err == (
        f"star_tracker calibrate: {missing} cannot be read: there is no such file\n"
    )


@pytest.mark.parametrize(("words", "sentence"), [
    (["--terms", "k1"], "--terms and --focal-length-px are for one star map, not for frames"),
    (["--width-px", "640"], "--width-px and --height-px belong together"),
])
def test_options_that_do_not_fit_frames_are_refused(lists, capsys, words, sentence):
    code, _, err = run(capsys, *lists, *words)
    assert code == 2
    assert sentence in err


@pytest.mark.parametrize(("words", "sentence"), [
    (["--output", "camera.yaml"], "--output is for frames: one star map is no camera's"),
    (["--principal-point"], "is for frames: for one star map use --terms principal_point"),
])
def test_options_that_do_not_fit_a_star_map_are_refused(capsys, words, sentence):
    code, _, err = run(capsys, "1", *words)
    assert code == 2
    assert sentence in err


def test_a_frame_counts_once_however_often_it_is_named(lists, capsys):
    counted = [
        json.loads(run(capsys, *words, *SIZE, "--fov-deg", "29", "--json")[1])["frames"]
        for words in (lists, [*lists, *lists])
    ]
    assert counted == [6, 6]


def test_images_of_several_sizes_are_of_several_cameras(lists, capsys):
    code, _, err = run(capsys, *lists, "7", *SIZE, "--fov-deg", "30")
    assert code == 2
    assert "images of several cameras (6 of 640 x 480 px, 1 of 1024 x 1024 px)" in err
