"""Frames of cameras whose field of view is not known."""

import math
import re
from dataclasses import dataclass

import numpy as np
import pytest
from engines import catalog_of
from solutions import PATIENT, assert_unsolved, record

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status

NOISE_PX = 0.3
N_NOISE = 200


@dataclass(frozen=True)
class Step:
    """A step of a ladder for images of 512 px."""

    fov_min_deg: float
    fov_max_deg: float
    database: FeatureDatabase
    width_px: int = 512
    height_px: int = 512


def brightest(catalog, n):
    order = np.argsort(catalog.v_mag, kind="stable")[:n]
    return catalog_of(np.ascontiguousarray(catalog.vectors[order]), catalog.v_mag[order])


@pytest.fixture(scope="module")
def steps(database):
    """Some 17 guide stars in the middle field of each."""
    half = FeatureDatabase.build(brightest(database.catalog, 2450))
    return [Step(10.0, 14.2, database), Step(14.2, 20.0, half)]


@pytest.fixture(scope="module")
def any_tracker(steps):
    return AnyCameraTracker(steps, PATIENT)


def frames_of(step, fov_deg, n, seed, **options):
    """Frames with eight stars and more of a camera of a step, and the camera."""
    camera, rng, found = Camera.from_fov(fov_deg, 512, 512), np.random.default_rng(seed), []
    while len(found) < n:
        view = synthetic_field(
            step.database.catalog, camera, random_rotation(rng), rng,
            Condition(noise_px=NOISE_PX, **options),
        )
        if len(view.xy_px) >= 8:
            found.append(view)
    return camera, found


@pytest.mark.parametrize(("fov_deg", "at"), [
    (10.3, 0), (12.0, 0), (14.0, 0), (14.4, 1), (17.0, 1), (19.7, 1),
])
def test_one_tracker_finds_attitude_and_field_of_view_of_any_camera(
    any_tracker, steps, fov_deg, at
):
    camera, views = frames_of(steps[at], fov_deg, 6, round(10 * fov_deg))
    for view in views:
        solution = any_tracker.solve(view.xy_px)
        assert solution.status is Status.SOLVED
        assert solution.parity == "normal"
        boresight = separation(solution.attitude.rotation[:, 2], view.rotation[:, 2])
        assert boresight < 4 * NOISE_PX / camera.focal_length_px
        assert solution.focal_length_from_stars
        off = math.log(solution.camera.fx_px / camera.fx_px)
        assert abs(off) < 5 * solution.focal_length_error < 0.02
        assert solution.camera.fov_deg == pytest.approx(fov_deg, rel=0.01)


def test_the_solution_says_the_catalogue_that_it_counts_in(any_tracker, steps):
    for at, fov_deg in enumerate((11.0, 18.0)):
        _, views = frames_of(steps[at], fov_deg, 5, 40 + at)
        for view in views:
            solution = any_tracker.solve(view.xy_px)
            named = solution.identification.identified
            # A shallower catalogue than the step's own may be the first to solve it.
            assert len(named) >= 5
            stars = solution.catalog.vectors[solution.identification.catalog_index[named]]
            true = steps[at].database.catalog.vectors[view.catalog_index[named]]
            assert np.max(separation(stars, true)) < 1e-9
            assert any(solution.catalog is step.database.catalog for step in steps)


@pytest.mark.parametrize("parity", ["auto", "mirrored"])
def test_the_parity_is_found_or_told(steps, parity):
    tracker = AnyCameraTracker(steps, PATIENT, parity=parity)
    camera, views = frames_of(steps[1], 17.0, 4, 50)
    for view in views:
        solution = tracker.solve(view.xy_px * (1, -1) + (0, 512))
        assert (solution.status, solution.parity) == (Status.SOLVED, "mirrored")
        assert solution.camera.fx_px == pytest.approx(camera.fx_px, rel=0.01)
        boresight = separation(solution.attitude.rotation[:, 2], view.rotation[:, 2])
        assert boresight < 4 * NOISE_PX / camera.focal_length_px


def test_a_sky_in_a_mirror_is_not_solved_where_the_parity_is_told_wrongly(steps):
    tracker = AnyCameraTracker(steps, PATIENT, parity="normal")
    _, views = frames_of(steps[0], 12.0, 4, 60)
    for view in views:
        solution = tracker.solve(view.xy_px * (1, -1) + (0, 512))
        assert solution.status in {Status.NO_MATCH, Status.AMBIGUOUS}


def test_false_and_missing_stars_are_borne(any_tracker, steps):
    camera, views = frames_of(steps[0], 12.0, 5, 70, missing=0.2, false_stars=0.3)
    for view in views:
        solution = any_tracker.solve(view.xy_px)
        if solution.status is Status.SOLVED:
            boresight = separation(solution.attitude.rotation[:, 2], view.rotation[:, 2])
            assert boresight < 4 * NOISE_PX / camera.focal_length_px
    solved = [any_tracker.solve(view.xy_px).status is Status.SOLVED for view in views]
    assert sum(solved) >= 4


@pytest.mark.slow
def test_noise_is_never_solved(any_tracker):
    """200 frames; a threshold of 10^-3 false alarms allows for 0.2 over all scales and skies.

    Each may take 100 ms: what is not solved until then is not solved wrongly either.
    """
    rng = np.random.default_rng(8)
    for n in rng.integers(4, 16, N_NOISE).tolist():
        solution = any_tracker.solve(uniform_noise(Camera.from_fov(12, 512, 512), n, rng),
                                     deadline_ms=100.0)
        assert solution.status in {Status.NO_MATCH, Status.TIMEOUT}
        assert_unsolved(solution, solution.status, n)


def test_a_small_frame_of_noise_is_searched_to_the_end(any_tracker):
    solution = any_tracker.solve(
        uniform_noise(Camera.from_fov(12, 512, 512), 4, np.random.default_rng(9))
    )
    assert_unsolved(solution, Status.NO_MATCH, 4)
    assert solution.reason == (
        f"the best of {solution.n_hypotheses} hypotheses has log10 false alarms "
        f"{solution.log10_false_alarms:.1f}"
    )


def test_frames_leave_no_trace_in_each_other(steps, any_tracker):
    views = frames_of(steps[0], 12.0, 2, 80)[1] + frames_of(steps[1], 17.0, 2, 81)[1]
    fresh = [record(AnyCameraTracker(steps, PATIENT).solve(v.xy_px)) for v in views]
    for at in (3, 0, 2, 1, 0):
        assert record(any_tracker.solve(views[at].xy_px)) == fresh[at]


# Refusals


def test_a_ladder_without_steps_is_refused():
    with pytest.raises(ValueError, match=r"^a ladder needs at least one step$"):
        AnyCameraTracker([])


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_stars(any_tracker, n):
    solution = any_tracker.solve(np.full((n, 2), 100.0))
    assert_unsolved(solution, Status.TOO_FEW_STARS, n)
    assert solution.reason == f"{n} stars, at least 4 are needed"


def test_of_too_many_centroids_a_sample_is_searched(steps):
    tracker = AnyCameraTracker(steps, SolveSettings(max_centroids=10, deadline_ms=math.inf))
    solution = tracker.solve(np.random.default_rng(1).random((31, 2)) * 512)
    assert_unsolved(solution, Status.NO_MATCH, 31)
    assert (solution.n_surplus, solution.n_ignored) == (21, 0)


def test_a_frame_without_any_usable_centroid_is_bad_input(any_tracker):
    solution = any_tracker.solve(np.full((5, 2), np.nan))
    assert_unsolved(solution, Status.BAD_INPUT, 5)
    assert solution.reason == (
        "all 5 centroids are non-finite or outside of the 512 x 512 px image: "
        "check the camera's size and the detector"
    )


@pytest.mark.parametrize(("arguments", "text"), [
    ((np.zeros((5, 3)),), "centroids have shape (5, 3): give an array (n, 2) of x, y"),
    ((np.zeros((5, 2)), np.ones(4)),
     "intensities have shape (4,): give one for each of 5 centroids"),
])
def test_an_array_of_another_shape_is_the_callers_mistake(any_tracker, arguments, text):
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        any_tracker.solve(*arguments)


@pytest.mark.parametrize("deadline_ms", [0.0, -1.0, math.nan])
def test_a_deadline_that_is_not_above_0_is_refused(any_tracker, deadline_ms):
    text = f"deadline_ms is {deadline_ms}: it must be greater than 0"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        any_tracker.solve(np.zeros((5, 2)), deadline_ms=deadline_ms)


def test_an_unknown_parity_is_refused(steps):
    text = "parity 'left' is unknown: use normal, mirrored, auto"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        AnyCameraTracker(steps, parity="left")


def test_the_brightest_of_many_centroids_are_searched_first(steps, any_tracker):
    """Fainter ones, of which no guide star is any, are in nobody's way, and have their rows."""
    camera, (view,) = frames_of(steps[0], 13.0, 1, 5)
    rng, n = np.random.default_rng(5), len(view.xy_px)
    xy = np.concatenate([uniform_noise(camera, 300, rng), view.xy_px])
    intensity = np.concatenate([rng.uniform(1.0, 10.0, 300), rng.uniform(20.0, 900.0, n)])
    solution = any_tracker.solve(xy, intensity)
    assert solution.status is Status.SOLVED
    assert separation(solution.attitude.rotation[:, 2], view.rotation[:, 2]) < math.radians(0.05)
    assert len(solution.identification.state) == 300 + n
    assert (solution.identification.identified >= 300).all()
    assert (solution.n_surplus, solution.n_ignored) == (0, 0)
