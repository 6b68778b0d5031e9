"""The demo: how it judges, and the whole of it in real processes."""

import os
import re
import shutil
import signal
from dataclasses import replace

import numpy as np
import pytest
from processes import completed, popen
from waiting import last_resort

from star_tracker.geometry.rotation import rotation_from_boresight, write_quaternion
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.point_cloud import STAR_DTYPE
from star_tracker.nodes.demo import Result, grade
from star_tracker.nodes.demo_image import _SKY, grade_image
from star_tracker.resources import resource_path

MAP6 = paper_maps((6,))[0]
DEMO = ("-m", "star_tracker.nodes.demo")
starts_nodes = pytest.mark.usefixtures("solver_compiled")


def perfect(star_map):
    stars = np.zeros(len(star_map.labels), STAR_DTYPE)
    stars["star_number"] = star_map.star_number
    stars["state"] = np.where(star_map.displaced_px > 0, 2, 1)
    pose = star_map.pose
    values = {"status": "SOLVED", "reason": "identified"}
    return Result(values, stars, np.array([pose.ra_deg, pose.dec_deg, pose.roll_deg]))


def test_a_perfect_answer_has_no_faults():
    row = grade(MAP6, perfect(MAP6))
    assert row.faults == ()
    assert (row.n_right, row.n_identified, row.n_displaced) == (12, 9, 3)


def test_a_wrong_label_is_a_fault():
    result = perfect(MAP6)
    result.stars["star_number"][0] = 1671
    assert grade(MAP6, result).faults == ("F01 is star 1670, labelled 1671",)


def test_a_star_without_a_label_is_a_fault():
    result = perfect(MAP6)
    result.stars["star_number"][1] = 0
    assert grade(MAP6, result).faults == ("F02 is star 1477, labelled nothing",)


def test_a_boresight_three_arcsec_off_is_a_fault():
    result = perfect(MAP6)
    result.boresight_deg[1] += 3 / 3600
    assert grade(MAP6, result).faults == ("boresight is 3.0 arcsec off, more than 2",)


def test_a_map_without_an_attitude_is_a_fault_with_its_reason():
    result = replace(perfect(MAP6), boresight_deg=None, values={"reason": "too cloudy"})
    assert grade(MAP6, result).faults == ("no attitude: too cloudy",)


def test_lost_stars_are_a_fault():
    result = perfect(MAP6)
    short = replace(result, stars=result.stars[:-1])
    assert grade(MAP6, short).faults[0] == "11 stars came back, not 12"


def answer_to_an_image(turned_deg=0.0, n_wrong=0):
    """An answer whose stars are where the truth has them, and the true quaternion."""
    pose = np.array([_SKY.ra_deg, _SKY.dec_deg, 10.0])
    rotation, truth = rotation_from_boresight(*np.radians(pose)), np.empty(4)
    write_quaternion(rotation, truth)
    vectors = _SKY.camera.vectors(np.array([[100.0, 80.0], [320.0, 240.0], [500.0, 400.0]]))
    icrs = vectors @ rotation.T
    stars = np.zeros(3, STAR_DTYPE)
    stars["x"], stars["y"] = np.array([[100.0, 80.0], [320.0, 240.0], [500.0, 400.0]]).T - 0.5
    stars["ra_deg"] = np.degrees(np.arctan2(icrs[:, 1], icrs[:, 0])) % 360
    stars["dec_deg"] = np.degrees(np.arcsin(icrs[:, 2]))
    stars["dec_deg"][:n_wrong] += 1.0
    stars["state"] = 1
    found = pose + np.array([0.0, turned_deg, 0.0])
    return Result({"status": "SOLVED", "reason": "identified"}, stars, found), truth


def test_a_right_answer_to_an_image_has_no_faults():
    row = grade_image(*answer_to_an_image())
    assert row.faults == ()
    assert (row.n_right, row.n_identified) == (3, 3)
    assert row.cells[:4] == ("image", "20 deg/640", "3/3", "3")


@pytest.mark.parametrize(("arguments", "fault"), [
    ({"turned_deg": 0.2}, "boresight is 0.200 deg off, more than 0.1"),
    ({"n_wrong": 1}, "1 of 3 labels are wrong"),
])
def test_a_wrong_answer_to_an_image_is_a_fault(arguments, fault):
    assert grade_image(*answer_to_an_image(**arguments)).faults == (fault,)


def test_an_image_without_an_attitude_is_a_fault_with_its_reason():
    result, truth = answer_to_an_image()
    lost = replace(result, boresight_deg=None, values={"reason": "too cloudy"})
    assert grade_image(lost, truth).faults == ("no attitude: too cloudy",)


@starts_nodes
def test_the_demo_finds_all_141_stars_in_real_processes():
    done = completed(*DEMO)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "8 of 8 maps right, 141 of 141 labels equal to the paper's" in done.stdout
    assert "(138 identified, 3 displaced)" in done.stdout
    assert re.search(r"^image +20 deg/640 +(\d+)/\1 +\1 ", done.stdout, re.MULTILINE)
    assert re.search(r"^1 rendered image: (\d+) of \1 labels right$", done.stdout, re.MULTILINE)


@pytest.mark.slow
@starts_nodes
def test_the_demo_fails_where_a_label_is_made_wrong_on_purpose(tmp_path):
    folder = tmp_path / "maps"
    shutil.copytree(resource_path("data/star_maps"), folder)
    path = folder / "map4.csv"
    text = path.read_text(encoding="utf-8")
    assert ",3249," in text
    path.write_text(text.replace(",3249,", ",3248,"), encoding="utf-8")
    done = completed(*DEMO, "--folder", str(folder), "--rate-hz", "50")
    assert done.returncode == 1
    assert "7 of 8 maps right, 140 of 141 labels" in done.stdout
    assert "WRONG map 4: D01 is star 3248, labelled 3249" in done.stdout


def test_the_demo_says_in_one_line_that_a_folder_has_no_maps(tmp_path):
    done = completed(*DEMO, "--folder", str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.startswith(f"demo: star map {tmp_path}")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
@starts_nodes
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_demo_ends_without_a_traceback(number):
    # A group of its own: a terminal's Ctrl-C goes to the nodes too.
    with (
        popen("-u", *DEMO, "--rate-hz", "0.01", start_new_session=True) as demo,
        last_resort(lambda: os.killpg(demo.pid, signal.SIGKILL)),
    ):
        lines = []
        for line in demo.stderr:
            lines.append(line)
            if "maps at" in line:
                os.killpg(demo.pid, number)
        code = demo.wait()
    assert code == 130, "".join(lines)
    assert "Traceback" not in "".join(lines)
