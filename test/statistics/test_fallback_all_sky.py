"""The fallback alone: how often it works all over the sky, and never wrongly.

Everything is seeded, and a frame may take as long as it needs.
"""

import math

import numpy as np
import pytest

from star_tracker.attitude.attitude import covariance
from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import (
    CAMERAS,
    Condition,
    random_rotation,
    synthetic_field,
    uniform_noise,
)
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

pytestmark = pytest.mark.slow

CAMERA = CAMERAS["12 deg"]
N_ATTITUDES = 200
N_NOISE = 60


@pytest.fixture(scope="module")
def fallback(database):
    return StarTracker(database, CAMERA, SolveSettings("radial_cyclic", deadline_ms=math.inf))


@pytest.fixture(scope="module", params=[0.5, 3.0], ids=["0.5 px", "3 px"])
def frames(request, fallback):
    """The noise, and (truth, solution by the fallback alone) of random attitudes."""
    rng, catalog = np.random.default_rng(12), fallback.database.catalog
    truths = [
        synthetic_field(
            catalog, CAMERA, random_rotation(rng), rng, Condition(noise_px=request.param)
        )
        for _ in range(N_ATTITUDES)
    ]
    return request.param, [(truth, fallback.solve(truth.xy_px)) for truth in truths]


def solved(frames):
    return [(truth, found) for truth, found in frames[1] if found.status is Status.SOLVED]


def test_attitudes_all_over_the_sky_are_found_without_the_primary(frames):
    assert len(solved(frames)) >= {0.5: 0.98, 3.0: 0.95}[frames[0]] * N_ATTITUDES
    assert {found.method for _, found in solved(frames)} == {"radial_cyclic"}


def test_no_solution_of_the_fallback_is_wrong(frames):
    """One pixel is 0.023 deg: the limits are ten and four pixels."""
    limit_deg = {0.5: 0.1, 3.0: 0.3}[frames[0]]
    for truth, found in solved(frames):
        boresight, true = found.attitude.rotation[:, 2], truth.rotation[:, 2]
        assert np.degrees(separation(boresight, true)) < limit_deg


def test_every_attitude_of_the_fallback_is_as_good_as_the_noise_allows(frames):
    """error^T C^-1 error is chi-squared of 3 for the true noise: one in 10^6 is beyond 30.7."""
    for truth, found in solved(frames):
        stars = CAMERA.vectors(truth.xy_px)[found.identification.identified]
        information = np.linalg.inv(covariance(stars, frames[0] / CAMERA.focal_length_px))
        turn = truth.rotation.T @ found.attitude.rotation
        error = np.array([
            turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1],
        ]) / 2
        assert error @ information @ error < 30.7


def test_frames_that_the_fallback_does_not_solve_say_why(frames):
    states = {found.status for _, found in frames[1]} - {Status.SOLVED}
    assert states <= {Status.TOO_FEW_STARS, Status.NO_MATCH, Status.AMBIGUOUS}


def test_no_frame_of_noise_is_solved_by_the_fallback(fallback):
    """60 frames of 5 to 15 points; the threshold of 10^-3 false alarms allows for 0.06 at most."""
    rng = np.random.default_rng(112)
    # The smaller ones more often: a full search of 15 points costs five times that of 5.
    sizes = np.minimum(*rng.integers(5, 16, (2, N_NOISE)))
    states = [fallback.solve(uniform_noise(CAMERA, n, rng)).status for n in sizes.tolist()]
    assert len(states) == N_NOISE
    assert set(states) == {Status.NO_MATCH}
