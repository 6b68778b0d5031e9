"""Centroids that crowd: found where they are, not where there are none, and no solution."""

import numpy as np
import pytest
from engines import CAMERA, frame_of

from star_tracker.compiled import compiled
from star_tracker.identification.crowd import crowding, no_crowd
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field, uniform_noise
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

AREA_PX2 = float(CAMERA.width_px * CAMERA.height_px)
PATIENT = SolveSettings(method="match_group", deadline_ms=float("inf"))


@compiled
def looked_at(frame, area_px2, observed):
    crowd = no_crowd()
    value = crowding(crowd, frame, area_px2, observed, len(observed))
    return value, crowd.share, crowd.x, crowd.y, crowd.xx, crowd.yy


def look(xy_px, which=None):
    """Crowding of the first five centroids from the left, or those that are named; the crowd."""
    frame = frame_of(xy_px)
    observed = np.arange(5) if which is None else np.asarray(which)
    value, *crowd = looked_at(frame, AREA_PX2, observed)
    return value, crowd


@pytest.mark.parametrize("n", [5, 10, 40, 300])
def test_even_centroids_are_no_crowd(n):
    rng = np.random.default_rng(n)
    found = [look(uniform_noise(CAMERA, n, rng)) for _ in range(50)]
    assert sum(value > 0 for value, _ in found) <= 1


@pytest.mark.parametrize("sigma_px", [10.0, 30.0])
def test_a_crowd_is_found_among_others(sigma_px):
    rng = np.random.default_rng(3)
    middle = np.array([300.0, 180.0])
    crowd = middle + rng.normal(0, sigma_px, (30, 2))
    others = uniform_noise(CAMERA, 6, rng)
    xy = np.concatenate([crowd, others])
    ordered = np.argsort(xy[:, 0])
    inside = np.flatnonzero(ordered < 30)[10:15]
    value, (share, x, y, xx, yy) = look(xy, inside)
    assert share == pytest.approx(30 / 36, abs=0.12)
    assert np.hypot(x + CAMERA.cx_px - middle[0], y + CAMERA.cy_px - middle[1]) < sigma_px
    assert np.sqrt([xx, yy]) == pytest.approx([sigma_px, sigma_px], rel=0.35)
    # Five places, each about as much likelier as the crowd is denser than the image.
    densest = share * AREA_PX2 / (2 * np.pi * np.sqrt(xx * yy))
    assert 1.5 < value < 5 * np.log10(densest)
    outside = np.flatnonzero(ordered >= 30)[:3]
    assert look(xy, outside)[0] < 0.6 * value


def test_a_sky_with_a_swarm_of_false_stars_is_solved_as_often_as_without_the_model(database):
    """24 of 29 either way: the search begins with stars whose companions are near, the swarm."""
    tracker = StarTracker(database, CAMERA, PATIENT)
    rng, solved, possible = np.random.default_rng(5), 0, 0
    for _ in range(30):
        frame = synthetic_field(
            database.catalog, CAMERA, random_rotation(rng), rng, Condition(noise_px=0.3)
        )
        if len(frame.xy_px) < 7:
            continue
        swarm = rng.uniform(100, 400, 2) + rng.normal(0, 12, (20, 2))
        solution = tracker.solve(np.concatenate([frame.xy_px, swarm]))
        possible += 1
        solved += solution.status is Status.SOLVED
    assert (solved, possible) == (24, 29)


def clumps():
    """150 tight clumps of noise."""
    rng = np.random.default_rng(6)
    for _ in range(150):
        n, middle = int(rng.integers(25, 41)), rng.uniform(100, 410, 2)
        yield np.clip(middle + rng.normal(0, rng.uniform(5, 50), (n, 2)), 0, 511)


@pytest.mark.parametrize(
    "which", [slice(0, 40), pytest.param(slice(40, 150), marks=pytest.mark.slow)]
)
def test_tight_clumps_of_noise_are_not_solved(database, which):
    """Without the crowd 2 of 100 were."""
    tracker = StarTracker(database, CAMERA, PATIENT)
    for xy in list(clumps())[which]:
        assert tracker.solve(xy).status is not Status.SOLVED
