"""The whole path: how frames end, what is reported, and what is refused."""

import math
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from star_tracker.attitude.attitude import covariance
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.ended import MIN_STARS
from star_tracker.identification.engine import Results
from star_tracker.identification.labels import StarState
from star_tracker.identification.searcher import Searcher
from star_tracker.maps.simulation import (
    CAMERAS,
    CONDITIONS,
    Condition,
    frames,
    random_rotation,
    synthetic_field,
    uniform_noise,
    visible_stars,
)
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

CAMERA = Camera.from_fov(12, 512, 512)
PATIENT = SolveSettings(deadline_ms=math.inf)
THRESHOLD = PATIENT.max_log10_false_alarms
ARCSEC = np.pi / 180 / 3600


@pytest.fixture(scope="module")
def tracker(database):
    return StarTracker(database, CAMERA, PATIENT)


@pytest.fixture(scope="module")
def frame(database):
    """A frame of 0.2 px noise with more than ten stars, and the truth."""
    rng = np.random.default_rng(1)
    rotation = rotation_from_boresight(1.9, 0.6, 0.3)
    return synthetic_field(database.catalog, CAMERA, rotation, rng, noise_px=0.2)


@pytest.fixture(scope="module")
def map1():
    return paper_maps((1,))[0]


def catalog_at(xy_px, rotation):
    vectors = CAMERA.vectors(xy_px) @ rotation.T
    none = np.zeros(len(vectors), np.int64)
    return StarCatalog(vectors, np.full(len(vectors), 4.0), none, none)


def assert_unsolved(solution, status, n):
    assert solution.status is status
    assert solution.attitude is None
    assert solution.wrong_probability == 1.0
    assert (solution.method, solution.parity) == ("", "")
    assert math.isnan(solution.rms_px)
    np.testing.assert_array_equal(solution.identification.catalog_index, np.full(n, -1))
    np.testing.assert_array_equal(solution.identification.state, np.zeros(n))
    assert np.isnan(solution.identification.residual_px).all()
    assert len(solution.identification.residual_px) == n


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
    """Three of the 2 k coordinates went into the rotation, so 2 k - 3 residuals are free."""
    solution = tracker.solve(frame.xy_px)
    stars = CAMERA.vectors(frame.xy_px)[solution.identification.identified]
    k = len(stars)
    sigma_px = solution.rms_px * np.sqrt(k / (2 * k - 3))
    expected = covariance(stars, sigma_px / CAMERA.focal_length_px)
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


@pytest.mark.parametrize(
    ("score", "rival", "expected"),
    [
        (3.5, -math.inf, 10**-3.5 / (1 + 10**-3.5)),
        (3.5, -2.0, (10**-3.5 + 10**-5.5) / (1 + 10**-3.5 + 10**-5.5)),
        (3.5, 3.5, (1 + 10**-3.5) / (2 + 10**-3.5)),
        (0.0, -math.inf, 0.5),
        (-400.0, -math.inf, 1.0),
        (400.0, 380.0, 1e-20),
        (400.0, -math.inf, 0.0),
    ],
    ids=[
        "enough", "with a weak rival", "with an equal rival", "as likely as not", "hopeless",
        "beyond doubt, with a rival", "beyond doubt",
    ],
)
def test_probability_of_being_wrong(score, rival, expected):
    """Bayes' theorem for three explanations: this pose, its best rival and none."""
    results = Results.blank(1)
    results.progress["score"], results.progress["rival_score"] = score, rival
    searcher = Searcher(CAMERA, StarCatalog.paper(), None, results)
    assert searcher.wrong_probability == pytest.approx(expected, rel=1e-9, abs=1e-290)


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
    view = synthetic_field(database.catalog, camera, rotation, rng, noise_px=0.2)
    solution = StarTracker(database, camera, PATIENT).solve(view.xy_px)
    np.testing.assert_array_equal(solution.identification.catalog_index, view.catalog_index)
    # 0.2 px over some twenty stars.
    assert separation(solution.attitude.rotation[:, 2], rotation[:, 2]) < 1.0 / focal


def test_false_stars_and_missing_stars_are_borne(database, tracker, frame):
    rng = np.random.default_rng(5)
    view = synthetic_field(
        database.catalog, CAMERA, frame.rotation, rng,
        noise_px=0.3, missing=0.2, false_stars=1.0,
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


def test_a_frame_of_too_many_centroids_is_bad_input(database):
    tracker = StarTracker(database, CAMERA, SolveSettings(max_centroids=20))
    solution = tracker.solve(uniform_noise(CAMERA, 21, np.random.default_rng(6)))
    assert_unsolved(solution, Status.BAD_INPUT, 21)
    assert solution.reason == (
        "21 centroids are more than max_centroids 20: raise the detector's threshold"
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
    database = FeatureDatabase.build(catalog_at(places, rotation_from_boresight(1, -0.5, 2)))
    solution = StarTracker(database, CAMERA, PATIENT).solve(frame.xy_px)
    assert_unsolved(solution, Status.NO_MATCH, len(frame.xy_px))


def test_hypotheses_that_led_to_no_candidate_are_counted_too():
    """Pairs are compared, and fit, even where no three of them form a figure."""
    rotation = rotation_from_boresight(1, -0.5, 2)
    database = FeatureDatabase.build(catalog_at([(100.0, 100), (300, 100)], rotation))
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
    database = FeatureDatabase.build(catalog_at([(100.0, 100), (300, 100)], rotation))
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


# Brightness


def intensity_of(view):
    """A linear intensity of arbitrary scale for the measured magnitudes of a frame."""
    return 1e4 * 10 ** (-0.4 * view.v_mag)


def test_no_intensities_are_as_none(tracker, frame):
    assert record(tracker.solve(frame.xy_px, None)) == record(tracker.solve(frame.xy_px))


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, -math.inf])
def test_intensities_that_are_all_unknown_are_as_none(tracker, frame, value):
    unknown = np.full(len(frame.xy_px), value)
    assert record(tracker.solve(frame.xy_px, unknown)) == record(tracker.solve(frame.xy_px))


@pytest.mark.parametrize("value", [0.0, -5.0, -math.inf, math.inf])
def test_an_intensity_that_is_not_positive_and_finite_counts_as_unknown(tracker, frame, value):
    intensity = intensity_of(frame)
    intensity[::3] = math.nan
    expected = record(tracker.solve(frame.xy_px, intensity))
    intensity[::3] = value
    assert record(tracker.solve(frame.xy_px, intensity)) == expected


def test_intensities_that_agree_with_the_catalogue_are_evidence(tracker, frame):
    without, with_them = tracker.solve(frame.xy_px), tracker.solve(
        frame.xy_px, intensity_of(frame)
    )
    assert with_them.log10_false_alarms < without.log10_false_alarms
    np.testing.assert_array_equal(
        with_them.identification.catalog_index, without.identification.catalog_index
    )


@pytest.mark.parametrize("seed", range(5))
def test_intensities_that_mean_nothing_cost_half_of_the_evidence_at_most(tracker, frame, seed):
    without = tracker.solve(frame.xy_px)
    shuffled = np.random.default_rng(seed).permutation(intensity_of(frame))
    solution = tracker.solve(frame.xy_px, shuffled)
    assert solution.status is Status.SOLVED
    assert solution.log10_false_alarms < without.log10_false_alarms + math.log10(2) + 1e-9
    np.testing.assert_array_equal(
        solution.identification.catalog_index, without.identification.catalog_index
    )


@pytest.mark.parametrize("scale", [1e-6, 3.0, 1e9])
def test_intensities_are_on_any_linear_scale(tracker, frame, scale):
    one, other = (
        tracker.solve(frame.xy_px, k * intensity_of(frame)) for k in (1.0, scale)
    )
    assert other.log10_false_alarms == pytest.approx(one.log10_false_alarms, abs=1e-6)
    np.testing.assert_array_equal(
        other.identification.catalog_index, one.identification.catalog_index
    )


def test_intensities_belong_to_their_centroids_in_any_order(tracker, frame):
    order = np.random.default_rng(15).permutation(len(frame.xy_px))
    one = tracker.solve(frame.xy_px, intensity_of(frame))
    other = tracker.solve(frame.xy_px[order], intensity_of(frame)[order])
    assert other.log10_false_alarms == pytest.approx(one.log10_false_alarms, abs=1e-9)


def test_intensities_of_centroids_that_are_left_out_are_left_out_too(tracker, frame):
    one = tracker.solve(frame.xy_px, intensity_of(frame))
    other = tracker.solve(
        np.insert(frame.xy_px, 2, math.nan, axis=0), np.insert(intensity_of(frame), 2, 7e9)
    )
    assert other.log10_false_alarms == one.log10_false_alarms


def test_intensities_may_be_a_list_and_are_not_changed(tracker, frame):
    intensity = intensity_of(frame)
    kept = intensity.copy()
    one = tracker.solve(frame.xy_px, intensity)
    np.testing.assert_array_equal(intensity, kept)
    assert record(tracker.solve(frame.xy_px, intensity.tolist())) == record(one)


@pytest.mark.parametrize(
    ("intensity", "shape"),
    [
        (np.ones(4), "(4,)"), (np.ones(6), "(6,)"), (np.ones(0), "(0,)"),
        (np.ones((5, 1)), "(5, 1)"), (np.ones((1, 5)), "(1, 5)"), (7.0, "()"),
    ],
)
def test_intensities_of_another_shape_are_the_callers_mistake(tracker, intensity, shape):
    text = f"intensities have shape {shape}: give one for each of 5 centroids"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        tracker.solve(np.full((5, 2), 100.0), intensity)


def test_one_number_is_no_intensity_of_one_centroid(tracker):
    text = "intensities have shape (): give one for each of 1 centroids"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        tracker.solve([(100.0, 100.0)], 7.0)


# What a tracker keeps


def record(solution):
    """All that a solution says but the time it took, bit by bit."""
    i, a = solution.identification, solution.attitude
    arrays = [i.catalog_index, i.state, i.residual_px]
    if a is not None:
        arrays += [a.quaternion_xyzw, a.covariance_rad2, a.ra_rad, a.dec_rad, a.roll_rad]
    return (
        solution.status, solution.reason, solution.method, solution.parity,
        solution.n_hypotheses, solution.n_ignored,
        *(np.asarray(x).tobytes() for x in (
            *arrays, solution.wrong_probability, solution.log10_false_alarms, solution.rms_px,
        )),
    )


@pytest.fixture(scope="module")
def many(database):
    """50 frames of 12 deg: all conditions in turn, and noise."""
    rng = np.random.default_rng(16)
    found = [
        next(frames(database.catalog, CAMERA, condition, 1, 100 * seed + at)).xy_px
        for seed in range(4) for at, condition in enumerate(CONDITIONS)
    ][:44]
    return [*found, *(uniform_noise(CAMERA, n, rng) for n in (0, 3, 4, 5, 8, 12))]


@pytest.mark.parametrize("parity", ["normal", "auto"])
def test_a_tracker_used_again_is_as_a_new_one(database, many, parity):
    """Votes, poses and labels of one frame leave no trace in the next, in whatever order."""
    camera = CAMERA.with_parity(parity)
    fresh = [record(StarTracker(database, camera, PATIENT).solve(xy)) for xy in many]
    assert len({status for status, *_ in fresh}) >= 3
    tracker = StarTracker(database, camera, PATIENT)
    for seed in (17, 18):
        for at in np.random.default_rng(seed).permutation(len(many)).tolist():
            assert record(tracker.solve(many[at])) == fresh[at]


def test_a_frame_that_was_cut_off_leaves_no_trace_either(database, frame):
    tracker = StarTracker(database, CAMERA, SolveSettings(deadline_ms=1e-6))
    expected = record(tracker.solve(frame.xy_px))
    assert tracker.solve(
        uniform_noise(CAMERA, 30, np.random.default_rng(19))
    ).status is Status.TIMEOUT
    assert record(tracker.solve(frame.xy_px)) == expected


def test_two_trackers_share_a_database(database, many):
    """Of two cameras, frame by frame in turn, and as if each were alone."""
    cameras = CAMERA, CAMERA.with_parity("mirrored")
    settings = SolveSettings(method="match_group", deadline_ms=math.inf)
    alone = [
        [record(tracker.solve(xy)) for xy in many[::3]]
        for tracker in (StarTracker(database, camera, settings) for camera in cameras)
    ]
    both = [StarTracker(database, camera, settings) for camera in cameras]
    in_turn = [[record(tracker.solve(xy)) for tracker in both] for xy in many[::3]]
    assert [list(one) for one in zip(*in_turn, strict=True)] == alone


def test_trackers_of_two_threads_share_a_database(database, many):
    """The interpreter's lock is released in the search: they run at the same time."""
    expected = [record(StarTracker(database, CAMERA, PATIENT).solve(xy)) for xy in many]

    def solve_all(_):
        tracker = StarTracker(database, CAMERA, PATIENT)
        return [record(tracker.solve(xy)) for xy in many]

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(solve_all, range(2))) == [expected, expected]


def test_the_order_of_the_centroids_never_changes_a_label(tracker, many):
    rng = np.random.default_rng(21)
    for xy in many:
        first, order = tracker.solve(xy), rng.permutation(len(xy))
        second = tracker.solve(xy[order])
        assert second.status is first.status
        for name in ("catalog_index", "state"):
            np.testing.assert_array_equal(
                getattr(second.identification, name), getattr(first.identification, name)[order]
            )


# Parity


@pytest.mark.parametrize("true", ["normal", "mirrored"])
def test_parity_auto_finds_both_parities(database, map1, true):
    xy = map1.xy_px if true == "mirrored" else map1.xy_px * (1, -1) + (0, 512)
    definite = StarTracker(database, map1.camera.with_parity(true), PATIENT).solve(xy)
    found = StarTracker(database, map1.camera.with_parity("auto"), PATIENT).solve(xy)
    assert found.status is Status.SOLVED
    assert found.parity == definite.parity == true
    np.testing.assert_array_equal(
        database.catalog.number[found.identification.catalog_index], map1.star_number
    )
    np.testing.assert_array_equal(
        found.attitude.quaternion_xyzw, definite.attitude.quaternion_xyzw
    )


def test_both_parities_are_compared_and_neither_is_charged(database, map1):
    """The score is evidence: searching more of the sky, or its mirror image, does not lower it."""
    xy = map1.xy_px
    definite = StarTracker(database, map1.camera, PATIENT).solve(xy)
    found = StarTracker(database, map1.camera.with_parity("auto"), PATIENT).solve(xy)
    assert found.n_hypotheses > definite.n_hypotheses
    assert found.log10_false_alarms == definite.log10_false_alarms


def test_the_wrong_parity_is_no_match(database, map1):
    tracker = StarTracker(database, map1.camera.with_parity("normal"), PATIENT)
    assert_unsolved(tracker.solve(map1.xy_px), Status.NO_MATCH, len(map1.xy_px))


def test_the_rotation_is_proper_in_both_parities(database, map1):
    solution = StarTracker(database, map1.camera, PATIENT).solve(map1.xy_px)
    assert np.linalg.det(solution.attitude.rotation) == pytest.approx(1)


#: A figure that is its own mirror image about the line y = 256, and how its outer stars may be
#: displaced: measured badly, but as badly in the mirror.
TRAPEZIUM = np.array([(150.0, 150), (150, 362), (350, 200), (350, 312)])
STRETCH = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
#: Displacements for which the figure is good enough, but not certain.
STRETCHES_PX = [0.0, 0.3, 0.5, 0.7, 0.9, 1.1, 1.2]
#: One more star, on the line, and displacements along it that leave no line of symmetry.
KITE = np.concatenate([TRAPEZIUM, [(420.0, 256)]])
SKEW = np.array([(0.0, 1.0), (0, 1), (0, -1), (0, -1), (0, 0)])


#: Frames whose mirror image passes for another place of the sky with 10^3 to 10^5 to one: camera,
#: seed, stars. One in 500 does.
MIRRORED_LOOK_ALIKES = [("20 deg", 154, 57)]


def tracker_of_figure(figure, parity):
    database = FeatureDatabase.build(catalog_at(figure, rotation_from_boresight(1, 0.5, 2)))
    return StarTracker(database, CAMERA.with_parity(parity), PATIENT)


def in_a_mirror(xy_px):
    return np.asarray(xy_px) * (1, -1) + (0, CAMERA.height_px)


@pytest.mark.parametrize("stretch_px", STRETCHES_PX)
@pytest.mark.parametrize("parity", ["normal", "mirrored"])
def test_a_symmetric_figure_is_solved_where_the_parity_is_known(parity, stretch_px):
    """Its mirror image fits exactly as well, which is no reason to doubt the parity given."""
    solution = tracker_of_figure(TRAPEZIUM, parity).solve(TRAPEZIUM + stretch_px * STRETCH)
    assert solution.status is Status.SOLVED
    # The case that follows needs a hypothesis that is good, but not certain.
    assert -8 < solution.log10_false_alarms < THRESHOLD


@pytest.mark.parametrize("stretch_px", STRETCHES_PX)
def test_a_symmetric_figure_is_ambiguous_where_the_parity_is_not_known(stretch_px):
    solution = tracker_of_figure(TRAPEZIUM, "auto").solve(TRAPEZIUM + stretch_px * STRETCH)
    assert_unsolved(solution, Status.AMBIGUOUS, 4)
    assert solution.log10_false_alarms < THRESHOLD
    assert solution.reason == (
        "the sky and its mirror image fit about as well: set parity to normal or mirrored"
    )


@pytest.mark.parametrize("skew_px", [1.0, 1.5, 2.0, 3.0])
def test_a_figure_whose_mirror_image_fits_better_is_refused_with_the_remedy(skew_px):
    """Seen in a mirror, it fits the sky as such badly, but well enough to be accepted."""
    figure = KITE + skew_px * SKEW
    solution = tracker_of_figure(figure, "normal").solve(in_a_mirror(figure))
    assert solution.status is Status.AMBIGUOUS
    assert -8 < solution.log10_false_alarms < THRESHOLD
    assert solution.reason == "the mirror image of the sky fits better: set parity to mirrored"
    followed = tracker_of_figure(figure, "mirrored").solve(in_a_mirror(figure))
    assert (followed.status, followed.parity) == (Status.SOLVED, "mirrored")


def test_a_refused_frame_keeps_no_labels_of_the_mirror_image():
    figure = KITE + 2.0 * SKEW
    solution = tracker_of_figure(figure, "normal").solve(in_a_mirror(figure))
    assert_unsolved(solution, Status.AMBIGUOUS, 5)


@pytest.mark.parametrize("skew_px", [1.0, 2.0, 4.0])
def test_of_two_parities_that_both_fit_the_better_one_wins(skew_px):
    """Also if the other one is looked at first: that is off by pixels, 10^4 times less likely."""
    figure = KITE + skew_px * SKEW
    solution = tracker_of_figure(figure, "auto").solve(in_a_mirror(figure))
    assert (solution.status, solution.parity) == (Status.SOLVED, "mirrored")
    np.testing.assert_array_equal(solution.identification.catalog_index, np.arange(5))


def test_a_figure_that_the_sky_has_twice_is_ambiguous():
    """Four stars without symmetry, in two places that are far apart."""
    figure = np.array([(120.0, 140), (180, 380), (350, 210), (300, 330)])
    places = [
        catalog_at(figure, rotation_from_boresight(*angles)).vectors
        for angles in ((1.0, 0.5, 2.0), (4.0, -0.3, 5.0))
    ]
    once, twice = (
        FeatureDatabase.build(StarCatalog(
            vectors, np.full(len(vectors), 4.0), *np.zeros((2, len(vectors)), np.int64)
        ))
        for vectors in (places[0], np.concatenate(places))
    )
    assert StarTracker(once, CAMERA, PATIENT).solve(figure).status is Status.SOLVED
    solution = StarTracker(twice, CAMERA, PATIENT).solve(figure)
    assert_unsolved(solution, Status.AMBIGUOUS, 4)
    assert solution.reason == "two attitudes fit about as well"


@pytest.mark.parametrize(("name", "seed", "n"), MIRRORED_LOOK_ALIKES)
def test_a_whole_sky_seen_in_a_mirror_is_refused_and_the_reason_says_so(database, name, seed, n):
    """Lines of stars are their own mirror image: some of the sky's pass for another place."""
    view = next(frames(database.catalog, CAMERAS[name], Condition("mirror", 0.5), 1, seed))
    assert len(view.xy_px) == n
    tracker = StarTracker(database, CAMERAS[name].with_parity("mirrored"), PATIENT)
    solution = tracker.solve(view.xy_px)
    assert solution.log10_false_alarms < THRESHOLD
    assert solution.reason == "the mirror image of the sky fits better: set parity to normal"
    assert_unsolved(solution, Status.AMBIGUOUS, n)


@pytest.mark.parametrize(("name", "missing"), [("12 deg", 0.6), ("20 deg", 0.85)])
def test_a_sky_of_few_stars_seen_in_a_mirror_is_refused(database, name, missing):
    """60 frames of 0.5 px noise and 4 to 15 stars; where the mirror is seen through, it is said.

    None of them shows a figure of the sky as it is told to be.
    """
    camera = CAMERAS[name].with_parity("mirrored")
    tracker = StarTracker(database, camera, PATIENT)
    rng = np.random.default_rng(20)
    n_refused = 0
    while n_refused < 60:
        view = synthetic_field(
            database.catalog, CAMERAS[name], random_rotation(rng), rng,
            noise_px=0.5, missing=missing,
        )
        if not 4 <= len(view.xy_px) <= 15:
            continue
        solution = tracker.solve(view.xy_px)
        assert solution.status in {Status.NO_MATCH, Status.AMBIGUOUS}
        if solution.status is Status.AMBIGUOUS:
            assert "set parity to normal" in solution.reason
        n_refused += 1


def test_an_asymmetric_figure_of_the_same_quality_is_solved_by_its_lead():
    """One star more, off the axis of symmetry, and only one of the parities fits it."""
    figure = np.concatenate([TRAPEZIUM, [(250.0, 420)]])
    database = FeatureDatabase.build(catalog_at(figure, rotation_from_boresight(1, 0.5, 2)))
    tracker = StarTracker(database, CAMERA.with_parity("auto"), PATIENT)
    solution = tracker.solve(figure)
    assert (solution.status, solution.parity) == (Status.SOLVED, "normal")
    np.testing.assert_array_equal(solution.identification.catalog_index, np.arange(5))


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


def folding_lens(edge_px):
    """A 512 px camera whose lens shows nothing beyond `edge_px` from its axis.

    r (1 - 0.3 r^2) has its largest value, 0.7027, at r = 1.054.
    """
    focal = edge_px / 0.7027
    lens = Distortion("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0))
    return Camera(512, 512, focal, focal, 256, 256, "normal", lens)


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


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (
            {"method": "guess"},
            "method 'guess' is unknown: use auto, match_group, radial_cyclic",
        ),
        ({"centroid_sigma_px": -0.1}, "centroid_sigma_px must be from 0 to 100"),
        ({"centroid_sigma_px": math.nan}, "centroid_sigma_px must be from 0 to 100"),
        ({"centroid_sigma_px": 100.1}, "centroid_sigma_px must be from 0 to 100"),
        ({"displaced_gate_px": -1.0}, "displaced_gate_px must be from 0 to 1000"),
        ({"displaced_gate_px": math.nan}, "displaced_gate_px must be from 0 to 1000"),
        ({"max_log10_false_alarms": 0.5}, "max_log10_false_alarms must be from -100 to 0"),
        ({"max_log10_false_alarms": -math.inf}, "max_log10_false_alarms must be from -100 to 0"),
        ({"deadline_ms": 0.0}, "deadline_ms must be greater than 0"),
        ({"deadline_ms": math.nan}, "deadline_ms must be greater than 0"),
        ({"max_centroids": 3}, "max_centroids must be at least 4"),
    ],
)
def test_settings_out_of_range_are_refused(options, text):
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        SolveSettings(**options)


@pytest.mark.parametrize("tolerances", [(), (2.0, 0.0), (math.nan,), (101.0,)])
def test_pair_tolerances_out_of_range_are_refused(tolerances):
    text = "^pair_tolerance_px needs one or more values from 0.01 to 100$"
    with pytest.raises(ValueError, match=text):
        MatchGroupSettings(pair_tolerance_px=tolerances)


@pytest.mark.parametrize("options", [{"companions": 0}, {"companions": -1}, {"cells": 0}])
def test_a_matcher_that_could_find_nothing_is_refused(options):
    (name,) = options
    with pytest.raises(ValueError, match=name):
        MatchGroupSettings(**options)


def test_settings_at_the_ends_of_their_ranges_are_allowed():
    SolveSettings(
        match_group=MatchGroupSettings(pair_tolerance_px=(0.01, 100.0)), displaced_gate_px=0.0,
        max_log10_false_alarms=0.0, deadline_ms=math.inf, max_centroids=MIN_STARS,
    )


def test_a_stricter_threshold_is_obeyed(database, frame):
    """A hypothesis that is good enough by default is none where -100 is asked."""
    _, pixels = visible_stars(database.catalog, CAMERA, frame.rotation)
    xy = pixels[:6] + np.random.default_rng(12).normal(0, 0.3, (6, 2))
    assert StarTracker(database, CAMERA, PATIENT).solve(xy).status is Status.SOLVED
    strict = SolveSettings(max_log10_false_alarms=-100.0, deadline_ms=math.inf)
    solution = StarTracker(database, CAMERA, strict).solve(xy)
    assert_unsolved(solution, Status.NO_MATCH, 6)
    assert solution.log10_false_alarms < THRESHOLD
