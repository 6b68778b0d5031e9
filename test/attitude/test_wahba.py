"""Wahba's problem: exact, proper, for any spread of stars; one step of least squares."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.attitude.wahba import refine, solve_wahba, wahba
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera

UNDETERMINED = "^the matched directions do not determine a rotation$"


def random_rotations(n, seed):
    rng = np.random.default_rng(seed)
    return np.array([random_rotation(rng) for _ in range(n)])


def star_vectors(n, seed, fov_deg=12.0):
    camera = Camera.from_fov(fov_deg, 512, 512)
    return camera.vectors(np.random.default_rng(seed).random((n, 2)) * 512)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def about(axis, angle_deg):
    return Rotation.from_rotvec(np.radians(angle_deg) * np.array(axis, float)).as_matrix()


# Wahba's problem


@pytest.mark.parametrize("n", [2, 3, 20])
def test_wahba_is_exact_without_noise(n):
    camera = star_vectors(n, n)
    for true in random_rotations(50, n):
        # Directions are rounded to 1e-16; the lever is the field, 0.1 rad, squared.
        np.testing.assert_allclose(wahba(camera, camera @ true.T), true, atol=1e-12)


def test_wahba_turns_camera_vectors_into_icrs_and_not_the_reverse():
    quarter = about((0, 0, 1), 90)  # camera x becomes ICRS y
    found = wahba(np.eye(3), np.array([(0.0, 1, 0), (-1, 0, 0), (0, 0, 1)]))
    np.testing.assert_allclose(found, quarter, atol=1e-15)


def test_wahba_is_proper_even_for_a_sky_seen_in_a_mirror():
    camera = star_vectors(12, 1)
    for true in random_rotations(20, 2):
        found = wahba(camera * (1, -1, 1), camera @ true.T)
        assert np.linalg.det(found) == pytest.approx(1)
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("n", [2, 3, 10])
def test_wahba_is_proper_with_noise(n):
    rng = np.random.default_rng(n)
    camera = star_vectors(n, n + 50)
    for true in random_rotations(50, n):
        noisy = camera @ true.T + rng.normal(0, 1e-3, (n, 3))
        assert np.linalg.det(wahba(camera, noisy)) == pytest.approx(1)


def test_wahba_minimises_the_squared_residuals():
    rng = np.random.default_rng(3)
    camera, (true,) = star_vectors(8, 3), random_rotations(1, 3)
    icrs = camera @ true.T + rng.normal(0, 1e-3, (8, 3))

    def loss(rotation):
        return np.sum((icrs - camera @ rotation.T) ** 2)

    best = wahba(camera, icrs)
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        assert loss(best) < loss(best @ about(axis, 0.001))


@pytest.mark.parametrize(
    "camera",
    [
        np.empty((0, 3)),
        np.array([(0.0, 0, 1)]),
        np.array([(0.0, 0, 1)] * 4),
        np.array([(0.0, 0, 1), (0, 0, -1)]),
    ],
    ids=["none", "one", "one four times", "opposite"],
)
def test_directions_that_do_not_fix_the_rotation_are_refused(camera):
    (true,) = random_rotations(1, 4)
    with pytest.raises(ValueError, match=UNDETERMINED):
        wahba(camera, camera @ true.T)


def by_svd(camera, icrs):
    """Wahba's problem after Markley (1988)."""
    u, _, vt = np.linalg.svd(icrs.T @ camera)
    return u @ np.diag([1, 1, np.linalg.det(u) * np.linalg.det(vt)]) @ vt


def crowd(n, spread_rad, rng):
    return unit(np.column_stack([rng.normal(0, spread_rad, (n, 2)), np.ones(n)]))


@pytest.mark.parametrize("spread_rad", [3e-3, 0.01, 0.1, 1.0])
@pytest.mark.parametrize("n", [3, 5, 30])
def test_wahba_agrees_with_singular_values_for_every_spread_of_stars(n, spread_rad):
    """The stars fall within 1e-8 rad, a 40,000th of a pixel of 12 deg / 512, of the same places.

    Their own errors are a hundredth of the spread.
    """
    rng = np.random.default_rng(n)
    for true in random_rotations(100, n):
        camera = crowd(n, spread_rad, rng)
        icrs = unit(camera @ true.T + rng.normal(0, 0.01 * spread_rad, (n, 3)))
        found = wahba(camera, icrs)
        places = camera @ (found - by_svd(camera, icrs)).T
        assert np.max(np.abs(places)) < 1e-8
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    "spread_rad", [3e-4, 3e-3, 0.01, 0.1, 1.0]
)
def test_wahba_keeps_its_digits_for_stars_close_together(spread_rad):
    """A direction is rounded to 1e-16, and so is roll where the stars are 1 rad apart."""
    rng = np.random.default_rng(20)
    for true in random_rotations(300, 20):
        camera = crowd(3, spread_rad, rng)
        lever = np.linalg.svd(camera - camera.mean(axis=0))[1][0]
        found = wahba(camera, camera @ true.T)
        np.testing.assert_allclose(found, true, atol=4e-15 + 1e-15 / lever + 1e-17 / lever**2)


def test_wahba_finds_turns_of_any_angle_about_any_axis():
    """Half turns too, where a quaternion has w = 0."""
    camera = star_vectors(7, 21)
    axes = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0.6, 0.8), (0.48, -0.6, 0.64)]
    for axis in axes:
        for angle_deg in (0, 1e-7, 45, 179.9999, 180, 270):
            true = about(axis, angle_deg)
            np.testing.assert_allclose(wahba(camera, camera @ true.T), true, atol=1e-13)


def test_matches_are_taken_from_two_lists_and_only_the_first_of_them():
    camera, (true,) = star_vectors(9, 22), random_rotations(1, 22)
    order = np.random.default_rng(22).permutation(9)
    icrs = (camera @ true.T)[order]  # star i of the sky is star order[i] of the image
    observed, catalog = order[[0, 3, 5, 7, 8]], np.array([0, 3, 5, 7, 2])
    rotation = np.empty((3, 3))
    assert solve_wahba(camera, observed, icrs, catalog, 4, rotation)
    np.testing.assert_allclose(rotation, true, atol=1e-12)


# One step of least squares


def pair_of(apart_rad):
    """Two stars about the z axis."""
    s, c = math.sin(apart_rad / 2), math.cos(apart_rad / 2)
    return np.array([(s, 0, c), (-s, 0, c)])


def refined(camera, icrs, rotation):
    every = np.arange(len(camera))
    result = rotation.copy()
    return refine(camera, every, icrs, every, len(camera), result), result


@pytest.mark.parametrize("apart_rad", [1e-5, 1e-3, 0.2, 1.0])
def test_two_stars_fix_a_rotation(apart_rad):
    stars = pair_of(apart_rad)
    fixed, result = refined(stars, stars, np.eye(3))
    assert fixed
    np.testing.assert_array_equal(result, np.eye(3))


@pytest.mark.parametrize(
    "stars",
    [np.empty((0, 3)), np.array([(0.0, 0, 1)]), pair_of(0.0), pair_of(1e-6), pair_of(math.pi)],
    ids=["none", "one", "twice the same", "a microradian", "opposite"],
)
def test_a_step_is_refused_for_one_line_of_sight_and_changes_nothing(stars):
    start = about((0, 0, 1), 0.1)
    fixed, result = refined(stars, stars, start)
    assert not fixed
    np.testing.assert_array_equal(result, start)


def test_a_step_is_refused_for_what_is_not_a_number():
    stars = star_vectors(5, 23)
    stars[2] = np.nan
    assert not refined(stars, stars, np.eye(3))[0]


@pytest.mark.parametrize("angle_deg", [1e-4, 0.01, 0.5])
def test_a_step_leaves_an_error_of_second_order(angle_deg):
    camera = star_vectors(8, 24)
    rng = np.random.default_rng(24)
    for true in random_rotations(20, 25):
        start = true @ about(unit(rng.normal(size=(1, 3)))[0], angle_deg)
        fixed, result = refined(camera, camera @ true.T, start)
        assert fixed
        left = Rotation.from_matrix(true.T @ result).magnitude()
        # What is second order about the boresight turns into roll by the lever of the field.
        assert left <= 10 * math.radians(angle_deg) ** 2 + 1e-14
        np.testing.assert_allclose(result @ result.T, np.eye(3), atol=1e-14)
