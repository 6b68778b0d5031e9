"""A camera that is told with a tolerance: attitude and focal length out of the stars."""

import dataclasses
import math

import numpy as np
import pytest
from engines import CAMERA
from solutions import PATIENT, assert_unsolved, record

from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.solution import Status
from star_tracker.tracker import StarTracker

NOISE_PX = 0.3


def told(error_percent, tolerance_percent=5.0):
    """What is said of a camera that is truly `CAMERA`."""
    wrong = CAMERA.scaled(1 + error_percent / 100)
    return dataclasses.replace(wrong, tolerance_percent=tolerance_percent)


def frames_of(database, n, seed):
    """Frames of the true camera with some stars more than the fewest."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        view = synthetic_field(
            database.catalog, CAMERA, random_rotation(rng), rng, Condition(noise_px=NOISE_PX)
        )
        if len(view.xy_px) >= 7:
            found.append(view)
    return found


def assert_within_covariance(solution, view):
    """The squared error in units of the covariance: 21 is 0.9999 of a chi-square of 3."""
    error = solution.attitude.rotation.T @ view.rotation
    small = np.array([error[2, 1], error[0, 2], error[1, 0]])
    assert small @ np.linalg.solve(solution.attitude.covariance_rad2, small) < 21


@pytest.mark.parametrize("error_percent", [-5.0, -2.0, 0.0, 2.0, 5.0])
def test_attitude_and_focal_length_are_right_within_what_is_told_of_them(database, error_percent):
    tracker = StarTracker(database, told(error_percent), PATIENT)
    deviations = []
    for view in frames_of(database, 25, 1):
        solution = tracker.solve(view.xy_px)
        assert solution.status is Status.SOLVED
        named = solution.identification.identified
        np.testing.assert_array_equal(
            solution.identification.catalog_index[named], view.catalog_index[named]
        )
        assert len(named) >= len(view.xy_px) - 1
        assert_within_covariance(solution, view)
        found = solution.camera.fx_px
        assert found == pytest.approx(tracker.camera.fx_px * solution.scale)
        off = math.log(found / CAMERA.fx_px)
        assert solution.focal_length_from_stars
        deviations.append(off / solution.focal_length_error)
    # The standard error is widened for few stars: the scatter is one or less.
    assert np.all(np.abs(deviations) < 4)
    assert np.std(deviations) < 1.4


def test_the_attitude_is_within_its_covariance_which_knows_of_the_focal_length(database):
    tracker = StarTracker(database, told(3.0), PATIENT)
    for view in frames_of(database, 25, 2):
        assert_within_covariance(tracker.solve(view.xy_px), view)


@pytest.mark.parametrize("error_percent", [-5.0, 5.0])
def test_a_solution_predicts_the_focal_length_of_the_next_frame_too(database, error_percent):
    tracker = StarTracker(database, told(error_percent), PATIENT)
    for view in frames_of(database, 25, 4):
        before = tracker.solve(view.xy_px)
        tracked = tracker.solve(view.xy_px, predicted=before)
        assert tracked.mode == "tracking"
        assert tracked.scale == pytest.approx(before.scale, rel=1e-5)
        assert tracked.focal_length_error == pytest.approx(before.focal_length_error, rel=1e-3)
        assert_within_covariance(tracked, view)


def test_a_tolerance_of_zero_is_the_camera_as_told(database):
    tracker = StarTracker(database, told(0.0, 0.0), PATIENT)
    plain = StarTracker(database, CAMERA, PATIENT)
    for view in frames_of(database, 10, 3):
        one, other = tracker.solve(view.xy_px), plain.solve(view.xy_px)
        assert record(one) == record(other)
        assert (one.scale, one.focal_length_error) == (1.0, 0.0)
        assert one.camera is tracker.camera
        assert not one.focal_length_from_stars


def test_without_a_tolerance_a_camera_5_percent_off_is_not_solved_wrongly(database):
    """It may be solved near the boresight, or not at all; never is it somewhere else."""
    tracker = StarTracker(database, told(5.0, 0.0), PATIENT)
    for view in frames_of(database, 10, 4):
        solution = tracker.solve(view.xy_px)
        if solution.status is Status.SOLVED:
            boresight = separation(solution.attitude.rotation[:, 2], view.rotation[:, 2])
            assert np.degrees(boresight) < 0.5


def test_a_tolerance_costs_evidence_but_not_the_solution(database):
    exact, tolerant = StarTracker(database, CAMERA, PATIENT), StarTracker(
        database, told(0.0), PATIENT
    )
    for view in frames_of(database, 10, 5):
        one, other = exact.solve(view.xy_px), tolerant.solve(view.xy_px)
        assert other.log10_false_alarms > one.log10_false_alarms
        np.testing.assert_array_equal(
            other.identification.catalog_index, one.identification.catalog_index
        )


def test_a_focal_length_beyond_the_tolerance_is_found_rightly_or_not_at_all(database):
    """7 % off with a tolerance of 2 %: the search ends at 2.2 %, the last fit may go on."""
    tracker = StarTracker(database, told(7.0, 2.0), PATIENT)
    for view in frames_of(database, 10, 6):
        solution = tracker.solve(view.xy_px)
        if solution.status is Status.SOLVED:
            assert solution.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=5e-3)
            assert_within_covariance(solution, view)
        else:
            assert_unsolved(solution, solution.status, len(view.xy_px))


@pytest.mark.parametrize("parity", ["normal", "auto"])
def test_noise_is_no_match_with_a_tolerance_either(database, parity):
    camera = dataclasses.replace(told(0.0), parity=parity)
    tracker = StarTracker(database, camera, PATIENT)
    rng = np.random.default_rng(7)
    for n in (4, 5, 6, 8, 10):
        solution = tracker.solve(uniform_noise(CAMERA, n, rng))
        assert_unsolved(solution, Status.NO_MATCH, n)


@pytest.mark.parametrize("parity", ["mirrored", "auto"])
def test_both_parities_find_the_focal_length(database, parity):
    camera = dataclasses.replace(told(4.0), parity=parity)
    tracker = StarTracker(database, camera, PATIENT)
    for view in frames_of(database, 5, 8):
        solution = tracker.solve(view.xy_px * (1, -1) + (0, 512))
        assert (solution.status, solution.parity) == (Status.SOLVED, "mirrored")
        assert solution.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=3e-3)
        assert solution.camera.parity == "mirrored"


def test_a_predicted_attitude_is_followed_with_the_wrong_focal_length(database):
    """0.5 % off, 1.3 px in the corner: the pose is judged as told and then fitted."""
    tracker = StarTracker(database, told(0.5), PATIENT)
    for view in frames_of(database, 5, 9):
        solution = tracker.solve(view.xy_px, predicted=view.rotation)
        assert solution.status is Status.SOLVED
        assert solution.mode == "tracking"
        assert solution.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=3e-3)


def test_the_focal_length_of_a_solution_that_is_used_again_leaves_no_trace(database):
    tracker = StarTracker(database, told(3.0), PATIENT)
    views = frames_of(database, 4, 10)
    fresh = [record(StarTracker(database, told(3.0), PATIENT).solve(v.xy_px)) for v in views]
    for at in (2, 0, 3, 1, 0):
        assert record(tracker.solve(views[at].xy_px)) == fresh[at]


def test_an_image_of_oblong_pixels_keeps_their_ratio(database):
    true = Camera(512, 512, CAMERA.fx_px, 1.05 * CAMERA.fx_px, 250, 260)
    wrong = dataclasses.replace(true.scaled(0.97), tolerance_percent=5.0)
    tracker = StarTracker(database, wrong, PATIENT)
    rng = np.random.default_rng(11)
    solved = 0
    for _ in range(10):
        view = synthetic_field(
            database.catalog, true, random_rotation(rng), rng, Condition(noise_px=NOISE_PX)
        )
        if len(view.xy_px) < 7:
            continue
        camera = tracker.solve(view.xy_px).camera
        assert camera.fx_px == pytest.approx(true.fx_px, rel=3e-3)
        assert camera.fy_px == pytest.approx(true.fy_px, rel=3e-3)
        solved += 1
    assert solved >= 5
