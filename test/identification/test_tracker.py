"""The whole path: how frames end, what is reported, and what is refused."""

import copy
import math
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from engines import CAMERA, database_at, folding_lens
from scipy.stats import chi2, f
from solutions import PATIENT, THRESHOLD, assert_unsolved, record

from star_tracker.attitude.attitude import covariance
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation
from star_tracker.identification.labels import StarState
from star_tracker.maps.simulation import (
    CAMERAS,
    Condition,
    random_rotation,
    synthetic_field,
    uniform_noise,
    visible_stars,
)
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

ARCSEC = np.pi / 180 / 3600


# Solved frames


def test_a_frame_is_solved_and_every_star_named(tracker, frame):
    solution = tracker.solve(frame.xy_px)
    assert solution.status is Status.SOLVED
    assert solution.reason == "identified"
    assert solution.method == "match_group"
    np.testing.assert_array_equal(solution.identification.catalog_index, frame.catalog_index)


def test_the_attitude_rotates_camera_vectors_onto_their_stars(tracker, database, frame):
    solution = tracker.solve(frame.xy_px)
    stars = database.catalog.vectors[solution.identification.catalog_index]
    found = CAMERA.vectors(frame.xy_px) @ solution.attitude.rotation.T
    # Five standard deviations of 0.2 px.
    assert np.max(separation(found, stars)) < 5 * 0.2 / CAMERA.focal_length_px


def test_the_covariance_is_that_of_the_noise_seen_in_the_frame(tracker, frame):
    """Three of the 2 k coordinates went into the rotation, so 2 k - 3 residuals are free.

    Few of them may be small by chance: the bound of F takes that of chi-square's place.
    """
    solution = tracker.solve(frame.xy_px)
    stars = CAMERA.vectors(frame.xy_px)[solution.identification.identified]
    k = len(stars)
    variance_px2 = k * solution.rms_px**2 / (2 * k - 3)
    variance_px2 *= 3 * f.ppf(0.99, 3, 2 * k - 3) / chi2.ppf(0.99, 3)
    assert solution.centroid_sigma_px == pytest.approx(np.sqrt(variance_px2), rel=1e-9)
    expected = covariance(stars, solution.centroid_sigma_px / CAMERA.focal_length_px)
    np.testing.assert_allclose(solution.attitude.covariance_rad2, expected, rtol=1e-9)


def test_the_attitude_is_within_its_own_covariance(tracker, frame):
    attitude = tracker.solve(frame.xy_px).attitude
    error = attitude.rotation.T @ frame.rotation
    small = np.array([error[2, 1], error[0, 2], error[1, 0]])
    assert small @ np.linalg.solve(attitude.covariance_rad2, small) < 21  # 0.9999 of chi2 of 3


def test_boresight_and_roll_are_those_of_the_frame(tracker, frame):
    attitude = tracker.solve(frame.xy_px).attitude
    sigma = 0.2 / CAMERA.focal_length_px
    assert attitude.ra_rad == pytest.approx(1.9, abs=4 * sigma)
    assert attitude.dec_rad == pytest.approx(0.6, abs=4 * sigma)
    assert attitude.roll_rad == pytest.approx(0.3, abs=4 * sigma / 0.05)


def test_rms_is_that_of_the_identified_stars(tracker, frame):
    solution = tracker.solve(frame.xy_px)
    residual = solution.identification.residual_px[solution.identification.identified]
    assert solution.rms_px == pytest.approx(np.sqrt(np.mean(residual**2)))


def test_a_frame_without_rivals_is_wrong_as_often_as_it_alarms_falsely(tracker, frame):
    solution = tracker.solve(frame.xy_px)
    assert solution.log10_false_alarms < -10
    assert solution.wrong_probability == pytest.approx(10**solution.log10_false_alarms)


def test_the_order_of_the_centroids_does_not_matter(tracker, frame):
    first = tracker.solve(frame.xy_px)
    order = np.random.default_rng(2).permutation(len(frame.xy_px))
    second = tracker.solve(frame.xy_px[order])
    for name in ("catalog_index", "state"):
        np.testing.assert_array_equal(
            getattr(second.identification, name), getattr(first.identification, name)[order]
        )
    np.testing.assert_allclose(
        second.identification.residual_px, first.identification.residual_px[order], atol=1e-8
    )
    np.testing.assert_allclose(second.attitude.rotation, first.attitude.rotation, atol=1e-12)


def test_a_solution_read_late_is_that_of_its_own_frame(tracker, frame):
    first, again = tracker.solve(frame.xy_px), tracker.solve(frame.xy_px)
    assert again.attitude is again.attitude  # read before another frame comes
    other = tracker.solve(frame.xy_px[2:])
    assert record(first) == record(again) != record(other)


@pytest.mark.parametrize("copied", [
    copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)), replace,
], ids=["copy", "deepcopy", "pickle", "replace"])
def test_a_solution_that_nobody_has_read_can_be_copied(tracker, frame, copied):
    assert record(copied(tracker.solve(frame.xy_px))) == record(tracker.solve(frame.xy_px))


def test_solutions_are_compared_as_the_things_that_they_are(tracker, frame):
    one, other = tracker.solve(frame.xy_px), tracker.solve(frame.xy_px)
    assert one == one  # noqa: PLR0124
    assert len({one, other, one}) == 2


@pytest.mark.parametrize("copied", [
    copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)),
], ids=["deepcopy", "pickle"])
def test_a_tracker_is_copied_as_what_it_was_made_with(tracker, frame, copied):
    assert record(copied(tracker).solve(frame.xy_px)) == record(tracker.solve(frame.xy_px))


@pytest.mark.parametrize("nothing", [[], (), np.array([]), np.empty((0, 2))])
def test_a_list_of_no_star_is_a_frame_with_too_few(tracker, nothing):
    assert tracker.solve(nothing).status is Status.TOO_FEW_STARS


def test_what_is_masked_is_no_centroid(tracker, frame):
    masked = np.ma.masked_array(frame.xy_px, np.zeros(frame.xy_px.shape, bool))
    masked[0] = np.ma.masked
    plain = frame.xy_px.copy()
    plain[0] = np.nan
    assert record(tracker.solve(masked)) == record(tracker.solve(plain))


def test_complex_numbers_are_refused(tracker, frame):
    with pytest.raises(ValueError, match="real numbers, not complex ones"):
        tracker.solve(frame.xy_px + 1j)


def test_a_solution_names_what_it_does_not_have(tracker, frame):
    with pytest.raises(AttributeError, match=r"^'Solution' object has no attribute 'atitude'$"):
        tracker.solve(frame.xy_px).atitude  # noqa: B018


def test_a_second_frame_is_not_influenced_by_the_first(tracker, frame):
    first = tracker.solve(frame.xy_px)
    tracker.solve(uniform_noise(CAMERA, 6, np.random.default_rng(3)))
    second = tracker.solve(frame.xy_px)
    np.testing.assert_array_equal(
        second.attitude.quaternion_xyzw, first.attitude.quaternion_xyzw
    )


@pytest.mark.parametrize("kind", [list, np.float32, np.float64])
def test_centroids_may_be_lists_or_arrays_of_single_precision(tracker, frame, kind):
    xy = frame.xy_px.tolist() if kind is list else frame.xy_px.astype(kind)
    np.testing.assert_array_equal(
        tracker.solve(xy).identification.catalog_index, frame.catalog_index
    )


def test_the_callers_array_is_not_changed(tracker, frame):
    xy = frame.xy_px.copy()
    tracker.solve(xy)
    np.testing.assert_array_equal(xy, frame.xy_px)


def test_a_frame_of_a_distorting_lens_is_solved(database):
    lens = Distortion("plumb_bob", (-0.25, 0.1, 0.001, -0.0005, 0.0))
    focal = CAMERA.fx_px
    camera = Camera(1024, 768, focal, 1.02 * focal, 500, 400, "mirrored", lens)
    rng = np.random.default_rng(4)
    rotation = random_rotation(rng)
    view = synthetic_field(database.catalog, camera, rotation, rng, Condition(noise_px=0.2))
    solution = StarTracker(database, camera, PATIENT).solve(view.xy_px)
    np.testing.assert_array_equal(solution.identification.catalog_index, view.catalog_index)
    # 0.2 px over some twenty stars.
    assert separation(solution.attitude.rotation[:, 2], rotation[:, 2]) < 1.0 / focal


def test_false_stars_and_missing_stars_are_borne(database, tracker, frame):
    rng = np.random.default_rng(5)
    view = synthetic_field(
        database.catalog, CAMERA, frame.rotation, rng,
        Condition(noise_px=0.3, missing=0.2, false_stars=1.0)
    )
    solution = tracker.solve(view.xy_px)
    assert solution.status is Status.SOLVED
    named = solution.identification.identified
    np.testing.assert_array_equal(
        solution.identification.catalog_index[named], view.catalog_index[named]
    )
    assert separation(solution.attitude.rotation[:, 2], frame.rotation[:, 2]) < 60 * ARCSEC


# Centroids that are left out


@pytest.mark.parametrize(
    "bad",
    [
        (math.nan, 100.0), (100.0, math.nan), (math.inf, 100.0), (100.0, -math.inf),
        (-26.0, 100.0), (100.0, 538.0),
    ],
)
def test_centroids_not_finite_or_outside_are_ignored_in_their_place(tracker, frame, bad):
    xy = np.insert(frame.xy_px, [0, 3], bad, axis=0)
    solution = tracker.solve(xy)
    assert solution.status is Status.SOLVED
    assert solution.n_ignored == 2
    expected = np.insert(frame.catalog_index, [0, 3], -1)
    np.testing.assert_array_equal(solution.identification.catalog_index, expected)
    ignored = expected == -1
    assert (solution.identification.state[ignored] == StarState.UNIDENTIFIED).all()
    assert np.isnan(solution.identification.residual_px[ignored]).all()


def test_ignored_centroids_change_nothing_for_the_others(tracker, frame):
    clean = tracker.solve(frame.xy_px)
    dirty = tracker.solve(np.concatenate([frame.xy_px, [(math.nan, math.nan)]]))
    np.testing.assert_array_equal(dirty.attitude.quaternion_xyzw, clean.attitude.quaternion_xyzw)
    assert clean.n_ignored == 0


def test_a_centroid_a_little_outside_counts(tracker, frame):
    """The paper's map 3 has a star at y = 513.7 of 512 px; 5 % of the image are allowed."""
    xy = np.concatenate([frame.xy_px, [(-25.0, 100.0), (100.0, 537.0)]])
    assert tracker.solve(xy).n_ignored == 0


# Unsolved frames


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_stars(tracker, frame, n):
    solution = tracker.solve(frame.xy_px[:n])
    assert_unsolved(solution, Status.TOO_FEW_STARS, n)
    assert solution.reason == f"{n} stars, at least 4 are needed"
    assert solution.log10_false_alarms == math.inf


def test_too_few_stars_are_left_when_the_others_are_ignored(tracker, frame):
    xy = frame.xy_px.copy()
    xy[3:] = np.nan
    solution = tracker.solve(xy)
    assert_unsolved(solution, Status.TOO_FEW_STARS, len(xy))
    assert solution.reason == "3 stars, at least 4 are needed"
    assert solution.n_ignored == len(xy) - 3


@pytest.mark.parametrize("value", [math.nan, 1e9])
def test_a_frame_without_any_usable_centroid_is_bad_input(tracker, value):
    solution = tracker.solve(np.full((5, 2), value))
    assert_unsolved(solution, Status.BAD_INPUT, 5)
    assert solution.n_ignored == 5
    assert solution.reason == (
        "all 5 centroids are non-finite or outside of the 512 x 512 px image: "
        "check the camera's size and the detector"
    )


def test_of_too_many_centroids_the_brightest_are_searched(database, frame):
    """The true stars first, by their intensities, and then a crowd of faint false ones."""
    n, crowd = len(frame.xy_px), uniform_noise(CAMERA, 500, np.random.default_rng(6))
    tracker = StarTracker(database, CAMERA, SolveSettings(max_centroids=n + 20))
    order = np.random.default_rng(7).permutation(n + 500)
    xy = np.concatenate([frame.xy_px, crowd])[order]
    intensity = np.concatenate([np.full(n, 100.0), np.linspace(1.0, 2.0, 500)])[order]
    intensity[order == n + 3] = np.nan
    solution = tracker.solve(xy, intensity)
    assert solution.status is Status.SOLVED
    assert (solution.n_surplus, solution.n_ignored) == (480, 0)
    found = solution.identification
    assert len(found.catalog_index) == n + 500
    true = np.full(n + 500, -1)
    true[:n] = frame.catalog_index
    np.testing.assert_array_equal(found.catalog_index[order < n], true[order][order < n])


def test_of_too_many_centroids_without_brightness_an_even_sample_is_searched(database, frame):
    """Each centroid twice, side by side: every second one is as good as all."""
    n = len(frame.xy_px)
    tracker = StarTracker(database, CAMERA, SolveSettings(max_centroids=n))
    xy = np.concatenate([np.repeat(frame.xy_px, 2, axis=0), np.full((3, 2), np.nan)])
    solution = tracker.solve(xy)
    assert solution.status is Status.SOLVED
    assert (solution.n_surplus, solution.n_ignored) == (n, 3)
    assert len(solution.identification.state) == 2 * n + 3


def test_those_that_are_not_finite_take_no_room(database, frame):
    n = len(frame.xy_px)
    tracker = StarTracker(database, CAMERA, SolveSettings(max_centroids=n))
    solution = tracker.solve(np.concatenate([np.full((50, 2), np.inf), frame.xy_px]))
    assert solution.status is Status.SOLVED
    assert (solution.n_surplus, solution.n_ignored) == (0, 50)
    np.testing.assert_array_equal(
        solution.identification.catalog_index[50:], frame.catalog_index
    )


def test_as_many_centroids_as_allowed_are_searched(database, frame):
    n = len(frame.xy_px)
    tracker = StarTracker(database, CAMERA, SolveSettings(max_centroids=n, deadline_ms=math.inf))
    assert tracker.solve(frame.xy_px).status is Status.SOLVED


def test_noise_is_no_match(tracker):
    solution = tracker.solve(uniform_noise(CAMERA, 10, np.random.default_rng(7)))
    assert_unsolved(solution, Status.NO_MATCH, 10)
    assert solution.log10_false_alarms > THRESHOLD
    assert solution.n_hypotheses > 1000
    assert solution.reason == (
        f"the best of {solution.n_hypotheses} hypotheses has log10 false alarms "
        f"{solution.log10_false_alarms:.1f}"
    )


def test_a_catalogue_of_another_sky_is_no_match(frame):
    places = uniform_noise(CAMERA, 12, np.random.default_rng(8))
    database = database_at(places, rotation=rotation_from_boresight(1, -0.5, 2))
    solution = StarTracker(database, CAMERA, PATIENT).solve(frame.xy_px)
    assert_unsolved(solution, Status.NO_MATCH, len(frame.xy_px))


def test_hypotheses_that_led_to_no_candidate_are_counted_too():
    """Pairs are compared, and fit, even where no three of them form a figure."""
    rotation = rotation_from_boresight(1, -0.5, 2)
    database = database_at([(100.0, 100), (300, 100)], rotation=rotation)
    # A square whose side is the one separation of the catalogue.
    solution = StarTracker(database, CAMERA, PATIENT).solve(
        [(150, 150), (350, 150), (350, 350), (150, 350)]
    )
    assert solution.status is Status.NO_MATCH
    assert solution.n_hypotheses > 0


def test_a_search_that_takes_too_long_is_a_timeout(database):
    tracker = StarTracker(database, CAMERA, SolveSettings(deadline_ms=1e-6))
    solution = tracker.solve(uniform_noise(CAMERA, 10, np.random.default_rng(9)))
    assert_unsolved(solution, Status.TIMEOUT, 10)
    assert solution.reason == (
        f"deadline 1e-06 ms passed, the best of {solution.n_hypotheses} hypotheses has "
        f"log10 false alarms {solution.log10_false_alarms:.1f}"
    )


def test_a_timeout_looks_at_the_clock_where_no_candidate_turns_up_too():
    rotation = rotation_from_boresight(1, -0.5, 2)
    database = database_at([(100.0, 100), (300, 100)], rotation=rotation)
    tracker = StarTracker(database, CAMERA, SolveSettings(deadline_ms=1e-6))
    solution = tracker.solve(uniform_noise(CAMERA, 10, np.random.default_rng(10)))
    assert_unsolved(solution, Status.TIMEOUT, 10)


@pytest.mark.parametrize(
    ("n", "statuses"),
    [
        (0, {Status.TOO_FEW_STARS}), (1, {Status.TOO_FEW_STARS}), (3, {Status.TOO_FEW_STARS}),
        (4, {Status.NO_MATCH}),
        (300, {Status.NO_MATCH, Status.TIMEOUT}), (1000, {Status.NO_MATCH, Status.TIMEOUT}),
    ],
)
def test_noise_of_any_size_ends_without_a_solution(database, n, statuses):
    """A full search of hundreds of points takes seconds: theirs may be cut off, not that of 4."""
    deadline_ms = math.inf if n <= 4 else SolveSettings().deadline_ms
    tracker = StarTracker(database, CAMERA, SolveSettings(deadline_ms=deadline_ms))
    solution = tracker.solve(uniform_noise(CAMERA, n, np.random.default_rng(13)))
    assert solution.status in statuses
    assert_unsolved(solution, solution.status, n)
    assert solution.solve_ms < 1000 + SolveSettings().deadline_ms


@pytest.mark.parametrize("n", [40, 300])
@pytest.mark.parametrize("name", CAMERAS)
def test_a_short_deadline_ends_a_frame_full_of_false_stars(database, name, n):
    """Of 5 ms. The limit here is that of a machine that is busy with other things."""
    tracker = StarTracker(
        database, CAMERAS[name], SolveSettings(method="match_group", deadline_ms=5.0)
    )
    solution = tracker.solve(uniform_noise(CAMERAS[name], n, np.random.default_rng(14)))
    assert solution.status in {Status.TIMEOUT, Status.NO_MATCH}
    assert_unsolved(solution, solution.status, n)
    assert solution.solve_ms < 1000


def test_a_stricter_threshold_is_obeyed(database, frame):
    """A hypothesis that is good enough by default is none where -100 is asked."""
    _, pixels = visible_stars(database.catalog, CAMERA, frame.rotation)
    xy = pixels[:6] + np.random.default_rng(12).normal(0, 0.3, (6, 2))
    assert StarTracker(database, CAMERA, PATIENT).solve(xy).status is Status.SOLVED
    strict = SolveSettings(max_log10_false_alarms=-100.0, deadline_ms=math.inf)
    solution = StarTracker(database, CAMERA, strict).solve(xy)
    assert_unsolved(solution, Status.NO_MATCH, 6)
    assert solution.log10_false_alarms < THRESHOLD


# Refusals


@pytest.mark.parametrize(
    ("centroids", "shape"),
    [
        (np.zeros(4), "(4,)"),
        (np.zeros((5, 3)), "(5, 3)"),
        (np.zeros((2, 5)), "(2, 5)"),
        (np.zeros((1, 5, 2)), "(1, 5, 2)"),
        (7.0, "()"),
    ],
)
def test_an_array_of_another_shape_is_the_callers_mistake(tracker, centroids, shape):
    text = f"centroids have shape {shape}: give an array (n, 2) of x, y"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        tracker.solve(centroids)


@pytest.mark.parametrize("edge_px", [200.0, 370.0], ids=["in the image", "past its corners"])
def test_a_lens_that_cannot_be_inverted_never_makes_solve_raise(database, edge_px):
    """Only an array of another shape does. The lens is refused earlier or the frame is not used.

    The second lens reaches the image's corners, 362 px away, but not all of its 5 % margin.
    """
    try:
        tracker = StarTracker(database, folding_lens(edge_px), SolveSettings(deadline_ms=50))
    except ValueError:
        return
    xy = uniform_noise(CAMERA, 8, np.random.default_rng(11))
    for corner in ((1.0, 1.0), (-20.0, -20.0)):
        assert tracker.solve(np.concatenate([xy, [corner]])).status is not Status.SOLVED
