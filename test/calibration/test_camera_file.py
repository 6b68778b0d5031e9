"""Cameras in the YAML files of ROS's camera_calibration."""

import pytest

from star_tracker.calibration.camera_file import read_camera, write_camera
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

yaml = pytest.importorskip("yaml", reason="reading camera files needs PyYAML")
#: As camera_calibration writes it, with numbers of a real 752 x 480 lens.
ROS_FILE = """
image_width: 752
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [460.5, 0, 371.2, 0, 459.8, 231.9, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.07, 0.0001, 0.0002, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [460.5, 0, 371.2, 0, 0, 459.8, 231.9, 0, 0, 0, 1, 0]
"""


@pytest.mark.parametrize("camera", [
    Camera.from_fov(12, 512, 512, parity="mirrored"),
    Camera(1024, 768, 1100.5, 1099.25, 510.125, 390.0, "normal",
           Distortion("plumb_bob", (-0.25, 0.1, 0.0, 0.0, 0.01)), 1.23456789),
    Camera(800, 600, 400.0, 400.0, 400.0, 300.0, "auto",
           Distortion("equidistant", (0.0, 0.0, 0.0, 0.0))),
])
def test_a_camera_comes_back_as_it_was(camera, tmp_path):
    write_camera(camera, tmp_path / "camera.yaml")
    assert read_camera(tmp_path / "camera.yaml") == camera


def test_a_camera_keeps_the_name_that_it_has_in_the_file(tmp_path):
    path = tmp_path / "c.yaml"
    for before, kept in (("", "camera"), ('flight: "7"', 'flight: "7"'), ("", 'flight: "7"')):
        write_camera(Camera.from_fov(20, 1024, 768), path, name=before)
        assert yaml.safe_load(path.read_text())["camera_name"] == kept
    path.write_text("[no camera")
    write_camera(Camera.from_fov(20, 1024, 768), path)
    assert yaml.safe_load(path.read_text())["camera_name"] == "camera"


def test_what_ros_reads_is_there(tmp_path):
    write_camera(Camera.from_fov(20, 1024, 768), tmp_path / "c.yaml", name="left")
    content = yaml.safe_load((tmp_path / "c.yaml").read_text())
    assert content["camera_name"] == "left"
    assert (content["image_width"], content["image_height"]) == (1024, 768)
    assert content["camera_matrix"]["data"][::4] == [
        content["camera_matrix"]["data"][0], content["camera_matrix"]["data"][0], 1.0
    ]
    assert len(content["projection_matrix"]["data"]) == 12
    # The middle of the image, counted from that of the first pixel.
    assert content["camera_matrix"]["data"][2::3] == [511.5, 383.5, 1.0]
    assert content["projection_matrix"]["data"][2::4] == [511.5, 383.5, 1.0]
    assert content["distortion_coefficients"]["data"] == [0.0] * 5


def test_a_file_of_ros_is_read_with_parity_to_find_out(tmp_path):
    (tmp_path / "ros.yaml").write_text(ROS_FILE)
    camera = read_camera(tmp_path / "ros.yaml")
    # Counted from the outer corner of the first pixel, half a pixel more than ROS has it.
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (460.5, 459.8, 371.7, 232.4)
    assert camera.distortion == Distortion("plumb_bob", (-0.28, 0.07, 0.0001, 0.0002, 0.0))
    assert (camera.parity, camera.tolerance_percent) == ("auto", 2.0)


@pytest.mark.parametrize(("text", "sentence"), [
    ("image_width: 3\n", "has no camera_matrix"),
    ("a: [1,\n", "is not YAML"),
    ("3\n", "it holds no camera: image_width"),
    ("", "it holds no camera: image_width"),
    (ROS_FILE.replace("460.5, 0, 371.2, 0, 459.8", "nan, 0, 371.2, 0, 459.8"),
     "camera fx_px is not a finite number"),
    (ROS_FILE.replace("460.5, 0, 371.2, 0, 459.8", "460.5, 7, 371.2, 0, 459.8"),
     "camera_matrix has a skew of 7"),
    (ROS_FILE.replace("460.5, 0, 371.2, 0, 459.8, 231.9, 0, 0, 1]",
                      "460.5, 0, 0, 0, 459.8, 0, 371.2, 231.9, 1]"),
     "camera_matrix is not of the form fx 0 cx"),
    (ROS_FILE.replace("460.5, 0, 371.2, 0, 459.8", "460.5, 0, 371.2, 459.8"),
     "camera_matrix has 8 numbers, not 9"),
    (ROS_FILE.replace("image_width: 752", "image_width: .inf"), "infinity"),
    (ROS_FILE.replace("plumb_bob", "ftheta"), "distortion_model 'ftheta' is not known"),
    (ROS_FILE.replace("data: [-0.28", "coefficients: [-0.28"),
     "distortion_coefficients has no list of numbers in its data"),
    (ROS_FILE + "star_tracker: normal\n", "star_tracker has parity and tolerance_percent below"),
    (ROS_FILE + "star_tracker: {parity: upside}\n", "parity 'upside' is unknown"),
])
def test_a_file_that_is_none_is_told_with_its_name(text, sentence, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"bad\.yaml") as error:
        read_camera(path)
    assert sentence in str(error.value)


@pytest.mark.parametrize(("before", "after", "lens"), [
    ("plumb_bob", "radtan", Distortion("plumb_bob", (-0.28, 0.07, 0.0001, 0.0002, 0.0))),
    ("[-0.28, 0.07, 0.0001, 0.0002, 0.0]", "[-0.28, 0.07, 0.0001, 0.0002]",
     Distortion("plumb_bob", (-0.28, 0.07, 0.0001, 0.0002, 0.0))),
    ("plumb_bob", "Kannala-Brandt", Distortion("equidistant", (-0.28, 0.07, 0.0001, 0.0002))),
    ("[-0.28, 0.07, 0.0001, 0.0002, 0.0]", "[0, 0, 0, 0, 0]", None),
    ("plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
     "  data: [-0.28, 0.07, 0.0001, 0.0002, 0.0]", "fisheye",
     Distortion("equidistant", (0.0, 0.0, 0.0, 0.0))),
    ("distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.28, 0.07, 0.0001, 0.0002, 0.0]",
     "distortion_coefficients:", None),
    ("distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.28, 0.07, 0.0001, 0.0002, 0.0]",
     "distortion_coefficients: [0, 0, 0, 0, 0]", None),
    ("camera_name:", "star_tracker:\ncamera_name:",
     Distortion("plumb_bob", (-0.28, 0.07, 0.0001, 0.0002, 0.0))),
])
def test_a_lens_is_read_as_camera_info_is(before, after, lens, tmp_path):
    assert before in ROS_FILE
    (tmp_path / "ros.yaml").write_text(ROS_FILE.replace(before, after))
    assert read_camera(tmp_path / "ros.yaml").distortion == lens


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(ValueError, match="cannot be read: No such file or directory"):
        read_camera(tmp_path / "none.yaml")
