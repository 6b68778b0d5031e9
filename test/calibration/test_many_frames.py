"""One camera from all its frames."""

import numpy as np
import pytest
from test_learning import BRIGHT_SKY, SIZE_PX, frames, tracker

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
    found = calibrate_frames(tracker(), sightings(true, 8, seed=11, least=20))
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
