"""What `star_tracker watch` makes of the messages of a node, from plain values."""

import itertools
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from watch_helpers import (
    ARCSEC,
    BORESIGHT,
    COVARIANCE,
    FOCAL_LENGTH,
    HEALTH,
    QUATERNION,
    SOLVED,
    STARS,
    UNSOLVED,
    hear_solved,
    hear_unsolved,
    watched_at,
)

from star_tracker.nodes.watch.model import PATIENCE_S, Report, Watched, sigma_arcsec
from star_tracker.nodes.watch.record import json_line, plain_line

NS = 10**9


# ---- frames ----------------------------------------------------------------------------------


def test_a_solved_frame_is_complete_with_its_last_message_in_whatever_order():
    steps = [
        lambda watched: watched.on_solution(NS, "identify_node", SOLVED, 1.0),
        lambda watched: watched.on_orientation(NS, (QUATERNION, COVARIANCE), 1.0),
        lambda watched: watched.on_boresight(NS, BORESIGHT, 1.0),
        lambda watched: watched.on_stars(NS, STARS, 1.0),
    ]
    for *first, last in itertools.permutations(steps):
        watched = Watched()
        for step in first:
            step(watched)
            assert watched.take(1.0) == []
        last(watched)
        (frame,) = watched.take(1.0)
        assert (frame.stamp_ns, frame.status, len(frame.stars)) == (NS, "SOLVED", 4)
        assert frame.pose is watched.pose
        np.testing.assert_array_equal(frame.pose.boresight_deg, BORESIGHT)
        assert watched.take(1.0) == []


def test_an_unsolved_frame_has_no_pose_and_the_last_one_stays():
    watched = Watched()
    hear_solved(watched, 1.0)
    (frame,) = hear_unsolved(watched, 3.0)
    assert frame.pose is None
    assert watched.frame is frame
    np.testing.assert_array_equal(watched.pose.boresight_deg, BORESIGHT)
    assert (watched.pose_s, watched.frame_s, watched.n_frames) == (1.0, 3.0, 2)


def test_a_frame_that_could_not_be_read_comes_without_stars():
    watched = Watched()
    values = {**UNSOLVED, "status": "BAD_INPUT", "total": "0"}
    watched.on_solution(NS, "identify_node", values, 1.0)
    (frame,) = watched.take(1.0)
    assert (frame.status, frame.stars) == ("BAD_INPUT", None)


def test_a_frame_whose_messages_are_lost_is_told_as_far_as_it_came():
    watched = Watched()
    watched.on_solution(NS, "identify_node", SOLVED, 1.0)
    watched.on_orientation(2 * NS, (QUATERNION, COVARIANCE), 1.0)
    assert watched.take(1.0 + PATIENCE_S) == []
    (frame,) = watched.take(1.01 + PATIENCE_S)
    assert (frame.stamp_ns, frame.pose, frame.stars) == (NS, None, None)
    assert watched.take(100.0) == []


def test_frames_with_one_and_the_same_stamp_are_told_apart():
    watched = Watched()
    frames = [hear_solved(watched, now_s, stamp_ns=0) for now_s in (1.0, 2.0, 3.0)]
    assert [len(found) for found in frames] == [1, 1, 1]


def test_frames_come_in_the_order_of_their_first_messages():
    watched = Watched()
    for stamp in (5, 3, 4):
        watched.on_solution(stamp, "identify_node", UNSOLVED, 1.0)
    for stamp in (3, 4, 5):
        watched.on_stars(stamp, STARS, 1.0)
    assert [frame.stamp_ns for frame in watched.take(1.0)] == [5, 3, 4]


# ---- errors ----------------------------------------------------------------------------------


def test_errors_are_about_the_axes_of_the_camera():
    # The camera's x lies along the reference frame's y, its y along -x.
    np.testing.assert_allclose(sigma_arcsec(QUATERNION, COVARIANCE), [2.0, 3.0, 40.0])


def test_errors_come_back_from_the_frame_that_imu_has_them_in():
    about_camera = np.diag([1.0, 4.0, 900.0]) * ARCSEC**2
    for rotation in Rotation.random(20, rng=np.random.default_rng(5)):
        r = rotation.as_matrix()
        found = sigma_arcsec(rotation.as_quat(), r @ about_camera @ r.T)
        np.testing.assert_allclose(found, [1.0, 2.0, 30.0], rtol=1e-9)


# ---- reports ---------------------------------------------------------------------------------


def test_only_the_nodes_own_reports_count():
    watched = Watched("/left")
    for name in ("/right/identify_node", "/identify_node", "/left/inner/identify_node"):
        watched.on_report(f"{name}: health", HEALTH, 1.0)
    assert not watched.heard
    watched.on_report("/left/identify_node: health", HEALTH, 2.0)
    watched.on_report("/left/identify_node: focal length", FOCAL_LENGTH, 2.0)
    watched.on_report("/left/identify_node: something else", HEALTH, 3.0)
    watched.on_report("/left/no colon", HEALTH, 3.0)
    assert (watched.health, watched.health_s) == (HEALTH, 2.0)
    assert watched.focal_length is FOCAL_LENGTH
    assert watched.full_name == "/left/identify_node"


def test_the_node_at_the_root_has_the_root_in_its_name():
    watched = Watched("/")
    assert watched.full_name == "/identify_node"
    watched.on_report("/second: health", HEALTH, 1.0)
    assert watched.full_name == "/second"


def test_of_two_nodes_in_a_namespace_the_one_that_answers_frames_is_meant():
    watched = Watched()
    watched.on_solution(NS, "camera_two", SOLVED, 1.0)
    watched.on_report("/identify_node: health", HEALTH, 1.0)
    assert watched.health is None
    watched.on_report("/camera_two: health", HEALTH, 1.0)
    assert watched.health is HEALTH


# ---- records ---------------------------------------------------------------------------------


def test_record_of_a_solved_frame_has_numbers_with_units():
    watched = watched_at(1.0)
    record = json.loads(json_line(watched, watched.frame))
    assert record["node"] == "/left/identify_node"
    assert (record["stamp_ns"], record["status"], record["mode"]) == (
        1_500_000_000, "SOLVED", "tracking"
    )
    assert (record["matched"], record["total"], record["solve_ms"]) == (2, 4, 0.161)
    assert (record["ra_deg"], record["dec_deg"], record["roll_deg"]) == (109.60001, -34.5, 0.25)
    assert record["quaternion_xyzw"] == QUATERNION.tolist()
    assert record["sigma_camera_xyz_arcsec"] == pytest.approx([2.0, 3.0, 40.0])
    assert record["stars"][1] == {
        "x": 100.0, "y": 200.5, "star_number": 0, "hip": 0, "ra_deg": None, "dec_deg": None,
        "magnitude": None, "residual_px": None, "state": "unidentified",
    }
    assert record["stars"][0]["magnitude"] == 5.04
    assert record["stars"][3]["state"] == "displaced"
    assert record["health"]["latency_p95_ms"] == 1.25
    assert record["health"]["latency_max_ms"] is None
    assert record["health"]["configuration"] == "123456789012"
    assert record["focal_length"]["focal_length_px"] == 2435.817


def test_record_of_an_unsolved_frame_has_null_where_nothing_is_known():
    watched = Watched()
    (frame,) = hear_unsolved(watched, 1.0)
    record = json.loads(json_line(watched, frame))
    for key in (
        "ra_deg", "quaternion_xyzw", "sigma_camera_xyz_arcsec", "log10_false_alarms", "rms_px",
        "health", "focal_length",
    ):
        assert record[key] is None
    assert record["hint"].startswith("image looks mirrored")
    assert record["stars"] == []


def test_record_without_any_frame_tells_the_health():
    watched = Watched()
    watched.on_report("/identify_node: health", Report("WARN", "no frame", {"frames": "0"}), 1.0)
    record = json.loads(json_line(watched, None))
    assert (record["status"], record["health"]["level"]) == (None, "WARN")
    assert record["health"]["frames"] == 0


def test_a_state_without_a_name_is_a_number():
    watched = Watched()
    stars = STARS[:1].copy()
    stars["state"] = 9
    watched.on_solution(NS, "identify_node", UNSOLVED, 1.0)
    watched.on_stars(NS, stars, 1.0)
    (frame,) = watched.take(1.0)
    assert json.loads(json_line(watched, frame))["stars"][0]["state"] == "9"


def test_plain_lines():
    watched = Watched()
    (solved,) = hear_solved(watched, 1.0)
    (unsolved,) = hear_unsolved(watched, 2.0)
    assert plain_line(watched, solved) == (
        "1.500 SOLVED 2/4 RA 109.6000 Dec -34.5000 roll 0.2500 deg, "
        "1 sigma x, y, z 2.00, 3.00, 40.00 arcsec, 0.161 ms"
    )
    assert plain_line(watched, unsolved) == (
        "2.500 NO_MATCH 0/4: nothing fits; image looks mirrored: parity mirrored solves it"
    )
