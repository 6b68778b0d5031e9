"""The labels of an accepted frame: identified and displaced stars."""

import numpy as np
import pytest
from engines import CAMERA, PLACES, ROTATION, Bench, database_at, identification_of, pose_parts
from scipy.spatial.transform import Rotation

from star_tracker.attitude.wahba import wahba
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import separation
from star_tracker.identification import verbs
from star_tracker.identification.ended import Ended
from star_tracker.identification.evidence import scale_prior
from star_tracker.identification.labels import Identification, StarState, blank_labels
from star_tracker.maps.simulation import random_rotation, uniform_noise

UNIDENTIFIED, IDENTIFIED, DISPLACED = StarState


@compiled
def set_scale(pose, scale):
    pose.scale, pose.free = scale, True


def bench_at(guides, observed, *, gate_px=40.0, **options):
    bench = Bench(database_at(guides, **options), displaced_gate_px=gate_px)
    bench.show(observed)
    return bench


def labelled(guides, observed, *, gate_px=40.0):
    """Label a frame at the true rotation."""
    return bench_at(guides, observed, gate_px=gate_px).label(ROTATION)[0]


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
    bench = bench_at(PLACES, observed, gate_px=0.0)
    found, rotation = bench.label(ROTATION)
    places = CAMERA.pixels(bench.guides @ rotation)
    np.testing.assert_allclose(
        found.residual_px, np.linalg.norm(places - observed, axis=1), rtol=1e-9
    )


@pytest.mark.parametrize("off_rad", [1e-3, 1e-4, 1e-6])
def test_the_final_rotation_is_fitted_to_all_identified_stars(off_rad):
    """From 2.4 px away and less, by linear least squares: an error of second order is left."""
    observed = PLACES + np.random.default_rng(8).normal(0, 0.5, (10, 2))
    bench = bench_at(PLACES, observed, gate_px=0.0)
    fitted = wahba(CAMERA.vectors(observed), bench.guides)
    start = fitted @ Rotation.from_rotvec([off_rad, 0, 0]).as_matrix()
    found, rotation = bench.label(start)
    assert (found.state == IDENTIFIED).all()
    np.testing.assert_allclose(rotation, fitted, atol=2 * off_rad**2 + 1e-13)


@pytest.mark.parametrize(
    ("noise_px", "off_px", "state"),
    [
        (0.05, 2.0, UNIDENTIFIED), (1.0, 2.0, IDENTIFIED), (0.2, 3.0, UNIDENTIFIED),
        (0.2, 0.4, IDENTIFIED),
        (0.05, 1.0, UNIDENTIFIED),
        (0.2, 1.6, UNIDENTIFIED),
    ],
)
def test_the_gate_follows_the_noise_of_the_frame(noise_px, off_px, state):
    """Two standard deviations are usual; fifteen are not, however few pixels that is."""
    observed = PLACES + np.random.default_rng(9).normal(0, noise_px, (10, 2))
    observed[3] = PLACES[3] + (off_px, 0.0)
    found = labelled(PLACES, observed, gate_px=0.0)
    assert found.state[3] == state
    assert (np.delete(found.state, 3) == IDENTIFIED).all()


def test_wrong_members_of_a_hypothesis_get_their_right_labels():
    observed = PLACES + np.random.default_rng(2).normal(0, 0.2, (10, 2))
    bench = bench_at(PLACES, observed, gate_px=0.0)
    bench.judge(range(10), [0, 1, 2, 3, 4, 5, 6, 7, 9, 8], 12.0)
    found, _ = bench.label()
    np.testing.assert_array_equal(found.catalog_index, np.arange(10))


def test_noise_wider_than_the_tolerance_is_measured():
    """2 px of noise and a tolerance of 2 px: the first gate is 10 px, the last one 3.7 sigma."""
    rng = np.random.default_rng(12)
    for _ in range(20):
        found = labelled(PLACES, PLACES + rng.normal(0, 2.0, (10, 2)), gate_px=0.0)
        assert np.count_nonzero(found.state == IDENTIFIED) >= 9
        named = found.identified
        np.testing.assert_array_equal(found.catalog_index[named], named)


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
    _, rotation = bench_at(PLACES, moved(4, (20, 10))).label(ROTATION)
    _, without = bench_at(PLACES, np.delete(PLACES, 4, axis=0)).label(ROTATION)
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
        bench = bench_at(PLACES, PLACES, rotation=rotation)
        bench.judge(range(4), range(4))
        found, fitted = bench.label()
        np.testing.assert_array_equal(found.catalog_index, np.arange(10))
        assert separation(fitted[:, 2], rotation[:, 2]) < 1e-9


@pytest.mark.parametrize(
    ("n_matched", "ended"), [(10, Ended.SOLVED), (20, Ended.SOLVED), (21, Ended.CONTRADICTED)]
)
def test_a_pose_that_loses_most_of_the_stars_that_carried_it_is_none(n_matched, ended):
    """Ten stars are identified; so many had the evidence of the pose."""
    bench = bench_at(PLACES, PLACES)
    bench.judge(range(4), range(4))
    bench.results.progress["n_matched"] = n_matched
    bench.label()
    assert bench.searcher.ended == ended


@pytest.mark.parametrize(("noise_px", "sigma_px", "score", "ended"), [
    (0.5, 0.0, 3.5, Ended.SOLVED), (4.0, 0.0, 17.0, Ended.SOLVED),
    (4.0, 0.0, 4.1, Ended.FAR), (4.0, 0.0, 15.0, Ended.FAR),
    (4.0, 0.0, 3.9, Ended.CONTRADICTED), (4.0, 3.0, 3.5, Ended.SOLVED),
    (40.0, 0.0, 17.0, Ended.CONTRADICTED),
])
def test_stars_far_from_their_places_need_evidence(noise_px, sigma_px, score, ended):
    """A pose of ten stars that lie off by so much has more than enough, or gives way to doubt."""
    angle = 2.4 * np.arange(10)  # in no order, so that neither turn nor scale takes it away
    off_px = noise_px * np.column_stack([np.cos(angle), np.sin(angle)])
    bench = Bench(database_at(PLACES), sigma_px=sigma_px)
    bench.show(PLACES + off_px)
    bench.results.progress["score"] = score
    bench.label(ROTATION, tolerance_px=30.0)
    assert bench.results.outcome["rms_px"][0] == pytest.approx(noise_px, rel=0.3)
    assert bench.searcher.ended == ended


# After the judge


def labels_after_the_judge(bench, label):
    """Judge the frame and label it at once, with what the judge has left, or from the pose."""
    bench.judge(range(4), range(4), 2.0)
    labels = blank_labels(bench.n_rows)
    label(bench.engine, labels)
    return identification_of(labels), bench.results.rotation.copy()


@pytest.mark.parametrize("noise_px", [0.05, 0.3, 1.0])
def test_labels_that_follow_the_judge_are_those_of_a_fresh_look(noise_px):
    """Where the judge's matches hold they are taken over, which saves half of the time."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        observed = np.concatenate([
            PLACES + rng.normal(0, noise_px, (10, 2)), uniform_noise(CAMERA, 3, rng),
        ])
        bench = bench_at(PLACES, observed)
        at_once, rotation = labels_after_the_judge(bench, verbs.label)
        bench.show(observed)
        afresh, again = labels_after_the_judge(bench, verbs.label_best)
        np.testing.assert_array_equal(at_once.catalog_index, afresh.catalog_index)
        np.testing.assert_array_equal(at_once.state, afresh.state)
        np.testing.assert_allclose(rotation, again, rtol=0, atol=1e-10)


# A camera that is told with a tolerance


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.02])
def test_the_scale_is_fitted_to_all_identified_stars(scale):
    """The prior of 5 % hardly pulls: the noise of 10 stars is 0.01 % of the field."""
    bench = Bench(database_at(PLACES), CAMERA.scaled(1 / scale), prior=scale_prior(5.0))
    observed = PLACES + np.random.default_rng(13).normal(0, 0.1, (10, 2))
    bench.show(observed)
    # As from a search by shape that is 0.3 % off.
    scale_found = fitted_from(bench, 1.003 * scale)
    outcome = bench.results.outcome[0]
    assert outcome["scale"] == scale_found
    error = np.sqrt(outcome["scale_variance"])
    # The corners are 300 px from the middle, the stars 200: 0.1 px / 200 px / sqrt(10).
    assert 5e-5 < error < 1e-3
    assert abs(np.log(scale_found / scale)) < 4 * error


def fitted_from(bench, start):
    """The scale after labelling from a pose with another one."""
    set_scale(bench.best, start)
    bench.label(ROTATION, tolerance_px=6.0)
    return pose_parts(bench.best)[1]
