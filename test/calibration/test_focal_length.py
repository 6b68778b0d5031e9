"""The focal length from many frames: the filter alone, and how the node reports and applies it."""

from dataclasses import replace

import numpy as np
import pytest

from star_tracker.calibration.focal_length import BOUND, FocalLengthEstimator
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.maps.simulation import CAMERAS, random_rotation, synthetic_field

CAMERA = CAMERAS["12 deg"]
CATALOG = StarCatalog.paper()


def scaled(camera, factor):
    return replace(camera, fx_px=camera.fx_px * factor, fy_px=camera.fy_px * factor)


def add_frames(estimator, n, seed, *, true=CAMERA, noise_px=0.5):
    """Add frames of a camera, solved with the camera that the estimator says; return how many."""
    rng = np.random.default_rng(seed)
    used = 0
    for _ in range(n):
        frame = synthetic_field(CATALOG, true, random_rotation(rng), rng, noise_px=noise_px)
        used += estimator.add(
            estimator.apply(), frame.xy_px, CATALOG.vectors[frame.catalog_index]
        )
    return used


@pytest.mark.parametrize("factor", [0.98, 1.0, 1.02])
def test_a_wrong_focal_length_is_found_within_its_standard_error(factor):
    """30 frames of 0.5 px: one has 0.07 % (half of the 0.13 % of 1 px), 30 have 0.013 %."""
    estimator = FocalLengthEstimator(scaled(CAMERA, factor))
    assert add_frames(estimator, 30, 1) >= 25
    estimate = estimator.estimate
    error = estimate.value_px / CAMERA.focal_length_px - 1
    claimed = estimate.standard_error_px / CAMERA.focal_length_px
    assert abs(error) < 4 * claimed
    assert claimed < 2e-4
    assert abs(estimator.apply().focal_length_px / CAMERA.focal_length_px - 1) < 1e-3
    assert estimate.drift == pytest.approx(1 / factor - 1, abs=1e-3)


def test_the_stated_errors_are_those_of_many_runs():
    """Of 40 runs 95 % lie within 1.96 standard errors; 33 is 3 sigma of the binomial below."""
    within = 0
    for seed in range(40):
        estimator = FocalLengthEstimator(CAMERA)
        add_frames(estimator, 8, 100 + seed)
        e = estimator.estimate
        within += abs(e.value_px - CAMERA.focal_length_px) < 1.96 * e.standard_error_px
    assert within >= 33


def test_a_frame_that_disagrees_is_left_out():
    estimator = FocalLengthEstimator(CAMERA)
    add_frames(estimator, 10, 2)
    before = estimator.estimate
    assert add_frames(estimator, 3, 3, true=scaled(CAMERA, 1.03)) == 0
    assert estimator.estimate.n_left_out == before.n_left_out + 3
    assert estimator.estimate.value_px == before.value_px


def test_a_lens_that_has_moved_is_followed_after_many_frames():
    estimator = FocalLengthEstimator(CAMERA)
    add_frames(estimator, 10, 4)
    moved = scaled(CAMERA, 1.03)
    add_frames(estimator, 40, 5, true=moved)
    assert estimator.apply().fx_px == pytest.approx(moved.fx_px, rel=1e-3)


def test_what_is_out_of_bounds_is_never_followed():
    estimator = FocalLengthEstimator(CAMERA)
    assert add_frames(estimator, 30, 6, true=scaled(CAMERA, 1 + 1.6 * BOUND)) == 0
    assert estimator.apply() == CAMERA


@pytest.mark.parametrize("n", [0, 2, 4])
def test_few_stars_are_left_out(n):
    estimator = FocalLengthEstimator(CAMERA)
    frame = synthetic_field(CATALOG, CAMERA, random_rotation(np.random.default_rng(7)),
                            np.random.default_rng(7))
    index = frame.catalog_index[:n]
    assert not estimator.add(CAMERA, frame.xy_px[:n], CATALOG.vectors[index])
    assert estimator.estimate.n_left_out == 1


def test_equal_stars_are_left_out():
    """Six times the same star determines nothing."""
    estimator = FocalLengthEstimator(CAMERA)
    star = CAMERA.vectors([[300.0, 200.0]])
    assert not estimator.add(CAMERA, np.tile([[300.0, 200.0]], (6, 1)), np.tile(star, (6, 1)))


def test_nothing_known_nothing_applied():
    estimator = FocalLengthEstimator(CAMERA)
    assert estimator.apply() == CAMERA
    assert estimator.estimate.drift == 0
    assert estimator.estimate.standard_error_px == pytest.approx(
        BOUND / 2 * CAMERA.focal_length_px
    )
