"""One camera from all its frames."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_learning import BRIGHT_SKY, SIZE_PX, SKY, frames, off_deg, tracker

from star_tracker.calibration.many_frames import Sighting, calibrate_frames
from star_tracker.maps.simulation import uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

BENT = Distortion("plumb_bob", (-0.15, 0.05, 0.0, 0.0, 0.0))
NOISE_PX = 0.2


def sightings(camera, n, **options):
    return [
        Sighting(xy, None)
        for xy, _ in frames(camera, n, noise_px=NOISE_PX, sky=BRIGHT_SKY, **options)
    ]


def test_focal_length_and_lens_come_out_within_their_errors():
    plain = Camera.from_fov(40.0, *SIZE_PX)
    true = Camera(*SIZE_PX, plain.fx_px, plain.fy_px, plain.cx_px, plain.cy_px, "normal", BENT)
    # The first of these frames alone does not show the lens.
    found = calibrate_frames(tracker(), sightings(true, 8, seed=13, least=20))
    camera, errors = found.estimate.camera, found.estimate.standard_errors
    assert found.used.all()
    assert abs(np.log(camera.fx_px / true.fx_px)) < 4 * errors[0] < 2e-3
    k1, k2 = camera.distortion.coefficients[:2]
    assert abs(k1 - BENT.coefficients[0]) < 4 * errors[1]
    assert abs(k2 - BENT.coefficients[1]) < 4 * errors[2]
    # Both coordinates, and a few of the stars are blends.
    assert found.rms_after_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.15)
    assert found.rms_before_px > 2 * found.rms_after_px
    assert found.n_stars > 8 * 20


def test_frames_that_show_no_sky_are_left_out():
    camera = Camera.from_fov(20.0, *SIZE_PX, tolerance_percent=5.0)
    noise = Sighting(uniform_noise(camera, 8, np.random.default_rng(1)), None)
    found = calibrate_frames(tracker(camera), [noise, *sightings(camera, 3), noise])
    assert found.used.tolist() == [False, True, True, True, False]
    assert found.before.fov_deg == pytest.approx(20.0)


def test_without_a_solved_frame_there_is_no_calibration():
    camera = Camera.from_fov(20.0, *SIZE_PX, tolerance_percent=5.0)
    noise = Sighting(uniform_noise(camera, 6, np.random.default_rng(1)), None)
    with pytest.raises(ValueError, match="none of 2 frames was solved: without stars there is"):
        calibrate_frames(tracker(camera), [noise, noise])


def calibrated_with_center(camera, n, **options):
    """What `n` frames of a camera tell with and without the principal point, and those frames."""
    several = frames(camera, n, noise_px=NOISE_PX, **options)
    shown = [Sighting(xy, None) for xy, _ in several]
    kept, fitted = (
        calibrate_frames(tracker(), shown, principal_point=asked) for asked in (False, True)
    )
    return kept, fitted, several


@pytest.mark.slow
def test_a_principal_point_that_is_off_is_found_where_that_is_asked_for():
    """Then the stars lie at the noise, and the boresight is the lens' axis."""
    true = replace(
        Camera.from_fov(50.0, *SIZE_PX), cx_px=272.0, cy_px=244.0,
        distortion=Distortion("plumb_bob", (-0.25, 0.05, 0.0, 0.0, 0.0)),
    )
    kept, fitted, several = calibrated_with_center(
        true, 12, seed=21, least=25, sky=BRIGHT_SKY
    )
    camera, errors = fitted.estimate.camera, fitted.estimate.standard_errors[-2:]
    moved = np.subtract((camera.cx_px, camera.cy_px), (true.cx_px, true.cy_px))
    assert np.all(np.abs(moved) < 4 * errors)
    assert np.all(errors < 1.0)
    np.testing.assert_array_equal(fitted.center_error_px, errors)
    assert fitted.rms_after_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.15)
    assert fitted.rms_after_px < 0.75 * kept.rms_after_px
    assert (kept.center_error_px, kept.estimate.camera.cx_px) == (None, SIZE_PX[0] / 2)
    told = [replace(one.estimate.camera, tolerance_percent=0.0) for one in (kept, fitted)]
    for xy, rotation in several[:4]:
        before, after = (off_deg(tracker(one).solve(xy), rotation) for one in told)
        assert before > 1.5  # 20 px are 2.1 deg
        assert after < 0.1 * before


@pytest.mark.slow
def test_a_principal_point_that_the_stars_do_not_show_stays():
    """A narrow field would move it by noise, and turn the boresight of all frames with it."""
    kept, fitted, several = calibrated_with_center(
        Camera.from_fov(12.0, *SIZE_PX), 8, seed=22, sky=SKY
    )
    assert fitted.estimate.camera == kept.estimate.camera
    assert fitted.estimate.names == kept.estimate.names
    assert np.all(fitted.center_error_px > 2.0)
    camera = replace(fitted.estimate.camera, tolerance_percent=0.0)
    for xy, rotation in several:
        solution = tracker(camera).solve(xy)
        error = Rotation.from_matrix(solution.attitude.rotation.T @ rotation).as_rotvec()
        assert error @ np.linalg.solve(solution.attitude.covariance_rad2, error) < 16.3
