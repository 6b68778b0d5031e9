"""Rotation matrices and quaternions: conventions with numbers, round trips, poles, refusals."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.geometry.rotation import (
    boresight_of,
    copy_rotation,
    is_rotation,
    rotation_from_boresight,
    rotation_matrix,
    write_quaternion,
    write_rotation,
)
from star_tracker.geometry.spherical import position_angle, ra_dec
from star_tracker.optics.camera import Camera

HALF = math.sqrt(0.5)
THIRD = np.array([(0.0, 0, 1), (1, 0, 0), (0, 1, 0)])  # x -> y -> z -> x


def about(axis, angle_deg):
    axis = np.array(axis, float) / np.linalg.norm(axis)
    return Rotation.from_rotvec(np.radians(angle_deg) * axis).as_matrix()


def turns_of_all_kinds():
    """Random ones, and half turns and quarter turns, where quaternions have zeros."""
    axes = [*np.eye(3), *np.ones((3, 3)) - np.eye(3), np.ones(3), np.array([1.0, -1, 0])]
    special = [about(axis, angle) for axis in axes for angle in (0, 90, 180, 270)]
    return [*special, *Rotation.random(300, random_state=26).as_matrix()]


def quaternion_of(rotation):
    quaternion = np.empty(4)
    write_quaternion(np.ascontiguousarray(rotation), quaternion)
    return quaternion


# Quaternions


KNOWN = [
    (np.eye(3), (0, 0, 0, 1)),
    (about((0, 0, 1), 90), (0, 0, HALF, HALF)),
    (about((1, 0, 0), 90), (HALF, 0, 0, HALF)),
    (about((0, 1, 0), -60), (0, -0.5, 0, math.sqrt(0.75))),
    # A third of a turn about (1, 1, 1).
    (THIRD, (0.5, 0.5, 0.5, 0.5)),
    # 270 deg about z is -90 deg with a positive w.
    (about((0, 0, 1), 270), (0, 0, -HALF, HALF)),
    # Half turns, where w is 0 and the largest element is each of the others.
    (np.diag([1.0, -1, -1]), (1, 0, 0, 0)),
    (np.diag([-1.0, 1, -1]), (0, 1, 0, 0)),
    (np.diag([-1.0, -1, 1]), (0, 0, 1, 0)),
]


@pytest.mark.parametrize(("rotation", "quaternion"), KNOWN)
def test_quaternion_of_known_rotations_in_order_x_y_z_w(rotation, quaternion):
    np.testing.assert_allclose(quaternion_of(rotation), quaternion, atol=1e-15)


@pytest.mark.parametrize(("rotation", "quaternion"), KNOWN)
@pytest.mark.parametrize("length", [1.0, -1.0, 1e-3, 40.0])
def test_rotation_of_known_quaternions_of_any_length(rotation, quaternion, length):
    found = rotation_matrix(length * np.array(quaternion, float))
    np.testing.assert_allclose(found, rotation, atol=1e-15)


def test_quaternions_rotate_vectors_as_their_matrices_do():
    """q v q*, written out: v + 2 w (u x v) + 2 u x (u x v)."""
    rng = np.random.default_rng(5)
    for any_length in rng.normal(size=(50, 4)):
        q = any_length / np.linalg.norm(any_length)
        u, w, v = q[:3], q[3], rng.normal(size=3)
        turned = v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))
        np.testing.assert_allclose(rotation_matrix(q) @ v, turned, atol=1e-14)


def test_matrices_and_quaternions_go_round_and_agree_with_scipy():
    for true in turns_of_all_kinds():
        q = quaternion_of(true)
        assert q[3] >= 0
        assert np.linalg.norm(q) == pytest.approx(1, rel=1e-14)
        # A quaternion and its negative are one rotation; with w = 0 either may come back.
        assert abs(q @ Rotation.from_matrix(true).as_quat()) == pytest.approx(1, abs=1e-14)
        np.testing.assert_allclose(rotation_matrix(q), true, atol=1e-14)


def test_a_quaternion_of_length_0_is_the_identity_for_compiled_code():
    """Which has no exceptions to raise."""
    rotation = np.empty((3, 3))
    write_rotation(np.zeros(4), rotation)
    np.testing.assert_array_equal(rotation, np.eye(3))


def test_a_quaternion_may_be_a_list_and_is_not_changed():
    q = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(rotation_matrix(q), rotation_matrix(q.tolist()))
    np.testing.assert_array_equal(q, [0.1, 0.2, 0.3, 0.4])


# Boresight and roll


def test_boresight_and_roll_of_a_third_of_a_turn():
    """Camera x, y, z -> ICRS y, z, x: it looks at RA 0, Dec 0 with its down (y) to the north."""
    assert boresight_of(THIRD) == pytest.approx((0, 0, math.pi))


def test_boresight_and_roll_of_two_thirds_of_a_turn():
    """Camera x, y, z -> ICRS z, x, y: it looks at RA 90, and its up, -x, is east there."""
    assert np.degrees(boresight_of(np.ascontiguousarray(THIRD.T))) == pytest.approx((90, 0, 90))


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
        found = boresight_of(rotation_from_boresight(ra, dec, roll))
        np.testing.assert_allclose(
            np.exp(1j * np.array(found)), np.exp(1j * np.array((ra, dec, roll))), atol=1e-10
        )


def test_boresight_and_roll_agree_with_the_columns_of_the_matrix():
    for true in turns_of_all_kinds():
        ra, dec, roll = boresight_of(true)
        assert 0 <= ra < 2 * math.pi
        assert -math.pi / 2 <= dec <= math.pi / 2
        assert 0 <= roll < 2 * math.pi
        expected = ra_dec(true[:, 2])
        assert dec == pytest.approx(float(expected[1]), abs=1e-15)
        if abs(true[2, 2]) < 1 - 1e-9:  # at a pole right ascension and roll are arbitrary
            up = position_angle(true[:, 2], -true[:, 1])
            np.testing.assert_allclose(
                np.exp(1j * np.array([ra, roll])), np.exp(1j * np.array([expected[0], up])),
                atol=1e-12,
            )


@pytest.mark.parametrize("dec_deg", [90.0, -90.0])
@pytest.mark.parametrize("roll_deg", [0.0, 40.0, 250.0])
def test_at_a_pole_boresight_and_roll_still_name_the_rotation(dec_deg, roll_deg):
    """Right ascension and roll are one angle there; whichever way it is told, it comes back."""
    true = rotation_from_boresight(0.0, math.radians(dec_deg), math.radians(roll_deg))
    np.testing.assert_allclose(rotation_from_boresight(*boresight_of(true)), true, atol=1e-12)


@pytest.mark.parametrize("dec_deg", [-90, -89.999, 0, 37, 90])
@pytest.mark.parametrize(("ra", "roll"), [(0.0, 0.0), (1.0, 2.0), (5.0, 4.0)])
def test_rotation_from_a_boresight_is_proper_everywhere(dec_deg, ra, roll):
    rotation = rotation_from_boresight(ra, math.radians(dec_deg), roll)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert is_rotation(rotation)


@pytest.mark.parametrize("ra_rad", [-1e-17, -1e-300])
def test_a_right_ascension_just_below_zero_is_zero(ra_rad):
    """Modulo 2 pi it would be rounded to 2 pi, which is out of range."""
    ra, _, roll = boresight_of(rotation_from_boresight(ra_rad, 0.3, -1e-17))
    assert 0 <= ra < 2 * math.pi
    assert 0 <= roll < 2 * math.pi


# What is a rotation


def test_all_rotations_are_rotations():
    assert all(is_rotation(true) for true in turns_of_all_kinds())


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, -1, 1]), -np.eye(3), 1.001 * np.eye(3), np.zeros((3, 3)),
        np.eye(3) + 1e-5 * np.ones((3, 3)), np.full((3, 3), np.nan), np.diag([1.0, 1, np.nan]),
        np.diag([1.0, 1, np.inf]), np.array([(1.0, 0.1, 0), (0, 1, 0), (0, 0, 1)]),
    ],
    ids=[
        "mirror", "point mirror", "stretched", "zero", "nearly", "no numbers", "one not a number",
        "infinite", "sheared",
    ],
)
def test_what_stretches_or_mirrors_is_none(matrix):
    assert not is_rotation(matrix)


def test_a_matrix_of_single_precision_still_is_a_rotation():
    """Errors of 1e-7 are those of float32."""
    for true in turns_of_all_kinds():
        assert is_rotation(true.astype(np.float32).astype(float))


def test_a_copy_is_a_copy():
    source, target = about((1, 2, 3), 40), np.zeros((3, 3))
    copy_rotation(source, target)
    np.testing.assert_array_equal(target, source)
    source[0, 0] = 7.0
    assert target[0, 0] != 7.0
