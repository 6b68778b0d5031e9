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


@pytest.fixture(scope="module")
def lists(tmp_path_factory):
    """Lists of centroids of random attitudes, noise 0.1 px."""
    folder, rng = tmp_path_factory.mktemp("lists"), np.random.default_rng(7)
    sky = StarCatalog.hipparcos(limiting_magnitude=5.5)
    paths = []
    while len(paths) < 6:
        frame = synthetic_field(sky, CAMERA, random_rotation(rng), rng, Condition(noise_px=0.1))
        if len(frame.xy_px) >= 15:
            paths.append(str(folder / f"frame{len(paths)}.csv"))
            np.savetxt(paths[-1], frame.xy_px, delimiter=",", header="x,y", comments="")
    return paths


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


def test_a_star_map_takes_no_output(capsys, tmp_path):
    code, _, err = run(capsys, "1", "--output", tmp_path / "camera.yaml")
    assert code == 2
    assert "--output is for frames: one star map is no camera's calibration" in err


def test_images_of_several_sizes_are_of_several_cameras(lists, capsys):
    code, _, err = run(capsys, *lists, "7", *SIZE, "--fov-deg", "30")
    assert code == 2
    assert "images of several cameras (6 of 640 x 480 px, 1 of 1024 x 1024 px)" in err
