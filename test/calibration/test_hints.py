"""Hints: what would solve a frame that was not solved."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from star_tracker.calibration import hints
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.identification.labels import Identification
from star_tracker.maps.simulation import synthetic_field, uniform_noise
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

CAMERA = Camera.from_fov(12, 512, 512)
SETTINGS = SolveSettings()
PATIENT_MS = 60_000.0


def unsolved(status=Status.NO_MATCH):
    return Solution(status, "nothing", Identification.empty(0))


def hint(database, camera, settings, xy_px, budget_ms, *, solution=None):
    return hints.hint(database, (camera, settings), xy_px, solution or unsolved(), budget_ms)


@pytest.fixture(scope="module")
def xy_px(database):
    rotation = rotation_from_boresight(1.9, 0.6, 0.3)
    rng = np.random.default_rng(1)
    return synthetic_field(database.catalog, CAMERA, rotation, rng, noise_px=0.1).xy_px


@pytest.mark.parametrize(("seen", "configured"), [("normal", "mirrored"), ("mirrored", "normal")])
def test_a_wrong_parity_is_named(database, xy_px, seen, configured):
    xy = xy_px if seen == "normal" else xy_px * (1, -1) + (0, 512)
    text = hint(database, CAMERA.with_parity(configured), SETTINGS, xy, PATIENT_MS)
    assert text == f"image looks mirrored: parity {seen} solves it"


@pytest.mark.parametrize("percent", [-4, -2.7, -2, 2, 3, 4])
@pytest.mark.parametrize("parity", ["normal", "auto"])
def test_a_wrong_field_of_view_is_named(database, xy_px, percent, parity):
    configured = 12.0 * (1 + percent / 100)
    camera = Camera.from_fov(configured, 512, 512, parity=parity)
    text = hint(database, camera, SETTINGS, xy_px, PATIENT_MS)
    words = re.fullmatch(r"improves if fov_deg is (\S+) instead of (\S+)", text)
    # Noise of 0.1 px over some 200 px, and rounding to 0.01 deg.
    assert float(words[1]) == pytest.approx(12.0, abs=0.02)
    assert float(words[2]) == pytest.approx(configured, abs=0.006)


@pytest.mark.parametrize("number", [1, 2, 7])
@pytest.mark.parametrize("percent", [-4, 4])
def test_a_frame_solved_with_a_wrong_field_of_view_names_a_better_one(database, number, percent):
    star_map = paper_maps((number,))[0]
    width, true = star_map.camera.width_px, star_map.camera.fov_deg
    camera = Camera.from_fov(true * (1 + percent / 100), width, width, parity="mirrored")
    patient = SolveSettings(deadline_ms=PATIENT_MS)
    solution = StarTracker(database, camera, patient).solve(star_map.xy_px)
    assert solution.status is Status.SOLVED
    text = hint(database, camera, patient, star_map.xy_px, PATIENT_MS, solution=solution)
    assert text == f"improves if fov_deg is {true:.2f} instead of {camera.fov_deg:.2f}"


def test_a_frame_solved_well_needs_no_hint(database, xy_px):
    solution = StarTracker(database, CAMERA, SETTINGS).solve(xy_px)
    assert not hints.wants_hint(solution)
    assert hint(database, CAMERA, SETTINGS, xy_px, PATIENT_MS, solution=solution) == ""


@pytest.mark.parametrize("status", Status)
def test_frames_that_may_get_a_hint(status):
    wanted = status in (Status.NO_MATCH, Status.TIMEOUT)
    assert hints.wants_hint(unsolved(status)) == wanted


def test_an_empty_sky_gives_no_hint(database):
    for seed in range(3):
        xy = uniform_noise(CAMERA, 15, np.random.default_rng(seed))
        assert hint(database, CAMERA, SETTINGS, xy, PATIENT_MS) == ""


def test_without_time_there_is_no_hint(database, xy_px):
    mirrored = CAMERA.with_parity("mirrored")
    for budget_ms in (0.0, -5.0, 0.5):
        assert hint(database, mirrored, SETTINGS, xy_px, budget_ms) == ""


def test_the_trials_share_the_budget(database, monkeypatch):
    """Trials that each take all the time that they get, by a clock that only they advance."""
    now, taken = [7.0], []

    class SlowTracker(StarTracker):
        def solve(self, xy_px):
            if len(xy_px):  # it is made with a frame of nothing
                taken.append(self.settings.deadline_ms)
                now[0] += self.settings.deadline_ms / 1e3
            return unsolved(Status.TIMEOUT)

    monkeypatch.setattr(hints, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    monkeypatch.setattr(hints, "StarTracker", SlowTracker)
    xy = uniform_noise(CAMERA, 60, np.random.default_rng(7))
    assert hint(database, CAMERA, SETTINGS, xy, 50.0) == ""
    assert sum(taken) == pytest.approx(50.0)
    assert len(taken) > 3
    assert min(taken) == pytest.approx(max(taken))


def test_a_field_of_view_at_the_end_of_its_range_is_not_left(database):
    xy = uniform_noise(CAMERA, 6, np.random.default_rng(7))
    narrow = Camera.from_fov(0.5, 512, 512)
    assert hint(database, narrow, SETTINGS, xy, PATIENT_MS) == ""
    assert math.isclose(narrow.fov_deg, 0.5)
