"""The demo: how it judges, and the whole of it in real processes."""

import os
import shutil
import signal
from dataclasses import replace

import numpy as np
import pytest
from processes import completed, popen
from waiting import last_resort

from msg_adapters.point_cloud import STAR_DTYPE
from star_tracker.maps.star_map import paper_maps
from star_tracker.nodes.demo import Result, grade
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


@starts_nodes
def test_the_demo_finds_all_141_stars_in_real_processes():
    done = completed(*DEMO)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "8 of 8 maps right, 141 of 141 labels equal to the paper's" in done.stdout
    assert "(138 identified, 3 displaced)" in done.stdout


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


@starts_nodes
def test_interrupted_demo_ends_without_a_traceback():
    # A group of its own: a terminal's Ctrl-C goes to the nodes too.
    with (
        popen("-u", *DEMO, "--rate-hz", "0.01", start_new_session=True) as demo,
        last_resort(lambda: os.killpg(demo.pid, signal.SIGKILL)),
    ):
        lines = []
        for line in demo.stderr:
            lines.append(line)
            if "maps at" in line:
                os.killpg(demo.pid, signal.SIGINT)
        code = demo.wait()
    assert code == 130, "".join(lines)
    assert "Traceback" not in "".join(lines)
