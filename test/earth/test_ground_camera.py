"""A camera fixed to the ground over six hours: its stars go by, its attitude in ENU stays."""

from datetime import datetime, timezone

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.earth.apparent import Atmosphere, aberrated, refracted
from star_tracker.earth.attitude import Fix, azimuth_altitude_rad, enu_attitude
from star_tracker.earth.rotation import (
    EarthOrientation,
    earth_velocity_m_per_s,
    itrs_from_gcrs,
)
from star_tracker.earth.site import EARTH_RATE_RAD_PER_S, Site
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

ARCSEC = np.radians(1 / 3600)
START_NS = int(datetime(2024, 11, 2, 18, tzinfo=timezone.utc).timestamp()) * 10**9
EVERY_S, N_FRAMES = 600, 37
SITE = Site(47.3, 8.5, 500.0)
ORIENTATION = EarthOrientation(0.05, 0.15, 0.3)
AIR = Atmosphere(955.0, 8.0)
#: Of 35" pixels. With less noise, what refraction does unevenly across the field shows in the
#: residuals, and the covariance is larger than chance alone would have it.
SIGMA_PX = 0.3
CAMERA = Camera.from_fov(20.0, 2048, 2048)
#: The camera's axes in ENU: it looks 55 deg up, towards azimuth 140 deg, turned by 25 deg.
POSE = (
    Rotation.from_euler("z", -140, degrees=True)  # x right of the view, y its direction
    * Rotation.from_euler("x", 55, degrees=True)
    * Rotation.from_matrix(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))  # REP-103, optical
    * Rotation.from_euler("z", 25, degrees=True)
).as_matrix()


def seen_at(stamp_ns, catalog):
    """Return the directions (n, 3) of all stars, ENU, as the camera would see them."""
    to_itrs = itrs_from_gcrs(stamp_ns, ORIENTATION)
    ground = to_itrs.T @ SITE.velocity_itrs_m_per_s
    seen = aberrated(catalog.vectors, earth_velocity_m_per_s(stamp_ns) + ground)
    to_enu = SITE.enu_from_itrs @ to_itrs
    high = seen[seen @ to_enu[2] > 0.2]
    return refracted(high, to_enu[2], AIR) @ to_enu.T


@pytest.fixture(scope="module")
def frames(database):
    """Return (stamp, solution) of each frame of the night."""
    catalog = StarCatalog.paper()
    settings = SolveSettings(centroid_sigma_px=SIGMA_PX, deadline_ms=float("inf"))
    tracker, rng, taken = StarTracker(database, CAMERA, settings), np.random.default_rng(7), []
    for number in range(N_FRAMES):
        stamp_ns = START_NS + number * EVERY_S * 10**9
        in_camera = seen_at(stamp_ns, catalog) @ POSE
        in_camera = in_camera[in_camera[:, 2] > 0.5]
        xy = CAMERA.focal_length_px * in_camera[:, :2] / in_camera[:, 2:] + 1024
        xy = xy[np.all((xy > 0) & (xy < 2048), axis=1)]
        solution = tracker.solve(xy + rng.normal(scale=SIGMA_PX, size=xy.shape))
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
