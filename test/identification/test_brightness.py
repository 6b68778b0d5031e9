"""Intensities: what they add to a whole frame's evidence, and what they cannot spoil."""

import math
import re

import numpy as np
import pytest
from engines import CAMERA, PLACES, ROTATION, Bench, catalog_of, match_lists, of_brightness
from solutions import intensity_of, record

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.brightness import with_brightness, write_magnitudes
from star_tracker.maps.simulation import uniform_noise
from star_tracker.solution import Status


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


@pytest.mark.parametrize("n", [6, 7])
def test_intensities_that_agree_with_the_catalogue_are_evidence(tracker, frame, n):
    without, with_them = tracker.solve(frame.xy_px[:n]), tracker.solve(
        frame.xy_px[:n], intensity_of(frame)[:n]
    )
    assert -40 < with_them.log10_false_alarms < without.log10_false_alarms < -8
    np.testing.assert_array_equal(
        with_them.identification.catalog_index, without.identification.catalog_index
    )


def test_a_frame_whose_places_leave_no_doubt_has_no_need_of_them(tracker, frame):
    without, with_them = tracker.solve(frame.xy_px), tracker.solve(
        frame.xy_px, intensity_of(frame)
    )
    assert with_them.log10_false_alarms == pytest.approx(without.log10_false_alarms, rel=1e-12)
    assert without.log10_false_alarms < -60


def test_magnitudes_of_intensities():
    magnitude = np.empty(3)
    write_magnitudes(np.array([100.0, 0.0, 1.0]), 3, magnitude)
    np.testing.assert_allclose(magnitude, [-5, math.nan, 0])


@pytest.mark.parametrize("shuffled", [False, True])
@pytest.mark.parametrize(("n_false", "plenty"), [(0, 40.0), (60, 0.8 * 70)])
def test_more_evidence_of_places_is_never_less_in_all(shuffled, n_false, plenty):
    rng = np.random.default_rng(5)
    v_mag = rng.uniform(1, 6, 10)
    bench = Bench(FeatureDatabase.build(
        catalog_of(CAMERA.vectors(PLACES) @ ROTATION.T, v_mag)
    ))
    seen = np.concatenate([rng.permutation(v_mag) if shuffled else v_mag, np.full(n_false, 6.0)])
    bench.show(np.concatenate([PLACES, uniform_noise(CAMERA, n_false, rng)]), 10 ** (-0.4 * seen))
    assert bench.matched()[0][:10] == list(range(10))
    lists = match_lists(bench.matches)[:2]
    places = np.arange(-20.0, 100.0, 0.25)
    both = np.array([
        with_brightness(score, bench.frame, v_mag, lists, 10) for score in places
    ])
    assert np.all(np.diff(both) >= 0)
    np.testing.assert_array_equal(both[places >= plenty], places[places >= plenty])
    below = both[places < plenty]
    assert np.all(below <= plenty)
    if shuffled:
        assert np.all(below >= places[places < plenty] - math.log10(2) - 1e-9)
    else:
        assert np.all(below > places[places < plenty])


@pytest.mark.parametrize("seed", range(5))
def test_intensities_that_mean_nothing_cost_half_of_the_evidence_at_most(tracker, frame, seed):
    without = tracker.solve(frame.xy_px)
    shuffled = np.random.default_rng(seed).permutation(intensity_of(frame))
    solution = tracker.solve(frame.xy_px, shuffled)
    assert solution.status is Status.SOLVED
    assert solution.log10_false_alarms < without.log10_false_alarms + math.log10(2) + 1e-5
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


@pytest.mark.parametrize("others", [1e-3, 1e3], ids=["fainter", "brighter"])
def test_among_points_that_are_all_alike_nothing_else_is_beyond_belief(others):
    """At best a match is as rare as one in all, and half of that: any pose has some such match."""
    v_mag = np.array([2.0, 3.0, 4.0, 5.0])
    magnitude = np.concatenate([v_mag - 14.0, np.full(400, -2.5 * math.log10(others) - 12.0)])
    four = np.arange(4)
    evidence = of_brightness(magnitude, v_mag, four, four, 4)
    assert 0 < evidence < 4 * math.log10(2 * len(magnitude))


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 8), marks=pytest.mark.slow)])
@pytest.mark.parametrize("others", [1.0, 1e7], ids=["fainter", "brighter"])
def test_few_points_among_many_that_are_all_alike_make_no_pose_of_noise_certain(
    tracker, others, seeds
):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        xy_px = rng.uniform(0, 512, (420, 2))
        flux = np.concatenate([10 ** rng.uniform(2, 4, 20), np.full(400, others)])
        assert tracker.solve(xy_px, flux).status is not Status.SOLVED
