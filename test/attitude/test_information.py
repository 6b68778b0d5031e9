"""The information of directions: against numpy's matrices, and by hand."""

import math

import numpy as np
import pytest

from star_tracker.attitude.information import adjugate, determinant, with_direction, with_scale
from star_tracker.optics.camera import Camera

NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def matrix(m):
    xx, xy, xz, yy, yz, zz = m
    return np.array([(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)])


def information_of(vectors):
    m = NOTHING
    for x, y, z in vectors.tolist():
        m = with_direction(m, x, y, z)
    return m


def stars(n, seed, fov_deg=12.0):
    camera = Camera.from_fov(fov_deg, 512, 512)
    return camera.vectors(np.random.default_rng(seed).random((n, 2)) * 512)


@pytest.mark.parametrize("n", [0, 1, 2, 30])
@pytest.mark.parametrize("fov_deg", [1.0, 12.0, 100.0])
def test_information_is_the_sum_of_what_each_direction_does_not_point_along(n, fov_deg):
    vectors = stars(n, n, fov_deg)
    expected = sum((np.eye(3) - np.outer(b, b) for b in vectors), np.zeros((3, 3)))
    np.testing.assert_allclose(matrix(information_of(vectors)), expected, atol=1e-13)


def test_a_direction_tells_nothing_about_the_turn_about_itself():
    vectors = stars(1, 3)
    np.testing.assert_allclose(matrix(information_of(vectors)) @ vectors[0], 0, atol=1e-15)


@pytest.mark.parametrize("apart_rad", [1e-5, 1e-3, 0.2, 1.0])
def test_information_of_two_stars_by_hand(apart_rad):
    """M = diag(2 cos^2, 2, 2 sin^2) of half the separation: its determinant is 2 sin^2."""
    s, c = math.sin(apart_rad / 2), math.cos(apart_rad / 2)
    m = information_of(np.array([(s, 0, c), (-s, 0, c)]))
    np.testing.assert_allclose(matrix(m), np.diag([2 * c * c, 2, 2 * s * s]), atol=1e-15)
    size = determinant(m, adjugate(m))
    assert size == pytest.approx(2 * math.sin(apart_rad) ** 2, rel=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_adjugate_and_determinant_are_those_of_numpy(seed):
    half = np.random.default_rng(seed).normal(size=(3, 3))
    full = half @ half.T
    m = tuple(full[np.triu_indices(3)].tolist())
    size = determinant(m, adjugate(m))
    assert size == pytest.approx(np.linalg.det(full), rel=1e-10)
    np.testing.assert_allclose(matrix(adjugate(m)) / size, np.linalg.inv(full), rtol=1e-8)


def test_an_adjugate_exists_of_a_matrix_without_inverse():
    m = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert adjugate(m) == NOTHING
    assert determinant(m, adjugate(m)) == 0


@pytest.mark.parametrize("fov_deg", [5.0, 60.0])
def test_what_rotation_and_scale_share_is_how_the_directions_move(fov_deg):
    """By differences: the focal length grows, and the direction of a pixel moves by d."""
    camera, step = Camera.from_fov(fov_deg, 512, 512, principal_point_px=(200.0, None)), 1e-6
    xy = np.random.default_rng(4).random((9, 2)) * 512
    more, less = (camera.scaled(math.exp(s)).vectors(xy) for s in (step, -step))
    moved, b = (more - less) / (2 * step), camera.vectors(xy)
    c = (0.0, 0.0, 0.0)
    for x, y, z in b.tolist():
        c = with_scale(c, x, y, z)
    shared = np.cross(b, moved).sum(axis=0)
    np.testing.assert_allclose(c[:2], shared[:2], atol=1e-8)
    assert shared[2] == pytest.approx(0, abs=1e-8)
    assert c[2] == pytest.approx(np.sum(moved**2), abs=1e-8)
