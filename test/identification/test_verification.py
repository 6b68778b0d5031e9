"""The judge of hypotheses: which stars are matched, how strong that is, the pose that remains."""

import math

import numpy as np
import pytest
from engine_bench import EngineBench, Field

from star_tracker.attitude.wahba import wahba
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation
from star_tracker.identification.fallback import Candidate
from star_tracker.maps.simulation import random_rotation, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

CAMERA = Camera.from_fov(12, 512, 512)
ROTATION = rotation_from_boresight(2.0, 0.4, 1.0)
#: Ten stars at places in the image, far from each other: the truth of most frames here.
PLACES = np.array([
    (60.0, 70), (250, 40), (450, 90), (90, 250), (256, 240), (430, 280), (50, 440), (210, 460),
    (360, 400), (480, 470),
])


def sky_at(xy_px, camera=CAMERA, rotation=ROTATION, *, v_mag=None, seen_by=None):
    """A sky with a guide star for each place in the image of a camera at a rotation."""
    return EngineBench(camera.vectors(xy_px) @ rotation.T, seen_by or camera, v_mag=v_mag)


def hypothesis(xy_px, rows, stars, tolerance_px=2.0, camera=CAMERA):
    """The candidate that these rows of the input are these guide stars."""
    place = np.argsort(Field.at(camera, xy_px).frame.row)
    return Candidate(place[np.asarray(rows, int)], np.asarray(stars, int), tolerance_px)


def truth_of(xy_px, n, tolerance_px=2.0):
    """The hypothesis that row i of the input is guide star i."""
    return hypothesis(xy_px, np.arange(n), np.arange(n), tolerance_px)


def matched(sky, xy_px, rotation=ROTATION, gate_px=4.0):
    """Association at a pose: guide star of each row of the input, squared residuals, inside."""
    guide, residual2, inside = sky.associated(xy_px, rotation, gate_px)
    return guide.tolist(), residual2, inside


# Association


def test_each_star_is_matched_with_its_guide_star():
    order = np.random.default_rng(1).permutation(10)
    guide, residual2, inside = matched(sky_at(PLACES), PLACES[order])
    assert guide == order.tolist()
    np.testing.assert_allclose(residual2, 0, atol=1e-18)
    assert inside == 10


@pytest.mark.parametrize(("off_px", "guide"), [(3.99, 4), (4.01, -1)])
def test_matches_are_within_the_gate(off_px, guide):
    observed = PLACES.copy()
    observed[4] += (0.6 * off_px, -0.8 * off_px)
    found, residual2, _ = matched(sky_at(PLACES), observed)
    assert found[4] == guide
    assert guide == -1 or residual2[4] == pytest.approx(off_px**2)


def test_two_centroids_at_one_guide_star_and_the_reverse_are_matched_one_to_one():
    double = np.concatenate([PLACES, [PLACES[4] + (0, 1.4)]])
    assert matched(sky_at(PLACES), double)[0] == [*range(10), -1]
    assert matched(sky_at(double), PLACES)[0] == list(range(10))


def test_a_star_whose_nearest_guide_star_has_a_nearer_one_stays_alone():
    """Centroids at 0 and 3 px, guide stars at 1 and far away: 1 is nearer to 0."""
    guides = np.concatenate([PLACES, [(300.0, 150)]])
    observed = np.concatenate([PLACES, [(299.0, 150), (302, 150)]])
    assert matched(sky_at(guides), observed)[0] == [*range(11), -1]


def crowds(n_guides, n_observed):
    """Frames of unrelated stars with gates, and their matches: distances, guide star of each."""
    rng = np.random.default_rng(n_guides)
    for gate_px in (2.0, 12.0, 60.0):
        guides = uniform_noise(CAMERA, n_guides, rng)
        observed = uniform_noise(CAMERA, n_observed, rng)
        guide, _, inside = matched(sky_at(guides), observed, gate_px=gate_px)
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


@pytest.mark.parametrize(
    ("n_guides", "n_observed"),
    CROWDS[:2],
)
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
    found, _, inside = matched(sky_at(guides, camera), observed)
    assert inside == 10
    assert found == list(range(len(observed)))


def test_stars_behind_the_camera_are_not_in_the_image():
    opposite = EngineBench(-sky_at(PLACES).vectors, CAMERA)
    assert matched(opposite, PLACES)[2] == 0


def test_a_mirrored_camera_sees_the_mirrored_sky():
    mirrored = CAMERA.with_parity("mirrored")
    assert matched(sky_at(PLACES, mirrored), PLACES)[0] == list(range(10))
    assert matched(sky_at(PLACES, mirrored, seen_by=CAMERA), PLACES)[0] != list(range(10))


# Verification


def test_a_true_hypothesis_is_beyond_doubt_and_gives_the_rotation():
    sky = sky_at(PLACES)
    verified = sky.verify(PLACES, truth_of(PLACES, 10))
    _, expected = sky.strongest(PLACES, range(10), np.zeros(10), 10)
    assert expected > 20
    assert verified.log10_false_alarms == pytest.approx(-expected, abs=1e-6)
    np.testing.assert_allclose(verified.rotation, ROTATION, atol=1e-12)


def test_three_matched_stars_bring_in_the_others():
    three, every = (sky_at(PLACES).verify(PLACES, truth_of(PLACES, n)) for n in (3, 10))
    assert three.log10_false_alarms == pytest.approx(every.log10_false_alarms, abs=1e-6)


def test_two_matched_stars_are_enough_to_begin_with():
    verified = sky_at(PLACES).verify(PLACES, truth_of(PLACES, 2))
    np.testing.assert_allclose(verified.rotation, ROTATION, atol=1e-12)


def test_the_pose_is_fitted_to_all_stars_that_carry_it():
    observed = PLACES + np.random.default_rng(2).normal(0, 0.4, (10, 2))
    sky = sky_at(PLACES)
    verified = sky.verify(observed, truth_of(observed, 3, tolerance_px=6.0))
    fitted = wahba(CAMERA.vectors(observed), sky.vectors)
    np.testing.assert_allclose(verified.rotation, fitted, atol=1e-6)
    residual2 = np.sum((CAMERA.pixels(sky.vectors @ fitted) - observed) ** 2, axis=1)
    _, expected = sky.strongest(observed, range(10), residual2, 10)
    assert verified.log10_false_alarms == pytest.approx(-expected, abs=1e-3)


def test_a_candidate_is_not_changed():
    candidate = truth_of(PLACES, 5)
    before = candidate.observed.copy(), candidate.catalog.copy()
    sky_at(PLACES).verify(PLACES, candidate)
    np.testing.assert_array_equal(candidate.observed, before[0])
    np.testing.assert_array_equal(candidate.catalog, before[1])


def test_one_wrong_member_does_not_spoil_a_hypothesis():
    """Guide stars 8 and 9 are exchanged, 139 px: the pose is off by several pixels at first."""
    observed = PLACES + np.random.default_rng(2).normal(0, 0.2, (10, 2))
    sky = sky_at(PLACES)
    exchanged = hypothesis(observed, np.arange(10), [0, 1, 2, 3, 4, 5, 6, 7, 9, 8], 12.0)
    verified = sky.verify(observed, exchanged)
    true = sky.verify(observed, truth_of(observed, 10, 12.0))
    assert separation(verified.rotation[:, 2], true.rotation[:, 2]) < 1e-6
    assert verified.log10_false_alarms == pytest.approx(true.log10_false_alarms, abs=0.01)


@pytest.mark.parametrize("n_displaced", [1, 3, 5])
def test_displaced_and_false_and_missing_stars_cost_evidence_but_not_the_pose(n_displaced):
    rng = np.random.default_rng(n_displaced)
    observed = PLACES.copy()
    observed[10 - n_displaced :] += 25
    xy = np.concatenate([observed, uniform_noise(CAMERA, n_displaced, rng)])
    guides = np.concatenate([PLACES, uniform_noise(CAMERA, n_displaced, rng)])
    found = sky_at(guides).verify(xy, truth_of(xy, 4))
    clean = sky_at(PLACES).verify(PLACES, truth_of(PLACES, 4))
    np.testing.assert_allclose(found.rotation, ROTATION, atol=1e-9)
    assert clean.log10_false_alarms < found.log10_false_alarms < -3


def test_a_match_that_is_off_far_more_than_the_others_does_not_count():
    observed = PLACES + np.random.default_rng(3).normal(0, 0.02, (10, 2))
    with_outlier = observed.copy()
    with_outlier[5] += (3.9, 0)
    sky = sky_at(PLACES)
    found = sky.verify(with_outlier, truth_of(with_outlier, 5))
    places = CAMERA.pixels(sky.vectors @ found.rotation)
    # The 0.02 px of ten stars, not the 0.4 px that an outlier in the fit would bring.
    assert np.max(np.abs(np.delete(places - observed, 5, axis=0))) < 0.08


def test_fewer_than_three_stars_in_place_are_no_hypothesis():
    xy = np.concatenate([PLACES[:2], PLACES[2:] + 60])
    assert sky_at(PLACES).verify(xy, truth_of(xy, 2)) is None


@pytest.mark.parametrize(
    ("rows", "stars"), [([4, 4], [4, 4]), ([4], [4]), ([], [])],
    ids=["twice the same", "one", "none"],
)
def test_a_hypothesis_of_one_line_of_sight_is_none(rows, stars):
    assert sky_at(PLACES).verify(PLACES, hypothesis(PLACES, rows, stars)) is None


@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_stars_on_one_line_of_the_image_determine_the_attitude(slope):
    x = np.array([40.0, 130, 190, 300, 420, 500])
    places = np.column_stack([x, 80 + slope * x])
    verified = sky_at(places).verify(places, truth_of(places, 6))
    np.testing.assert_allclose(verified.rotation, ROTATION, atol=1e-10)
    assert np.linalg.det(verified.rotation) == pytest.approx(1)


def test_a_false_hypothesis_is_likely_chance():
    """Three stars that happen to fit; the frame has 20 more that do not."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        guides, observed = uniform_noise(CAMERA, 23, rng), uniform_noise(CAMERA, 23, rng)
        observed[:3] = guides[:3] + rng.normal(0, 1.0, (3, 2))
        verified = sky_at(guides).verify(observed, truth_of(observed, 3))
        assert verified is None or verified.log10_false_alarms > -3


def test_chance_seldom_looks_unlikely():
    """Two stars are put in place, as a matched pair would; the other 23 are unrelated.

    There are 25^2 pairs of pairs to choose from and more, yet even of the chosen ones hardly one
    in ten reaches a decade of evidence.
    """
    rng = np.random.default_rng(1)
    chances, low = 600, 0
    for _ in range(chances):
        guides, observed = uniform_noise(CAMERA, 25, rng), uniform_noise(CAMERA, 25, rng)
        observed[:2] = guides[:2]
        verified = sky_at(guides).verify(observed, truth_of(observed, 2, 12.0))
        low += verified is not None and verified.log10_false_alarms < -1
    assert low <= 0.1 * chances


def test_guide_stars_out_of_the_image_do_not_count():
    """The same sky seen by a camera that shows a third of it has fewer stars to expect."""
    corner = Camera(300, 300, CAMERA.fx_px, CAMERA.fy_px, 256, 256)
    index = np.flatnonzero((PLACES < 300).all(axis=1))
    candidate = hypothesis(PLACES[index], np.arange(4), index, camera=corner)
    sky = sky_at(PLACES, seen_by=corner)
    verified = sky.verify(PLACES[index], candidate)
    # 4 stars and 4 guide stars, all in place, in a smaller area.
    _, expected = sky.strongest(PLACES[index], range(4), np.zeros(4), 4)
    assert verified.log10_false_alarms == pytest.approx(-expected, abs=1e-6)


def test_brightness_that_fits_is_evidence_and_one_that_does_not_costs_little():
    v_mag = np.array([1.0, 2.5, 4.2, 3.1, 5.0, 1.8, 3.7, 4.4, 2.9, 5.3])
    sky = sky_at(PLACES, v_mag=v_mag)
    true = 1e4 * 10 ** (-0.4 * v_mag)
    plain, fits, garbage = (
        sky.verify(PLACES, truth_of(PLACES, 10), intensity).log10_false_alarms
        for intensity in (None, true, true[::-1])
    )
    assert fits < plain - 2
    assert plain - 1e-9 <= garbage <= plain + math.log10(2) + 1e-6


def test_verification_works_at_any_attitude_and_over_the_poles():
    rng = np.random.default_rng(11)
    special = [rotation_from_boresight(*np.radians(a)) for a in [(0, 90, 0), (10, -89.9, 5)]]
    for rotation in [*special, *(random_rotation(rng) for _ in range(50))]:
        verified = sky_at(PLACES, rotation=rotation).verify(PLACES, truth_of(PLACES, 4))
        np.testing.assert_allclose(verified.rotation, rotation, atol=1e-11)
        assert verified.log10_false_alarms < -20
