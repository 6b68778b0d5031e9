"""A camera from many frames: what the stars tell comes out within its standard errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.camera_estimator import CameraEstimator
from star_tracker.calibration.camera_model import CENTER, PARAMETERS, CameraModel
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

WIDE = Camera(
    1024, 768, 1100.0, 1100.0, 512.0, 384.0, "normal",
    Distortion("plumb_bob", (-0.25, 0.08, 0.002, -0.003, 0.0)),
)
NARROW = Camera.from_fov(10, 512, 512)
#: 50 deg, its lens 20 px off the middle of the image.
DECENTRED = replace(
    Camera.from_fov(50, 1024, 768), cx_px=528.0, cy_px=372.0,
    distortion=Distortion("plumb_bob", (-0.25, 0.05, 0.0, 0.0, 0.0)),
)


def skies(camera, n, rng, *, stars=40, noise_px=0.2):
    """Frames of stars all over the image: centroids, ICRS vectors and the random attitude."""
    for _ in range(n):
        xy = rng.random((stars, 2)) * (camera.width_px, camera.height_px)
        rotation = random_rotation(rng)
        yield xy + rng.normal(0, noise_px, xy.shape), camera.vectors(xy) @ rotation.T, rotation


def frames(camera, n, rng, **options):
    """The same without the attitude."""
    for xy, vectors, _ in skies(camera, n, rng, **options):
        yield xy, vectors


def takes(estimator, xy, stars):
    """Whether a frame goes in, all of whose stars are identified."""
    each = np.arange(len(xy))
    return estimator.add_frame(xy, stars, (each, each)) is not None


def started(true, *, scale=1.0):
    return Camera(
        true.width_px, true.height_px, true.fx_px * scale, true.fy_px * scale,
        true.width_px / 2, true.height_px / 2, true.parity,
    )


def test_a_bent_lens_is_found_within_its_errors():
    rng = np.random.default_rng(1)
    estimator = CameraEstimator(started(WIDE, scale=1.01), 0.02)
    for xy, stars in frames(WIDE, 30, rng):
        assert takes(estimator, xy, stars)
    found = estimator.estimate
    errors = found.standard_errors
    assert abs(np.log(found.camera.fx_px / WIDE.fx_px)) < 4 * errors[0]
    terms = np.array(found.camera.distortion.coefficients[:4])
    true = np.array(WIDE.distortion.coefficients[:4])
    assert np.all(np.abs(terms - true) < 4 * errors[1:])
    assert errors[0] < 3e-4
    assert found.sigma_px == pytest.approx(0.2, rel=0.25)
    assert (found.n_frames, found.n_left_out) == (30, 0)


def test_what_a_narrow_field_cannot_tell_stays_as_it_was():
    rng = np.random.default_rng(2)
    estimator = CameraEstimator(NARROW, 0.05)
    for xy, stars in frames(NARROW, 5, rng, stars=12, noise_px=0.5):
        takes(estimator, xy, stars)
    found = estimator.estimate
    assert (found.camera.cx_px, found.camera.cy_px) == (NARROW.cx_px, NARROW.cy_px)
    assert found.camera.fx_px == pytest.approx(NARROW.fx_px, rel=4 * found.standard_errors[0])
    # A wrong bend of the corners is within the noise.
    corner = NARROW.vectors([(10.0, 10.0)])
    np.testing.assert_allclose(found.camera.pixels(corner), [(10.0, 10.0)], atol=2.0)


def test_a_frame_of_another_camera_is_left_out_and_many_of_them_say_so():
    rng = np.random.default_rng(3)
    estimator = CameraEstimator(NARROW, 0.01)
    for xy, stars in frames(NARROW, 10, rng):
        takes(estimator, xy, stars)
    zoomed = started(NARROW, scale=1.3)
    for n, (xy, stars) in enumerate(frames(zoomed, 5, rng)):
        assert not estimator.optics_changed, n
        assert not takes(estimator, xy, stars)
    assert estimator.optics_changed
    assert estimator.estimate.n_left_out == 5


def test_one_wrong_star_hardly_moves_the_camera():
    rng = np.random.default_rng(4)
    clean, spoilt = CameraEstimator(NARROW, 0.02), CameraEstimator(NARROW, 0.02)
    for xy, stars in frames(NARROW, 20, rng):
        takes(clean, xy, stars)
        xy[0] += 30.0
        takes(spoilt, xy, stars)
    shift = np.log(spoilt.estimate.camera.fx_px / clean.estimate.camera.fx_px)
    assert abs(shift) < 3 * clean.estimate.standard_errors[0]


def test_few_stars_are_left_out():
    estimator = CameraEstimator(NARROW, 0.02)
    xy = np.array([(10.0, 20.0), (200, 50), (300, 400), (90, 310)])
    assert not takes(estimator, xy, NARROW.vectors(xy))
    assert estimator.estimate.n_left_out == 1


def test_a_lens_of_another_model_is_kept():
    fisheye = Camera(800, 600, 500.0, 500.0, 400.0, 300.0, "normal",
                     Distortion("equidistant", (0.01, 0.0, 0.0, 0.0)))
    rng = np.random.default_rng(5)
    estimator = CameraEstimator(fisheye, 0.02)
    for xy, stars in frames(fisheye, 5, rng):
        assert takes(estimator, xy, stars)
    assert estimator.estimate.camera.distortion == fisheye.distortion


@pytest.mark.parametrize("parity", ["normal", "mirrored"])
@pytest.mark.parametrize("with_center", [False, True])
def test_what_the_parameters_move(parity, with_center):
    """Held against differences."""
    camera = replace(WIDE, fy_px=1050.0, parity=parity)
    model = CameraModel(camera, with_center=with_center)
    assert model.names == PARAMETERS + (CENTER if with_center else ())
    vectors = camera.vectors(np.random.default_rng(6).random((20, 2)) * (1024, 768))
    at, _, of_camera = model.moves(model.start, vectors)
    np.testing.assert_allclose(at, camera.pixels(vectors))
    assert of_camera.shape == (40, len(model.names))
    for i, moved in enumerate(1e-6 * np.eye(len(model.names))):
        ahead, behind = (
            model.camera(model.start + sign * moved).pixels(vectors) for sign in (1, -1)
        )
        np.testing.assert_allclose(of_camera[:, i], (ahead - behind).ravel() / 2e-6, atol=1e-5)


@pytest.mark.slow
def test_a_principal_point_that_is_off_is_found_within_its_errors():
    """And with it the boresight, which the tangential terms leave where it was told."""
    told, squares, off_deg = started(DECENTRED, scale=1.005), [], {True: [], False: []}
    for seed in range(8):
        for fits in (True, False):
            rng = np.random.default_rng(100 + seed)
            estimator = CameraEstimator(told, 0.02, told=told if fits else None)
            for xy, stars, _ in skies(DECENTRED, 10, rng):
                assert takes(estimator, xy, stars)
            found = estimator.estimate
            if fits:
                moved = np.subtract(
                    (found.camera.cx_px, found.camera.cy_px), (DECENTRED.cx_px, DECENTRED.cy_px)
                )
                squares.append(moved @ np.linalg.solve(found.covariance[-2:, -2:], moved))
                assert max(found.standard_errors[-2:]) < 1.0
            xy, stars, rotation = next(skies(DECENTRED, 1, rng))
            axis = wahba(found.camera.vectors(xy), stars)[:, 2]
            off_deg[fits].append(np.degrees(np.arccos(axis @ rotation[:, 2])))
    low, high = chi2.ppf((0.0005, 0.9995), 2 * len(squares))
    assert low < np.sum(squares) < high
    # 20 px are 1.04 deg; with it three standard errors of 0.6 px at the most are left.
    assert min(off_deg[False]) > 1.0
    assert max(off_deg[True]) < 0.1


@pytest.mark.slow
def test_a_principal_point_that_is_not_off_moves_no_farther_than_its_errors():
    squares = []
    for seed in range(8):
        rng = np.random.default_rng(200 + seed)
        estimator = CameraEstimator(NARROW, 0.02, told=NARROW)
        for xy, stars in frames(NARROW, 10, rng, stars=15, noise_px=0.3):
            takes(estimator, xy, stars)
        found = estimator.estimate
        # A narrow field shows little of it: the prior is 15 px.
        assert 3.0 < min(found.standard_errors[-2:]) <= max(found.standard_errors[-2:]) < 15.4
        moved = np.subtract(
            (found.camera.cx_px, found.camera.cy_px), (NARROW.cx_px, NARROW.cy_px)
        )
        squares.append(moved @ np.linalg.solve(found.covariance[-2:, -2:], moved))
    assert np.sum(squares) < chi2.ppf(0.9995, 2 * len(squares))
