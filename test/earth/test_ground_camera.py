"""A camera fixed to the ground over six hours: its stars go by, its attitude in ENU stays."""

import numpy as np
import pytest
from ground_camera import (
    AIR,
    CAMERA,
    HOURS,
    ORIENTATION,
    POSE,
    SIGMA_PX,
    SITE,
    START_NS,
    centroids_at,
)
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.earth.attitude import Fix, azimuth_altitude_rad, enu_attitude
from star_tracker.earth.rotation import EarthOrientation
from star_tracker.earth.site import EARTH_RATE_RAD_PER_S
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

ARCSEC = np.radians(1 / 3600)
EVERY_S = 600
N_FRAMES = HOURS * 3600 // EVERY_S + 1


@pytest.fixture(scope="module")
def frames(database):
    """Return (stamp, solution) of each frame of the night."""
    catalog = StarCatalog.paper()
    settings = SolveSettings(centroid_sigma_px=SIGMA_PX, deadline_ms=float("inf"))
    tracker, rng, taken = StarTracker(database, CAMERA, settings), np.random.default_rng(7), []
    for number in range(N_FRAMES):
        stamp_ns = START_NS + number * EVERY_S * 10**9
        solution = tracker.solve(centroids_at(stamp_ns, catalog, rng))
        assert solution.status is Status.SOLVED
        taken.append((stamp_ns, solution))
    return taken


def errors_of(frames, **options):
    """Return the errors (n, 3) of the attitude in ENU about the camera's axes, rad."""
    return np.array([
        Rotation.from_matrix(
            POSE.T @ enu_attitude(Fix.of_solution(solution), stamp, SITE, **options).rotation
        ).as_rotvec() for stamp, solution in frames
    ])


def test_imu_enu_stays_within_its_covariance(frames):
    errors = errors_of(frames, orientation=ORIENTATION, air=AIR)
    inverses = [np.linalg.inv(solution.attitude.covariance_rad2) for _, solution in frames]
    nees = np.einsum("ni,nij,nj->n", errors, inverses, errors)
    # All frames together, and each alone, within what chance leaves in 0.1 % of nights.
    assert chi2.ppf(5e-4, 3 * N_FRAMES) < nees.sum() < chi2.ppf(1 - 5e-4, 3 * N_FRAMES)
    assert nees.max() < chi2.ppf(1 - 1e-3 / N_FRAMES, 3)


def test_the_boresight_stands_where_the_camera_looks(frames):
    stamp, solution = frames[-1]
    found = enu_attitude(
        Fix.of_solution(solution), stamp, SITE, orientation=ORIENTATION, air=AIR
    )
    azimuth, altitude = np.degrees(azimuth_altitude_rad(found.rotation[:, 2]))
    assert (azimuth, altitude) == pytest.approx((140, 55), abs=12 / 3600)


def test_attitude_turns_at_the_sidereal_rate(frames):
    """About the Earth's axis, which lies within 0.15 deg of ICRS z, by 90 deg 15' in 6 h."""
    (first, before), (last, after) = frames[0], frames[-1]
    turn = Rotation.from_matrix(after.attitude.rotation @ before.attitude.rotation.T).as_rotvec()
    angle = np.linalg.norm(turn)
    wanted = EARTH_RATE_RAD_PER_S * (last - first) / 1e9
    # Refraction puts the same rotation into each, but for where the stars lie in the field.
    assert angle / ARCSEC == pytest.approx(wanted / ARCSEC, abs=60)
    assert np.degrees(np.arccos(turn[2] / angle)) < 0.2


def test_what_is_left_out_shows(frames):
    """Air lifts the stars by about 0.94 * 58" tan(35 deg), 0.05 s of UT1 turn them by 0.75"."""
    right = errors_of(frames, orientation=ORIENTATION, air=AIR)
    vacuum = errors_of(frames, orientation=ORIENTATION) - right
    assert np.linalg.norm(vacuum.mean(axis=0)) / ARCSEC == pytest.approx(38, abs=2)
    no_ut1 = errors_of(frames, orientation=EarthOrientation(0.0, 0.15, 0.3), air=AIR) - right
    assert np.linalg.norm(no_ut1, axis=1) / ARCSEC == pytest.approx(0.05 * 15.04, abs=0.01)
