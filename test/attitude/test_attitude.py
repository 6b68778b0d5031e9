"""An attitude as it is reported, and the covariance of directions."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.attitude.attitude import Attitude, covariance
from star_tracker.attitude.wahba import wahba
from star_tracker.geometry.rotation import boresight_of, rotation_from_boresight, rotation_matrix
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera

NOTHING = np.zeros((3, 3))


def random_rotations(n, seed):
    rng = np.random.default_rng(seed)
    return np.array([random_rotation(rng) for _ in range(n)])


def star_vectors(n, seed, fov_deg=12.0):
    camera = Camera.from_fov(fov_deg, 512, 512)
    return camera.vectors(np.random.default_rng(seed).random((n, 2)) * 512)


# The attitude


def test_an_attitude_has_boresight_roll_and_quaternion_of_its_rotation():
    rotation = rotation_from_boresight(1.2, -0.4, 3.0)
    attitude = Attitude.from_rotation(rotation, 2 * np.eye(3))
    assert (attitude.ra_rad, attitude.dec_rad, attitude.roll_rad) == pytest.approx(
        (1.2, -0.4, 3.0)
    )
    np.testing.assert_allclose(rotation_matrix(attitude.quaternion_xyzw), rotation, atol=1e-15)
    np.testing.assert_array_equal(attitude.covariance_rad2, 2 * np.eye(3))


def test_rotation_comes_back_from_the_quaternion():
    for true in random_rotations(50, 7):
        attitude = Attitude.from_rotation(true, NOTHING)
        np.testing.assert_allclose(attitude.rotation, true, atol=1e-14)
        assert boresight_of(true) == (attitude.ra_rad, attitude.dec_rad, attitude.roll_rad)
        assert attitude.quaternion_xyzw[3] >= 0


def test_a_rotation_may_be_a_view_of_another_array():
    (true,) = random_rotations(1, 8)
    attitude = Attitude.from_rotation(np.asfortranarray(true), NOTHING)
    np.testing.assert_allclose(attitude.rotation, true, atol=1e-14)


def test_an_improper_rotation_is_refused():
    text = r"^a rotation has determinant \+1, this matrix mirrors \(determinant -1\)$"
    with pytest.raises(ValueError, match=text):
        Attitude.from_rotation(np.diag([1.0, -1.0, 1.0]), NOTHING)


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
