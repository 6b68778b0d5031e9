"""The judge of hypotheses: which stars are matched, how strong that is, the pose that remains."""

import math

import numpy as np
import pytest
from engines import CAMERA, PLACES, ROTATION, Bench, catalog_of, database_at

from star_tracker.attitude.wahba import wahba
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation
from star_tracker.identification.evidence import scale_prior
from star_tracker.identification.fallback import Candidate
from star_tracker.maps.simulation import random_rotation, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion


def bench_at(guides, observed, camera=CAMERA, *, seen_by=None, intensity=None, **options):
    """Guide stars at places in the image of a camera, and a frame, of another one if told."""
    bench = Bench(database_at(guides, camera, **options), seen_by or camera)
    bench.show(observed, intensity)
    return bench


def matched(guides, observed, camera=CAMERA, gate_px=4.0):
    """Association: guide star of each row of the input, squared residuals, how many inside."""
    return bench_at(guides, observed, camera).matched(gate_px=gate_px)


def judged(guides, observed, n, tolerance_px=2.0, **options):
    """The hypothesis that the first n rows of the input are guide stars 0, 1, ..."""
    return bench_at(guides, observed, **options).judge(range(n), range(n), tolerance_px)


# Association


def test_each_star_is_matched_with_its_guide_star():
    order = np.random.default_rng(1).permutation(10)
    guide, residual2, inside = matched(PLACES, PLACES[order])
    assert guide == order.tolist()
    np.testing.assert_allclose(residual2, 0, atol=1e-18)
    assert inside == 10


@pytest.mark.parametrize(("off_px", "guide"), [(3.99, 4), (4.01, -1)])
def test_matches_are_within_the_gate(off_px, guide):
    observed = PLACES.copy()
    observed[4] += (0.6 * off_px, -0.8 * off_px)
    found, residual2, _ = matched(PLACES, observed)
    assert found[4] == guide
    assert guide == -1 or residual2[4] == pytest.approx(off_px**2)


def test_two_centroids_at_one_guide_star_and_the_reverse_are_matched_one_to_one():
    double = np.concatenate([PLACES, [PLACES[4] + (0, 1.4)]])
    assert matched(PLACES, double)[0] == [*range(10), -1]
    assert matched(double, PLACES)[0] == list(range(10))


def test_a_star_whose_nearest_guide_star_has_a_nearer_one_stays_alone():
    """Centroids at 0 and 3 px, guide stars at 1 and far away: 1 is nearer to 0."""
    guides = np.concatenate([PLACES, [(300.0, 150)]])
    observed = np.concatenate([PLACES, [(299.0, 150), (302, 150)]])
    assert matched(guides, observed)[0] == [*range(11), -1]


def crowds(n_guides, n_observed):
    """Frames of unrelated stars with gates, and their matches: distances, guide star of each."""
    rng = np.random.default_rng(n_guides)
    for gate_px in (2.0, 12.0, 60.0):
        guides = uniform_noise(CAMERA, n_guides, rng)
        observed = uniform_noise(CAMERA, n_observed, rng)
        guide, _, inside = matched(guides, observed, gate_px=gate_px)
        assert inside == n_guides
        yield np.linalg.norm(observed[:, None] - guides, axis=2), gate_px, np.array(guide)


CROWDS = [(1, 30), (30, 1), (40, 60), (300, 400)]


@pytest.mark.parametrize(("n_guides", "n_observed"), CROWDS)
def test_each_guide_star_of_a_crowd_is_matched_with_its_nearest_centroid_only(
    n_guides, n_observed
):
    for distance, gate_px, guide in crowds(n_guides, n_observed):
        star = np.flatnonzero(guide >= 0)
        assert len(set(guide[star].tolist())) == len(star)
        assert np.all(distance[star, guide[star]] <= gate_px)
        np.testing.assert_array_equal(distance.argmin(axis=0)[guide[star]], star)
        # None is left out that is each other's nearest.
        nearest = distance.argmin(axis=1)
        mutual = distance.argmin(axis=0)[nearest] == np.arange(n_observed)
        mutual &= distance.min(axis=1) <= gate_px
        np.testing.assert_array_equal(guide[mutual], nearest[mutual])


@pytest.mark.parametrize(("n_guides", "n_observed"), CROWDS[:2])
def test_matches_of_a_crowd_are_each_others_nearest(n_guides, n_observed):
    for distance, gate_px, guide in crowds(n_guides, n_observed):
        nearest = distance.argmin(axis=1)
        mutual = distance.argmin(axis=0)[nearest] == np.arange(n_observed)
        mutual &= distance.min(axis=1) <= gate_px
        np.testing.assert_array_equal(guide, np.where(mutual, nearest, -1))


@pytest.mark.parametrize("lens", [None, Distortion("plumb_bob", (-0.2, 0.05, 0.001, 0, 0))])
def test_guide_stars_inside_the_image_are_counted(lens):
    """10 inside; 2 px and 20 px outside on each side are not, though the nearer may match."""
    outside = np.array([
        (-2.0, 200), (514, 210), (220, -2), (230, 514), (-20, 100), (532, 120), (300, -20),
        (310, 532),
    ])
    camera = Camera(512, 512, 1200.0, 1200.0, 256, 256, distortion=lens)
    guides = np.concatenate([PLACES, outside])
    observed = np.concatenate([PLACES, outside[:4]]) if lens is None else PLACES
    found, _, inside = matched(guides, observed, camera)
    assert inside == 10
    assert found == list(range(len(observed)))


def test_stars_behind_the_camera_are_not_in_the_image():
    behind = FeatureDatabase.build(catalog_of(-CAMERA.vectors(PLACES) @ ROTATION.T))
    bench = Bench(behind)
    bench.show(PLACES)
    assert bench.matched()[2] == 0


def test_a_mirrored_camera_sees_the_mirrored_sky():
    mirrored = CAMERA.with_parity("mirrored")
    assert matched(PLACES, PLACES, mirrored)[0] == list(range(10))
    assert bench_at(PLACES, PLACES, mirrored, seen_by=CAMERA).matched()[0] != list(range(10))


# Verification


def score_of(bench, residual2, n_inside):
    """Log10 of the evidence of rows 0, 1, ... matched with these residuals."""
    return bench.weigh(range(len(residual2)), residual2, n_inside)[1]


def test_a_true_hypothesis_is_beyond_doubt_and_gives_the_rotation():
    bench = bench_at(PLACES, PLACES)
    found = bench.judge(range(10), range(10))
    expected = score_of(bench, np.zeros(10), 10)
    assert expected > 20
    assert found.score == pytest.approx(expected, abs=1e-6)
    assert found.scale == 1.0
    np.testing.assert_allclose(found.rotation, ROTATION, atol=1e-12)


@pytest.mark.parametrize(("n", "certain"), [(10, True), (4, False)])
def test_the_judge_says_whether_a_match_is_certain(n, certain):
    """Evidence of 10^8 is; four stars have 10^5 at the most."""
    bench = bench_at(PLACES[:n], PLACES[:n])
    found = bench.searcher.judge(bench.task, Candidate(bench.places(range(n)), np.arange(n), 2.0))
    assert found == certain == (bench.searcher.score > 8)


def test_of_more_matches_than_there_is_room_for_the_first_are_judged():
    """A matcher may list a centroid with each of several guide stars."""
    bench = bench_at(PLACES, PLACES)
    often = np.tile(np.arange(10), 150)
    assert bench.searcher.judge(bench.task, Candidate(bench.places(often), often, 2.0))


def test_three_matched_stars_bring_in_the_others():
    three, every = (judged(PLACES, PLACES, n) for n in (3, 10))
    assert three.score == pytest.approx(every.score, abs=1e-6)


def test_two_matched_stars_are_enough_to_begin_with():
    np.testing.assert_allclose(judged(PLACES, PLACES, 2).rotation, ROTATION, atol=1e-12)


def test_the_pose_is_fitted_to_all_stars_that_carry_it():
    observed = PLACES + np.random.default_rng(2).normal(0, 0.4, (10, 2))
    bench = bench_at(PLACES, observed)
    found = bench.judge(range(3), range(3), 6.0)
    fitted = wahba(CAMERA.vectors(observed), bench.guides)
    np.testing.assert_allclose(found.rotation, fitted, atol=1e-6)
    residual2 = np.sum((CAMERA.pixels(bench.guides @ fitted) - observed) ** 2, axis=1)
    assert found.score == pytest.approx(score_of(bench, residual2, 10), abs=1e-3)


def test_one_wrong_member_does_not_spoil_a_hypothesis():
    """Guide stars 8 and 9 are exchanged, 139 px: the pose is off by several pixels at first."""
    observed = PLACES + np.random.default_rng(2).normal(0, 0.2, (10, 2))
    exchanged = bench_at(PLACES, observed).judge(range(10), [0, 1, 2, 3, 4, 5, 6, 7, 9, 8], 12.0)
    true = judged(PLACES, observed, 10, 12.0)
    assert separation(exchanged.rotation[:, 2], true.rotation[:, 2]) < 1e-6
    assert exchanged.score == pytest.approx(true.score, abs=0.01)


@pytest.mark.parametrize("n_displaced", [1, 3, 5])
def test_displaced_and_false_and_missing_stars_cost_evidence_but_not_the_pose(n_displaced):
    rng = np.random.default_rng(n_displaced)
    observed = PLACES.copy()
    observed[10 - n_displaced :] += 25
    observed = np.concatenate([observed, uniform_noise(CAMERA, n_displaced, rng)])
    guides = np.concatenate([PLACES, uniform_noise(CAMERA, n_displaced, rng)])
    found, clean = judged(guides, observed, 4), judged(PLACES, PLACES, 4)
    np.testing.assert_allclose(found.rotation, ROTATION, atol=1e-9)
    assert clean.score > found.score > 3


def test_a_match_that_is_off_far_more_than_the_others_does_not_count():
    observed = PLACES + np.random.default_rng(3).normal(0, 0.02, (10, 2))
    with_outlier = observed.copy()
    with_outlier[5] += (3.9, 0)
    bench = bench_at(PLACES, with_outlier)
    found = bench.judge(range(5), range(5))
    places = CAMERA.pixels(bench.guides @ found.rotation)
    # The 0.02 px of ten stars, not the 0.4 px that an outlier in the fit would bring.
    assert np.max(np.abs(np.delete(places - observed, 5, axis=0))) < 0.08


def test_fewer_than_three_stars_in_place_are_no_hypothesis():
    found = judged(PLACES, np.concatenate([PLACES[:2], PLACES[2:] + 60]), 2)
    assert found.score == -math.inf


@pytest.mark.parametrize("rows", [[4, 4], [4], []], ids=["twice the same", "one", "none"])
def test_a_hypothesis_of_one_line_of_sight_is_none(rows):
    bench = bench_at(PLACES, PLACES)
    assert bench.judge(rows, rows).score == -math.inf
    assert not bench.searcher.judge(bench.task, Candidate(np.array(rows), np.array(rows), 2.0))


@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_stars_on_one_line_of_the_image_determine_the_attitude(slope):
    x = np.array([40.0, 130, 190, 300, 420, 500])
    places = np.column_stack([x, 80 + slope * x])
    found = judged(places, places, 6)
    np.testing.assert_allclose(found.rotation, ROTATION, atol=1e-10)
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_a_false_hypothesis_is_likely_chance():
    """Three stars that happen to fit; the frame has 20 more that do not."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        guides, observed = uniform_noise(CAMERA, 23, rng), uniform_noise(CAMERA, 23, rng)
        observed[:3] = guides[:3] + rng.normal(0, 1.0, (3, 2))
        assert judged(guides, observed, 3).score < 3


def test_chance_seldom_looks_unlikely():
    """Two stars are put in place, as a matched pair would; the other 23 are unrelated.

    There are 25^2 pairs of pairs to choose from and more, yet even of the chosen ones hardly one
    in ten reaches a decade of evidence.
    """
    rng = np.random.default_rng(1)
    bench, frames, chances, high = None, 20, 600, 0
    for at in range(chances):
        if at % frames == 0:  # a new sky
            guides = uniform_noise(CAMERA, 25, rng)
            bench = Bench(database_at(guides))
        observed, pair = uniform_noise(CAMERA, 25, rng), rng.permutation(25)[:2]
        observed[:2] = guides[pair]
        bench.show(observed)
        high += bench.judge([0, 1], pair, 12.0).score > 1
    assert high <= 0.1 * chances


def test_guide_stars_out_of_the_image_do_not_count():
    """The same sky seen by a camera that shows a third of it has fewer stars to expect."""
    corner = Camera(300, 300, CAMERA.fx_px, CAMERA.fy_px, 256, 256)
    index = np.flatnonzero((PLACES < 300).all(axis=1))
    bench = bench_at(PLACES, PLACES[index], seen_by=corner)
    found = bench.judge(range(4), index)
    # 4 stars and 4 guide stars, all in place, in a smaller area.
    assert found.score == pytest.approx(score_of(bench, np.zeros(4), 4), abs=1e-6)


def test_brightness_that_fits_is_evidence_and_one_that_does_not_costs_little():
    v_mag = np.array([1.0, 2.5, 4.2, 3.1, 5.0, 1.8, 3.7, 4.4, 2.9, 5.3])
    true = 1e4 * 10 ** (-0.4 * v_mag)
    plain, fits, garbage = (
        judged(PLACES, PLACES, 10, v_mag=v_mag, intensity=intensity).score
        for intensity in (None, true, true[::-1])
    )
    assert fits > plain + 2
    assert plain + 1e-9 >= garbage >= plain - math.log10(2) - 1e-6


def test_verification_works_at_any_attitude_and_over_the_poles():
    rng = np.random.default_rng(11)
    special = [rotation_from_boresight(*np.radians(a)) for a in [(0, 90, 0), (10, -89.9, 5)]]
    for rotation in [*special, *(random_rotation(rng) for _ in range(50))]:
        found = judged(PLACES, PLACES, 4, rotation=rotation)
        np.testing.assert_allclose(found.rotation, rotation, atol=1e-11)
        assert found.score > 20


# The best pose and its rivals


#: Five of the guide stars stand a second time, 75 px away.
TWICE = np.concatenate([PLACES, PLACES[:5] + np.array([60.0, 45.0])])


def test_the_best_pose_stays_and_another_one_is_its_rival():
    """Ten stars in place, and five of them as if they were five others: 0.03 rad off."""
    bench = bench_at(TWICE, PLACES)
    best = bench.judge(range(10), range(10))
    assert bench.searcher.rival_score == -math.inf
    after = bench.judge(range(5), range(10, 15))
    assert after.score == best.score
    np.testing.assert_array_equal(after.rotation, best.rotation)
    assert -2 < bench.searcher.rival_score < best.score


def test_a_better_pose_makes_the_one_before_it_its_rival():
    bench = bench_at(TWICE, PLACES)
    first = bench.judge(range(5), range(10, 15))
    best = bench.judge(range(10), range(10))
    assert best.score > first.score
    assert bench.searcher.rival_score == first.score


def test_the_same_pose_again_is_no_rival():
    bench = bench_at(PLACES, PLACES)
    for rows in (range(10), range(5, 10), range(3)):
        bench.judge(rows, rows)
    assert bench.searcher.rival_score == -math.inf


# A camera that is told with a tolerance


def test_a_match_is_judged_at_the_scale_that_is_told():
    """A hypothesis of the fallback is of separations, so of the told focal length."""
    bench = Bench(database_at(PLACES), CAMERA, prior=scale_prior(5.0))
    bench.show(PLACES)
    found = bench.judge(range(10), range(10))
    assert found.scale == 1.0
    exact = judged(PLACES, PLACES, 10)
    # The told scale has half of the belief.
    assert found.score == pytest.approx(exact.score - math.log10(2), abs=1e-9)
