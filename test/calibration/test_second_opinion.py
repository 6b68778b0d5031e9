"""What would solve a frame that a camera, taken at its word, did not solve."""

import re

import numpy as np
import pytest

from star_tracker.calibration.second_opinion import SecondOpinion, is_doubtful
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.identification.labels import Identification
from star_tracker.maps.simulation import Condition, synthetic_field, uniform_noise
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

CAMERA = Camera.from_fov(12, 512, 512)
SETTINGS = SolveSettings()
PATIENT_MS = 60_000.0


def unsolved(status=Status.NO_MATCH):
    return Solution(status, "nothing", Identification.empty(0))


def hint(database, camera, xy_px, solution=None):
    return SecondOpinion(database, camera, SETTINGS).hint(
        xy_px, None, solution or unsolved(), PATIENT_MS
    )


@pytest.fixture(scope="module")
def xy_px(database):
    rotation = rotation_from_boresight(1.9, 0.6, 0.3)
    rng = np.random.default_rng(1)
    return synthetic_field(database.catalog, CAMERA, rotation, rng, Condition(noise_px=0.1)).xy_px


@pytest.mark.parametrize(("seen", "configured"), [("normal", "mirrored"), ("mirrored", "normal")])
def test_a_wrong_parity_is_named(database, xy_px, seen, configured):
    xy = xy_px if seen == "normal" else xy_px * (1, -1) + (0, 512)
    text = hint(database, CAMERA.with_parity(configured), xy)
    assert text == f"image looks mirrored: parity {seen} solves it"


@pytest.mark.parametrize("percent", [-8, -4, -2, 2, 4, 8])
@pytest.mark.parametrize("parity", ["normal", "auto"])
def test_a_wrong_field_of_view_is_named(database, xy_px, percent, parity):
    configured = 12.0 * (1 + percent / 100)
    text = hint(database, Camera.from_fov(configured, 512, 512, parity=parity), xy_px)
    words = re.fullmatch(
        r"improves if fov_deg is (\S+) instead of (\S+), or may be off: fov_tolerance_percent",
        text,
    )
    # Noise of 0.1 px over some 200 px, and rounding to 0.01 deg.
    assert float(words[1]) == pytest.approx(12.0, abs=0.02)
    assert float(words[2]) == pytest.approx(configured, abs=0.006)


@pytest.mark.parametrize("number", [1, 2, 7])
@pytest.mark.parametrize("percent", [-4, 4])
def test_a_map_seen_with_a_wrong_field_of_view_names_a_better_one(database, number, percent):
    star_map = paper_maps((number,))[0]
    width, true = star_map.camera.width_px, star_map.camera.fov_deg
    camera = Camera.from_fov(true * (1 + percent / 100), width, width, parity="mirrored")
    patient = SolveSettings(deadline_ms=PATIENT_MS)
    solution = StarTracker(database, camera, patient).solve(star_map.xy_px)
    text = hint(database, camera, star_map.xy_px, solution)
    words = re.match(r"improves if fov_deg is (\S+) instead of (\S+), or", text)
    assert float(words[1]) == pytest.approx(true, abs=0.015)
    assert words[2] == f"{camera.fov_deg:.2f}"


def test_a_frame_solved_well_is_not_doubted(database, xy_px):
    solution = StarTracker(database, CAMERA, SETTINGS).solve(xy_px)
    assert not is_doubtful(solution)
    assert hint(database, CAMERA, xy_px, solution) == ""


@pytest.mark.parametrize("status", Status)
def test_frames_that_are_doubted(status):
    assert is_doubtful(unsolved(status)) == (status in (Status.NO_MATCH, Status.TIMEOUT))


def test_points_that_are_no_stars_give_no_hint(database):
    opinion = SecondOpinion(database, CAMERA, SETTINGS)
    for seed in range(3):
        xy = uniform_noise(CAMERA, 15, np.random.default_rng(seed))
        assert opinion.hint(xy, None, unsolved(), PATIENT_MS) == ""
