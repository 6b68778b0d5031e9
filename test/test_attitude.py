"""Attitude: Wahba's problem, quaternion and roll conventions with numbers, covariance."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.attitude import (
    Attitude,
    covariance,
    roll_rad,
    rotation_from_boresight,
    wahba,
)
from star_tracker.camera import Camera
from star_tracker.star_maps import random_rotation

HALF = math.sqrt(0.5)
NOTHING = np.zeros((3, 3))
UNDETERMINED = "^the matched directions do not determine a rotation$"


def random_rotations(n, seed):
    rng = np.random.default_rng(seed)
    return np.array([random_rotation(rng) for _ in range(n)])


def star_vectors(n, seed, fov_deg=12.0):
    camera = Camera.from_fov(fov_deg, 512, 512)
    return camera.vectors(np.random.default_rng(seed).random((n, 2)) * 512)


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
