"""A camera that turns during the exposure: streaks to an attitude."""

import numpy as np
import pytest

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

CAMERA = Camera.from_fov(20.0, 640, 480)
EXPOSURE_S, SKIES = 0.5, 8


@pytest.fixture(scope="module")
def tracker():
    settings = SolveSettings(method="match_group", deadline_ms=5000.0)
    return StarTracker(FeatureDatabase.for_camera(CAMERA), CAMERA, settings)


@pytest.fixture(scope="module")
def sky():
    return StarCatalog.named("hipparcos", limiting_magnitude=8.0)


def boresights_off_px(tracker, sky, length_px):
    """How far the boresight is off in each sky that is solved, px; the turn has any direction."""
    rng = np.random.default_rng(round(length_px))
    off_px = []
    for seed in range(SKIES):
        rotation, angle = random_rotation(rng), rng.uniform(0, 2 * np.pi)
        rate = np.degrees(length_px / CAMERA.fx_px) / EXPOSURE_S
        settings = RenderSettings(
            exposure_s=EXPOSURE_S, seed=seed,
            rate_deg_s=(float(rate * np.sin(angle)), float(rate * np.cos(angle)), 0.0),
        )
        stars = detect_stars(render(CAMERA, rotation, sky, settings).image)
        solution = tracker.solve(stars.xy_px, stars.flux)
        if solution.status is Status.SOLVED:
            found = solution.attitude.rotation[:, 2]
            off_px.append(separation(found, rotation[:, 2]) * CAMERA.fx_px)
    return np.array(off_px)


@pytest.mark.parametrize("length_px", [pytest.param(20.0, marks=pytest.mark.slow), 60.0])
def test_streaks_are_solved_for_the_middle_of_the_exposure(length_px, tracker, sky):
    """An end of the exposure would be half of the length off."""
    off_px = boresights_off_px(tracker, sky, length_px)
    assert len(off_px) == SKIES
    assert off_px.max() < 0.5


@pytest.mark.parametrize("length_px", [70.0, pytest.param(100.0, marks=pytest.mark.slow)])
def test_streaks_too_long_to_be_told_are_refused(length_px, tracker, sky):
    assert len(boresights_off_px(tracker, sky, length_px)) == 0
