"""Attitude: Wahba's problem, quaternion and roll conventions with numbers, covariance."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.attitude.attitude import (
    Attitude,
    covariance,
    describe,
    roll_rad,
    rotation_from_boresight,
)
from star_tracker.attitude.wahba import refine, solve_wahba, wahba
from star_tracker.geometry.spherical import position_angle, ra_dec
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera

HALF = math.sqrt(0.5)
NOTHING = np.zeros((3, 3))
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
    return *refine(camera, every, icrs, every, len(camera), result), result


@pytest.mark.parametrize("apart_rad", [1e-5, 1e-3, 0.2, 1.0])
def test_information_of_two_stars_by_hand(apart_rad):
    """M = diag(2 cos^2, 2, 2 sin^2) of half the separation: its determinant is 2 sin^2."""
    stars = pair_of(apart_rad)
    fixed, determinant, _ = refined(stars, stars, np.eye(3))
    assert fixed
    assert determinant == pytest.approx(2 * math.sin(apart_rad) ** 2, rel=1e-4)


@pytest.mark.parametrize(
    "stars",
    [np.empty((0, 3)), np.array([(0.0, 0, 1)]), pair_of(0.0), pair_of(1e-6), pair_of(math.pi)],
    ids=["none", "one", "twice the same", "a microradian", "opposite"],
)
def test_a_step_is_refused_for_one_line_of_sight_and_changes_nothing(stars):
    start = about((0, 0, 1), 0.1)
    fixed, determinant, result = refined(stars, stars, start)
    assert not fixed
    assert determinant == 0
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
        fixed, _, result = refined(camera, camera @ true.T, start)
        assert fixed
        left = Rotation.from_matrix(true.T @ result).magnitude()
        # What is second order about the boresight turns into roll by the lever of the field.
        assert left <= 10 * math.radians(angle_deg) ** 2 + 1e-14
        np.testing.assert_allclose(result @ result.T, np.eye(3), atol=1e-14)


# Quaternion


@pytest.mark.parametrize(
    ("rotation", "quaternion"),
    [
        (np.eye(3), (0, 0, 0, 1)),
        (about((0, 0, 1), 90), (0, 0, HALF, HALF)),
        (about((1, 0, 0), 90), (HALF, 0, 0, HALF)),
        (about((0, 1, 0), -60), (0, -0.5, 0, math.sqrt(0.75))),
        # x -> y -> z -> x is a third of a turn about (1, 1, 1).
        (np.array([(0.0, 0, 1), (1, 0, 0), (0, 1, 0)]), (0.5, 0.5, 0.5, 0.5)),
        # 270 deg about z is -90 deg with a positive w.
        (about((0, 0, 1), 270), (0, 0, -HALF, HALF)),
    ],
)
def test_quaternion_of_known_rotations_in_order_x_y_z_w(rotation, quaternion):
    attitude = Attitude.from_rotation(rotation, NOTHING)
    np.testing.assert_allclose(attitude.quaternion_xyzw, quaternion, atol=1e-15)


def test_quaternion_rotates_camera_vectors_into_icrs():
    """v_icrs = q v q*, written out: v + 2 w (u x v) + 2 u x (u x v)."""
    (true,) = random_rotations(1, 5)
    q = Attitude.from_rotation(true, NOTHING).quaternion_xyzw
    u, w, v = q[:3], q[3], np.array([0.1, -0.2, 0.97])
    turned = v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))
    np.testing.assert_allclose(turned, true @ v, atol=1e-14)


def test_quaternion_has_unit_length_and_no_negative_w():
    for true in random_rotations(200, 6):
        q = Attitude.from_rotation(true, NOTHING).quaternion_xyzw
        assert q[3] >= 0
        assert np.linalg.norm(q) == pytest.approx(1, rel=1e-14)


def test_rotation_comes_back_from_the_quaternion():
    for true in random_rotations(50, 7):
        found = Attitude.from_rotation(true, NOTHING).rotation
        np.testing.assert_allclose(found, true, atol=1e-14)


def test_an_improper_rotation_is_refused():
    with pytest.raises(ValueError, match="determinant"):
        Attitude.from_rotation(np.diag([1.0, -1.0, 1.0]), NOTHING)


# Boresight and roll


def test_boresight_and_roll_of_a_third_of_a_turn():
    """Camera x, y, z -> ICRS y, z, x: it looks at RA 0, Dec 0 with its down (y) to the north."""
    attitude = Attitude.from_rotation(np.array([(0.0, 0, 1), (1, 0, 0), (0, 1, 0)]), NOTHING)
    assert (attitude.ra_rad, attitude.dec_rad) == pytest.approx((0, 0))
    assert attitude.roll_rad == pytest.approx(math.pi)


def test_boresight_and_roll_of_two_thirds_of_a_turn():
    """Camera x, y, z -> ICRS z, x, y: it looks at RA 90, and its up, -x, is east there."""
    attitude = Attitude.from_rotation(np.array([(0.0, 1, 0), (0, 0, 1), (1, 0, 0)]), NOTHING)
    assert np.degrees((attitude.ra_rad, attitude.dec_rad)) == pytest.approx((90, 0))
    assert np.degrees(attitude.roll_rad) == pytest.approx(90)


def test_roll_zero_has_north_up_and_east_at_the_left():
    """So the sky looks from inside to anyone who faces it with north up."""
    rotation = rotation_from_boresight(0.0, 0.0, 0.0)
    np.testing.assert_allclose(rotation[:, 2], (1, 0, 0), atol=1e-15)
    np.testing.assert_allclose(-rotation[:, 1], (0, 0, 1), atol=1e-15)
    np.testing.assert_allclose(-rotation[:, 0], (0, 1, 0), atol=1e-15)


def test_roll_ninety_has_east_up_and_north_at_the_right():
    rotation = rotation_from_boresight(0.0, 0.0, math.pi / 2)
    np.testing.assert_allclose(-rotation[:, 1], (0, 1, 0), atol=1e-15)
    np.testing.assert_allclose(rotation[:, 0], (0, 0, 1), atol=1e-15)


def test_in_an_image_of_normal_parity_a_star_to_the_north_is_above_the_centre():
    camera = Camera.from_fov(12, 512, 512)
    rotation = rotation_from_boresight(1.0, 0.5, 0.0)
    north = rotation_from_boresight(1.0, 0.5 + math.radians(1), 0.0)[:, 2]
    ((x, y),) = camera.pixels(north[None] @ rotation)
    assert x == pytest.approx(256)
    assert y == pytest.approx(256 - camera.fy_px * math.tan(math.radians(1)))


def test_boresight_and_roll_come_back():
    rng = np.random.default_rng(8)
    for ra, roll in rng.uniform(0, 2 * np.pi, (100, 2)):
        dec = float(np.arcsin(rng.uniform(-1, 1)))
        attitude = Attitude.from_rotation(rotation_from_boresight(ra, dec, roll), NOTHING)
        found = (attitude.ra_rad, attitude.dec_rad, attitude.roll_rad)
        np.testing.assert_allclose(
            np.exp(1j * np.array(found)), np.exp(1j * np.array((ra, dec, roll))), atol=1e-10
        )


def test_rotation_from_a_boresight_is_proper_everywhere():
    for dec_deg in (-90, -89.999, 0, 37, 90):
        for ra, roll in ((0.0, 0.0), (1.0, 2.0), (5.0, 4.0)):
            rotation = rotation_from_boresight(ra, math.radians(dec_deg), roll)
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
            assert np.linalg.det(rotation) == pytest.approx(1)


def test_angles_are_in_their_ranges():
    for true in random_rotations(300, 9):
        attitude = Attitude.from_rotation(true, NOTHING)
        assert 0 <= attitude.ra_rad < 2 * math.pi
        assert -math.pi / 2 <= attitude.dec_rad <= math.pi / 2
        assert 0 <= attitude.roll_rad < 2 * math.pi
        assert attitude.roll_rad == pytest.approx(roll_rad(true), abs=1e-12)


def turns_of_all_kinds():
    """Random ones, and half turns and quarter turns, where quaternions have zeros."""
    axes = [*np.eye(3), *np.ones((3, 3)) - np.eye(3), np.ones(3), np.array([1.0, -1, 0])]
    special = [about(unit(axis[None])[0], angle) for axis in axes for angle in (0, 90, 180, 270)]
    return [*special, *random_rotations(300, 26)]


def test_a_description_agrees_with_scipy_and_with_the_columns_of_the_matrix():
    values = np.empty(7)
    for true in turns_of_all_kinds():
        describe(true, values)
        q = Rotation.from_matrix(true).as_quat()
        # A quaternion and its negative are one rotation; with w = 0 either may come back.
        assert abs(values[:4] @ q) == pytest.approx(1, abs=1e-14)
        assert values[3] >= 0
        np.testing.assert_allclose(
            Rotation.from_quat(values[:4]).as_matrix(), true, atol=1e-14
        )
        ra, dec = ra_dec(true[:, 2])
        assert values[5] == pytest.approx(float(dec), abs=1e-15)
        if abs(true[2, 2]) < 1 - 1e-9:  # at a pole right ascension and roll are arbitrary
            roll = position_angle(true[:, 2], -true[:, 1])
            np.testing.assert_allclose(
                np.exp(1j * values[[4, 6]]), np.exp(1j * np.array([ra, roll])), atol=1e-12
            )


@pytest.mark.parametrize("ra_rad", [-1e-17, -1e-300])
def test_a_right_ascension_just_below_zero_is_zero(ra_rad):
    """Modulo 2 pi it would be rounded to 2 pi, which is out of range."""
    values = np.empty(7)
    describe(rotation_from_boresight(ra_rad, 0.3, -1e-17), values)
    assert 0 <= values[4] < 2 * math.pi
    assert 0 <= values[6] < 2 * math.pi


# Covariance


def test_covariance_of_three_axes_by_hand():
    """sum(I - b b^T) = 3 I - I = 2 I."""
    np.testing.assert_allclose(covariance(np.eye(3), 0.1), 0.005 * np.eye(3))


def test_covariance_of_a_narrow_field_by_hand():
    """Four stars at +-a from the boresight along x and y, each of unit length.

    About x and y nearly all four count: 2 sin^2 a + 4 cos^2 a; about z only 4 sin^2 a.
    """
    s, c = math.sin(0.1), math.cos(0.1)
    found = covariance(np.array([(s, 0, c), (-s, 0, c), (0, s, c), (0, -s, c)]), 1e-5)
    across, along = 1e-10 / (2 * s * s + 4 * c * c), 1e-10 / (4 * s * s)
    np.testing.assert_allclose(found, np.diag([across, across, along]), rtol=1e-12, atol=1e-24)


@pytest.mark.parametrize(("n", "fov_deg"), [(6, 12.0), (20, 20.0)])
def test_covariance_is_the_scatter_of_estimates(n, fov_deg):
    """4000 seeded trials: a variance scatters by sqrt(2 / 4000) = 2.2 %."""
    rng = np.random.default_rng(10)
    camera, (true,) = star_vectors(n, 11, fov_deg), random_rotations(1, 12)
    sigma = 1e-4
    errors = np.empty((4000, 3))
    for error in errors:
        noise = rng.normal(0, sigma, (n, 3))
        noise -= camera * np.sum(noise * camera, axis=1, keepdims=True)
        found = wahba(camera + noise, camera @ true.T)
        # The small rotation about the camera's own axes.
        error[:] = Rotation.from_matrix(true.T @ found).as_rotvec()
    whiten = np.linalg.inv(np.linalg.cholesky(covariance(camera, sigma)))
    scatter = whiten @ np.cov(errors.T) @ whiten.T
    np.testing.assert_allclose(scatter, np.eye(3), atol=0.08)
    assert np.all(np.abs(whiten @ errors.mean(axis=0)) < 4 / math.sqrt(4000))
