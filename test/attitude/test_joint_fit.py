"""Rotation and focal length together: the fit from afar, the prior, covariance and scatter."""

import math

import numpy as np
import pytest
from engines import match_lists, pose_of, pose_parts, rotation_to
from scipy.spatial.transform import Rotation

from star_tracker.attitude.joint_fit import refine_scaled, write_covariance
from star_tracker.attitude.wahba import refine
from star_tracker.identification.judge import empty_matches
from star_tracker.optics.camera import Camera

CAMERA = Camera.from_fov(20, 1024, 1024)
TRUE = rotation_to(80.0, 30.0, 50.0)
SIGMA_PX = 0.3


def star_pixels(n, seed, camera=CAMERA):
    return np.random.default_rng(seed).random((n, 2)) * (camera.width_px, camera.height_px)


class Fit:
    """Stars of the sky, where a camera of another focal length puts them, and a pose of it."""

    def __init__(self, xy_px, *, scale=1.0, noise_px=0.0, rng=None, start=TRUE, start_scale=1.0):
        self.icrs = CAMERA.scaled(scale).vectors(xy_px) @ TRUE.T
        self.seen = xy_px + (rng.normal(0, noise_px, xy_px.shape) if noise_px else 0.0)
        self.pose = pose_of(np.ascontiguousarray(start).copy(), start_scale, True)
        self.matches = empty_matches(1, len(xy_px))
        observed, _, listed, _ = match_lists(self.matches)
        observed[:] = listed[:] = np.arange(len(xy_px))

    def step(self, prior=0.0, k=None):
        _, scale, _ = pose_parts(self.pose)
        camera = CAMERA.scaled(scale).vectors(self.seen)
        refine_scaled(
            camera, self.icrs, self.matches, k or len(self.seen), self.pose, prior
        )
        return pose_parts(self.pose)[:2]


def angle(a, b):
    return Rotation.from_matrix(a.T @ b).magnitude()


# The fit


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("off_rad", [0.0, 0.01])
@pytest.mark.parametrize("n", [4, 10, 40])
def test_rotation_and_scale_are_found_from_3_percent_and_a_hundredth_off(scale, off_rad, n):
    axis = np.array([0.6, -0.5, 0.62])
    start = TRUE @ Rotation.from_rotvec(off_rad * axis / np.linalg.norm(axis)).as_matrix()
    fit = Fit(star_pixels(n, n), scale=scale, start=start)
    for _ in range(6):
        rotation, found = fit.step()
    assert found == pytest.approx(scale, rel=1e-12)
    assert angle(rotation, TRUE) < 1e-11
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-13)


def test_one_step_leaves_an_error_of_second_order():
    start = TRUE @ Rotation.from_rotvec([0.002, -0.001, 0.003]).as_matrix()
    rotation, found = Fit(star_pixels(12, 1), scale=1.004, start=start).step()
    assert abs(found - 1.004) < 5 * 0.004**2
    assert angle(rotation, TRUE) < 10 * 0.004**2


def test_the_step_of_the_scale_is_bounded():
    """What begins far off must not run away: e^0.03 at a time."""
    _, found = Fit(star_pixels(12, 2), scale=1.3).step()
    assert found == pytest.approx(math.exp(0.03), rel=1e-12)


def test_at_the_true_scale_the_rotation_is_that_of_the_fit_without_it():
    fit = Fit(star_pixels(15, 3), start=TRUE @ Rotation.from_rotvec([1e-3, 2e-3, 0]).as_matrix())
    camera, every = CAMERA.vectors(fit.seen), np.arange(15)
    alone = pose_parts(fit.pose)[0].copy()
    for _ in range(4):
        rotation, _ = fit.step()
        refine(camera, every, fit.icrs, every, 15, alone)
    np.testing.assert_allclose(rotation, alone, atol=1e-12)


def test_only_the_first_matches_count():
    fit = Fit(star_pixels(10, 4), scale=1.01)
    fit.icrs[6:] = fit.icrs[6:][::-1].copy()
    for _ in range(6):
        rotation, found = fit.step(k=6)
    assert found == pytest.approx(1.01, rel=1e-12)
    assert angle(rotation, TRUE) < 1e-11


@pytest.mark.parametrize("n", [1, 2])
def test_two_stars_do_not_tell_the_scale(n):
    """One is refused; two turn the camera and leave its focal length."""
    start = TRUE @ Rotation.from_rotvec([1e-3, 0, 0]).as_matrix()
    rotation, found = Fit(star_pixels(n, 5), scale=1.02, start=start).step()
    assert found == 1.0
    assert (n == 1) == np.array_equal(rotation, start)


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0, 4.0, 1e6])
def test_a_prior_pulls_the_scale_by_its_share_of_the_information(weight):
    """The stars say e^0.01 with the information that the rotation leaves, the prior says 1."""
    xy, truth = star_pixels(12, 6), 0.01
    left = left_by_rotation(information_of(CAMERA.scaled(math.exp(truth)).vectors(xy)))
    fit = Fit(xy, scale=math.exp(truth))
    for _ in range(30):
        _, found = fit.step(prior=weight * left)
    assert math.log(found) == pytest.approx(truth / (1 + weight), abs=2e-5)


# Information and covariance


def information_of(vectors):
    """J^T J (4, 4) for three angles about the camera's axes and log f."""
    rows = []
    for x, y, z in vectors:
        turn = -np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])
        towards_axis = np.array([x, y, z]) * (1 - z * z) - (x, y, 0)
        rows.append(np.column_stack([turn, towards_axis]))
    jacobian = np.concatenate(rows)
    return jacobian.T @ jacobian


def left_by_rotation(information):
    """What is known of log f where the rotation is not."""
    m, c, e = information[:3, :3], information[:3, 3], information[3, 3]
    return e - c @ np.linalg.solve(m, c)


def covariance_of(vectors, variance, prior):
    result = np.empty((3, 3))
    n = len(vectors)
    of_scale = write_covariance(vectors, np.arange(n), n, (variance, prior), result)
    return result, of_scale


@pytest.mark.parametrize("prior", [0.0, 0.3, 50.0])
@pytest.mark.parametrize(("n", "fov_deg"), [(4, 12.0), (10, 20.0), (30, 90.0)])
def test_covariance_is_the_inverse_of_the_information_of_all_four(n, fov_deg, prior):
    camera = Camera.from_fov(fov_deg, 800, 600, principal_point_px=(350.0, None))
    vectors = camera.vectors(star_pixels(n, n, camera))
    information = information_of(vectors)
    information[3, 3] += prior
    expected = 1e-8 * np.linalg.inv(information)
    found, of_scale = covariance_of(vectors, 1e-8, prior)
    np.testing.assert_allclose(found, expected[:3, :3], rtol=1e-9, atol=1e-18)
    assert of_scale == pytest.approx(expected[3, 3], rel=1e-9)


def test_a_focal_length_that_is_known_has_no_variance_and_adds_none():
    vectors = CAMERA.vectors(star_pixels(9, 7))
    found, of_scale = covariance_of(vectors, 1e-8, np.inf)
    expected = 1e-8 * np.linalg.inv(information_of(vectors)[:3, :3])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-20)
    assert of_scale == 0
    nearly, _ = covariance_of(vectors, 1e-8, 1e12)
    np.testing.assert_allclose(nearly, expected, rtol=1e-9, atol=1e-18)


def test_not_knowing_the_focal_length_never_makes_an_attitude_more_certain():
    vectors = CAMERA.vectors(star_pixels(6, 8))
    known, free = (covariance_of(vectors, 1e-8, prior)[0] for prior in (np.inf, 0.0))
    assert np.all(np.linalg.eigvalsh(free - known) > -1e-16)


@pytest.mark.parametrize("prior_sigma", [None, 1e-3], ids=["no prior", "0.1 %"])
def test_covariance_is_the_scatter_of_fits(prior_sigma):
    """1500 seeded trials: a variance scatters by sqrt(2 / 1500) = 3.7 %.

    With a prior the true focal length is drawn from it.
    """
    rng, n, trials = np.random.default_rng(9), 8, 1500
    xy, direction_rad = star_pixels(n, 10), SIGMA_PX / CAMERA.focal_length_px
    # The pixels' errors are those of directions only near the boresight: put the stars there.
    xy = 512 + 0.3 * (xy - 512)
    prior = 0.0 if prior_sigma is None else (direction_rad / prior_sigma) ** 2
    errors = np.empty((trials, 4))
    for error in errors:
        truth = 0.0 if prior_sigma is None else rng.normal(0, prior_sigma)
        fit = Fit(xy, scale=math.exp(truth), noise_px=SIGMA_PX, rng=rng)
        for _ in range(3):
            rotation, scale = fit.step(prior)
        error[:3] = Rotation.from_matrix(TRUE.T @ rotation).as_rotvec()
        error[3] = math.log(scale) - truth
    found, of_scale = covariance_of(CAMERA.vectors(xy), direction_rad**2, prior)
    whiten = np.linalg.inv(np.linalg.cholesky(found))
    scatter = whiten @ np.cov(errors[:, :3].T) @ whiten.T
    np.testing.assert_allclose(scatter, np.eye(3), atol=0.16)
    assert np.var(errors[:, 3]) == pytest.approx(of_scale, rel=0.16)
    assert np.all(np.abs(whiten @ errors[:, :3].mean(axis=0)) < 4 / math.sqrt(trials))
