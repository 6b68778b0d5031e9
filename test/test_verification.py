"""The judge of hypotheses and the labels of an accepted frame."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import binom

from star_tracker.attitude import rotation_from_boresight, wahba
from star_tracker.camera import Camera
from star_tracker.catalog import StarCatalog
from star_tracker.field import Candidate, StarField
from star_tracker.spherical import separation
from star_tracker.star_maps import random_rotation, uniform_noise
from star_tracker.verification import (
    Identification,
    StarState,
    Verified,
    label,
    log10_binomial_tail,
    log10_false_alarms,
    verify,
)

CAMERA = Camera.from_fov(12, 512, 512)
ROTATION = rotation_from_boresight(2.0, 0.4, 1.0)
#: Ten stars at places in the image, far from each other: the truth of most frames here.
PLACES = np.array([
    (60.0, 70), (250, 40), (450, 90), (90, 250), (256, 240), (430, 280), (50, 440), (210, 460),
    (360, 400), (480, 470),
])
UNIDENTIFIED, IDENTIFIED, DISPLACED = StarState


def catalog_at(xy_px, camera=CAMERA, rotation=ROTATION):
    """A sky with a guide star for each place in the image of a camera at a rotation."""
    vectors = camera.vectors(xy_px) @ rotation.T
    none = np.zeros(len(vectors), np.int64)
    return StarCatalog(vectors, np.full(len(vectors), 4.0), none, none)


def field_at(xy_px, camera=CAMERA):
    return StarField.from_pixels(camera, np.asarray(xy_px, float))


def truth_of(n, *, tolerance_px=2.0):
    """The hypothesis that observed star i is guide star i."""
    return Candidate(np.arange(n), np.arange(n), tolerance_px)


def labelled(guides, observed, *, gate_px=40.0):
    """Label a frame at the true rotation."""
    verified = Verified(ROTATION, -10.0, 2.0)
    return label(catalog_at(guides), field_at(observed), verified, gate_px)[0]


# Probability


@pytest.mark.parametrize("trials", [1, 3, 20, 400])
@pytest.mark.parametrize("p", [1e-6, 1e-3, 0.03, 0.5, 0.999])
def test_binomial_tail_agrees_with_scipy(trials, p):
    successes = np.unique(np.linspace(1, trials, 12).astype(int))
    expected = binom.logsf(successes - 1, trials, p) / np.log(10)
    usable = expected > -280
    found = log10_binomial_tail(successes, trials, np.full(len(successes), p))
    np.testing.assert_allclose(found[usable], expected[usable], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("successes", "trials", "p"), [(150, 200, 1e-5), (60, 60, 1e-6), (300, 1000, 1e-3)]
)
def test_binomial_tail_too_small_for_a_float_is_bounded_from_above(successes, trials, p):
    """The union bound exceeds the tail's largest term by no more than (1 - p)^-(n - k)."""
    terms = np.arange(successes, trials + 1)
    exact = logsumexp(binom.logpmf(terms, trials, p)) / np.log(10)
    assert exact < -308
    bound = float(log10_binomial_tail(np.array([successes]), trials, np.array([p]))[0])
    slack = -(trials - successes) * np.log1p(-p) / np.log(10)
    assert exact - 1e-9 * abs(exact) <= bound <= exact + slack + 1e-9 * abs(exact)


def test_binomial_tail_by_hand():
    """At least 2 of 3 with p = 0.1: 3 * 0.01 * 0.9 + 0.001 = 0.028."""
    assert 10 ** log10_binomial_tail(np.array([2]), 3, np.array([0.1])) == pytest.approx(0.028)


def test_a_certain_event_has_probability_one():
    np.testing.assert_array_equal(log10_binomial_tail(np.array([1, 5]), 5, np.ones(2)), 0)


def test_false_alarms_of_three_perfect_matches_by_hand():
    """Five stars, four guide stars, residuals 0: the radius is the floor of 0.15 px."""
    p = 4 * np.pi * 0.15**2 / 512**2
    expected = np.log10(1 - (1 - p) ** 3) + np.log10(5)
    found = log10_false_alarms(np.zeros(3), 5, 4, 512.0**2)
    np.testing.assert_allclose(found, [expected], rtol=1e-9)


def test_false_alarms_widen_the_residual_for_the_fitted_pose():
    """Four matches within 1 px: sqrt(8 / 5) px are taken, and 2 of the other 4 stars needed."""
    p = 10 * np.pi * (np.sqrt(8 / 5) + 0.15) ** 2 / 512**2
    found = log10_false_alarms(np.array([0.1, 0.2, 0.3, 1.0]), 6, 10, 512.0**2)
    assert found[1] == pytest.approx(float(binom.logsf(1, 4, p)) / np.log(10) + np.log10(6))


def test_false_alarms_never_exceed_one_for_each_number_of_matches():
    found = log10_false_alarms(np.full(10, 1e4), 12, 50, 512.0**2)
    np.testing.assert_allclose(found, np.log10(12))


def test_more_matches_of_the_same_residual_are_less_likely_chance():
    found = log10_false_alarms(np.full(10, 1.0), 12, 12, 512.0**2)
    assert np.all(np.diff(found) < 0)


def test_chance_seldom_looks_unlikely():
    """10^-1 false alarms or fewer are to be expected in at most a tenth of unrelated frames."""
    rng = np.random.default_rng(1)
    chances = 600
    low = 0
    for _ in range(chances):
        guides = uniform_noise(CAMERA, 25, rng)
        observed = uniform_noise(CAMERA, 25, rng)
        catalog, field = catalog_at(guides), field_at(observed)
        # Two stars are put in place, as a matched pair would.
        pair = Candidate(np.arange(2), np.arange(2), 12.0)
        field.vectors[:2] = field_at(guides[:2]).vectors
        field.plane_px[:2] = field_at(guides[:2]).plane_px
        verified = verify(catalog, field, pair)
        low += verified is not None and verified.log10_false_alarms < -1
    assert low <= 0.1 * chances


# Verification


def test_a_true_hypothesis_is_beyond_doubt_and_gives_the_rotation():
    verified = verify(catalog_at(PLACES), field_at(PLACES), truth_of(10))
    # Eight stars within 0.15 px beside the two that define the pose.
    p = 10 * np.pi * 0.16**2 / 512**2
    assert verified.log10_false_alarms <= 8 * np.log10(p) + 1
    np.testing.assert_allclose(verified.rotation, ROTATION, atol=1e-12)


def test_three_matched_stars_bring_in_the_others():
    verified = verify(catalog_at(PLACES), field_at(PLACES), truth_of(3))
    assert verified.log10_false_alarms < -40


def test_one_wrong_member_does_not_spoil_a_hypothesis():
    observed = PLACES + np.random.default_rng(2).normal(0, 0.2, (10, 2))
    catalog = np.array([0, 1, 2, 3, 4, 5, 6, 7, 9, 8])
    candidate = Candidate(np.arange(10), catalog, 12.0)
    verified = verify(catalog_at(PLACES), field_at(observed), candidate)
    found, _ = label(catalog_at(PLACES), field_at(observed), verified, 0.0)
    np.testing.assert_array_equal(found.catalog_index, np.arange(10))


def test_fewer_than_three_stars_in_place_are_no_hypothesis():
    observed = np.concatenate([PLACES[:2], PLACES[2:] + 60])
    assert verify(catalog_at(PLACES), field_at(observed), truth_of(2)) is None


def test_a_hypothesis_of_one_line_of_sight_is_none():
    candidate = Candidate(np.array([4, 4]), np.array([4, 4]), 2.0)
    assert verify(catalog_at(PLACES), field_at(PLACES), candidate) is None


@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_stars_on_one_line_of_the_image_determine_the_attitude(slope):
    x = np.array([40.0, 130, 190, 300, 420, 500])
    places = np.column_stack([x, 80 + slope * x])
    verified = verify(catalog_at(places), field_at(places), truth_of(6))
    np.testing.assert_allclose(verified.rotation, ROTATION, atol=1e-10)
    assert np.linalg.det(verified.rotation) == pytest.approx(1)


def test_a_false_hypothesis_is_likely_chance():
    """Three stars that happen to fit; the frame has 20 more that do not."""
    rng = np.random.default_rng(3)
    guides, observed = uniform_noise(CAMERA, 23, rng), uniform_noise(CAMERA, 23, rng)
    observed[:3] = guides[:3] + rng.normal(0, 1.0, (3, 2))
    verified = verify(catalog_at(guides), field_at(observed), truth_of(3))
    assert verified is None or verified.log10_false_alarms > -3


def test_guide_stars_out_of_the_image_do_not_count():
    """The same sky seen by a camera that shows a third of it has fewer stars to expect."""
    corner = Camera(300, 300, CAMERA.fx_px, CAMERA.fy_px, 256, 256)
    index = np.flatnonzero((PLACES < 300).all(axis=1))
    field = field_at(PLACES[index], corner)
    verified = verify(catalog_at(PLACES), field, Candidate(np.arange(4), index, 2.0))
    # 4 stars and 4 guide stars, all within the floor.
    p = 4 * np.pi * 0.15**2 / 300**2
    assert verified.log10_false_alarms == pytest.approx(2 * np.log10(p) + np.log10(4), abs=0.01)


# Labels


def test_states_are_the_numbers_that_messages_carry():
    assert [int(state) for state in StarState] == [0, 1, 2]


def test_an_empty_identification_names_nothing():
    nothing = Identification.empty(3)
    np.testing.assert_array_equal(nothing.catalog_index, [-1, -1, -1])
    np.testing.assert_array_equal(nothing.state, [0, 0, 0])
    assert np.isnan(nothing.residual_px).all()
    assert len(nothing.identified) == 0


def test_each_star_is_labelled_in_its_own_row():
    order = np.random.default_rng(4).permutation(10)
    found = labelled(PLACES, PLACES[order])
    np.testing.assert_array_equal(found.catalog_index, order)
    assert (found.state == IDENTIFIED).all()
    np.testing.assert_allclose(found.residual_px, 0, atol=1e-9)


def test_a_star_of_no_guide_star_stays_unidentified():
    found = labelled(PLACES, np.concatenate([PLACES, [(160.0, 160)]]))
    np.testing.assert_array_equal(found.identified, np.arange(10))
    assert found.state[10] == UNIDENTIFIED
    assert found.catalog_index[10] == -1
    assert np.isnan(found.residual_px[10])


def test_a_guide_star_that_is_not_seen_is_given_to_nobody():
    found = labelled(PLACES, PLACES[:9])
    np.testing.assert_array_equal(found.catalog_index, np.arange(9))


def test_two_centroids_at_one_guide_star_are_matched_one_to_one():
    """A split centroid: the nearer half gets the name, the other none."""
    noisy = PLACES + np.random.default_rng(5).normal(0, 0.5, (10, 2))
    noisy[4] = PLACES[4] + (0.2, 0)
    found = labelled(PLACES, np.concatenate([noisy, [PLACES[4] + (0, 1.4)]]))
    assert found.catalog_index[4] == 4
    assert found.state[10] == UNIDENTIFIED
    assert found.catalog_index[10] == -1


def test_two_guide_stars_at_one_centroid_are_matched_one_to_one():
    guides = np.concatenate([PLACES, [PLACES[4] + (0, 1.4)]])
    observed = PLACES + np.random.default_rng(6).normal(0, 0.5, (10, 2))
    observed[4] = PLACES[4] + (0.2, 0)
    found = labelled(guides, observed)
    np.testing.assert_array_equal(found.catalog_index, np.arange(10))


def test_residuals_are_distances_in_pixels_from_the_predicted_places():
    observed = PLACES + np.random.default_rng(7).normal(0, 0.5, (10, 2))
    verified = Verified(ROTATION, -10.0, 2.0)
    found, rotation = label(catalog_at(PLACES), field_at(observed), verified, 0.0)
    places = CAMERA.pixels(catalog_at(PLACES).vectors @ rotation)
    np.testing.assert_allclose(
        found.residual_px, np.linalg.norm(places - observed, axis=1), rtol=1e-9
    )


def test_the_final_rotation_is_fitted_to_all_identified_stars():
    observed = PLACES + np.random.default_rng(8).normal(0, 0.5, (10, 2))
    start = ROTATION @ Rotation.from_rotvec([1e-3, 0, 0]).as_matrix()  # 2.4 px away
    catalog, field = catalog_at(PLACES), field_at(observed)
    found, rotation = label(catalog, field, Verified(start, -10.0, 2.0), 0.0)
    assert (found.state == IDENTIFIED).all()
    np.testing.assert_allclose(rotation, wahba(field.vectors, catalog.vectors), atol=1e-12)


@pytest.mark.parametrize(
    ("noise_px", "off_px", "state"),
    [
        (0.05, 2.0, UNIDENTIFIED), (1.0, 2.0, IDENTIFIED), (0.2, 1.6, UNIDENTIFIED),
        (0.2, 0.4, IDENTIFIED),
    ],
)
def test_the_gate_follows_the_noise_of_the_frame(noise_px, off_px, state):
    """Two standard deviations are usual; eight are not, however few pixels that is."""
    observed = PLACES + np.random.default_rng(9).normal(0, noise_px, (10, 2))
    observed[3] = PLACES[3] + (off_px, 0.0)
    found = labelled(PLACES, observed, gate_px=0.0)
    assert found.state[3] == state
    assert (np.delete(found.state, 3) == IDENTIFIED).all()


# Displaced stars


def moved(star, by):
    observed = PLACES.copy()
    observed[star] += by
    return observed


def test_a_displaced_star_alone_is_labelled():
    found = labelled(PLACES, moved(4, (20, 10)))
    assert found.state[4] == DISPLACED
    assert found.catalog_index[4] == 4
    assert found.residual_px[4] == pytest.approx(np.hypot(20, 10), abs=0.01)
    assert 4 not in found.identified


def test_two_displaced_stars_far_from_each_other_are_both_labelled():
    observed = moved(0, (12, 0))
    observed[9] += (0, -15)
    found = labelled(PLACES, observed)
    np.testing.assert_array_equal(np.flatnonzero(found.state == DISPLACED), [0, 9])
    np.testing.assert_array_equal(found.catalog_index, np.arange(10))


@pytest.mark.parametrize(("gate_px", "state"), [(19.9, UNIDENTIFIED), (20.1, DISPLACED)])
def test_a_displaced_star_is_labelled_within_the_gate_only(gate_px, state):
    assert labelled(PLACES, moved(4, (20, 0)), gate_px=gate_px).state[4] == state


def test_a_gate_of_zero_labels_no_displaced_star():
    found = labelled(PLACES, moved(4, (5, 0)), gate_px=0.0)
    assert found.state[4] == UNIDENTIFIED
    assert found.catalog_index[4] == -1


@pytest.mark.parametrize(("second_px", "state"), [(59.0, UNIDENTIFIED), (61.0, DISPLACED)])
def test_a_displaced_star_between_two_free_guide_stars_is_not_labelled(second_px, state):
    """The second nearest free guide star has to be three times farther than 20 px."""
    guides = np.concatenate([PLACES, [PLACES[4] + (20 + second_px, 0)]])
    found = labelled(guides, moved(4, (20, 0)))
    assert found.state[4] == state


def test_a_guide_star_that_is_taken_does_not_make_a_displaced_star_ambiguous():
    """The neighbour 30 px away has its own centroid, so it is no rival."""
    guides = np.concatenate([PLACES, [PLACES[4] + (50, 0)]])
    found = labelled(guides, np.concatenate([moved(4, (20, 0)), guides[10:]]))
    assert found.state[4] == DISPLACED
    assert found.catalog_index[4] == 4


@pytest.mark.parametrize(
    ("n_false", "state"), [(0, DISPLACED), (3, DISPLACED), (30, UNIDENTIFIED)]
)
def test_a_displaced_star_among_many_false_stars_is_likely_chance(n_false, state):
    """(1 + n) pi 20^2 / 512^2 pairs as close are expected by chance: 0.005 for each star."""
    rng = np.random.default_rng(10)
    crowd = uniform_noise(CAMERA, 500, rng)
    # Far from the free guide star, so that only the number of stars speaks against it.
    crowd = crowd[np.linalg.norm(crowd - PLACES[4], axis=1) > 100][:n_false]
    found = labelled(PLACES, np.concatenate([moved(4, (20, 0)), crowd]))
    assert found.state[4] == state


def test_many_free_guide_stars_make_chance_likely_too():
    """2 stars and 8 guide stars are left over: 16 pi 30^2 / 512^2 = 0.17 pairs by chance."""
    missing = [(140.0, 150), (340, 60), (350, 180), (150, 350), (300, 330), (420, 200), (30, 340)]
    guides = np.concatenate([PLACES, missing])
    observed = np.concatenate([moved(0, (-21, -21)), [(300.0, 500)]])
    assert labelled(PLACES, observed).state[0] == DISPLACED
    assert labelled(guides, observed).state[0] == UNIDENTIFIED


def test_a_displaced_star_has_no_say_in_the_attitude():
    verified = Verified(ROTATION, -10.0, 2.0)
    _, rotation = label(catalog_at(PLACES), field_at(moved(4, (20, 10))), verified, 40.0)
    others = np.delete(PLACES, 4, axis=0)
    _, without = label(catalog_at(PLACES), field_at(others), verified, 40.0)
    np.testing.assert_allclose(rotation, without, atol=1e-13)


def test_a_star_displaced_out_of_the_image_can_be_named_when_its_place_is_inside():
    guides = np.concatenate([PLACES, [(500.0, 200)]])
    observed = np.concatenate([PLACES, [(520.0, 200)]])
    found = labelled(guides, observed)
    assert (found.state[10], found.catalog_index[10]) == (DISPLACED, 10)


def test_labelling_works_at_any_attitude():
    rng = np.random.default_rng(11)
    for _ in range(50):
        rotation = random_rotation(rng)
        catalog = catalog_at(PLACES, rotation=rotation)
        verified = verify(catalog, field_at(PLACES), truth_of(4))
        found, fitted = label(catalog, field_at(PLACES), verified, 40.0)
        np.testing.assert_array_equal(found.catalog_index, np.arange(10))
        assert separation(fitted[:, 2], rotation[:, 2]) < 1e-9
