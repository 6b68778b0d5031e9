"""Against astropy and skyfield, whose numbers golden_numbers.py wrote down, to 0.1"."""

import json
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.attitude.attitude import Attitude
from star_tracker.earth.apparent import Atmosphere
from star_tracker.earth.attitude import Fix, azimuth_altitude_rad, enu_attitude, itrs_attitude
from star_tracker.earth.rotation import EarthOrientation, itrs_from_gcrs
from star_tracker.earth.site import Site
from star_tracker.geometry.spherical import unit_vectors

HERE = Path(__file__).resolve().parent
ARCSEC = np.radians(1 / 3600)
PLACES = json.loads((HERE / "golden_astropy.json").read_text(encoding="utf-8"))
TURNS = json.loads((HERE / "golden_skyfield.json").read_text(encoding="utf-8"))
FIELDS = [
    pytest.param(place, field, id=f"{place['name']}-{number}")
    for place in PLACES for number, field in enumerate(place["fields"])
]
#: A camera that is turned about its boresight too.
CAMERA_TURN = Rotation.from_euler("zyx", [40, 3, -2], degrees=True)


def nanoseconds(utc):
    moment = datetime.fromisoformat(utc.ljust(23, "0")).replace(tzinfo=timezone.utc)
    return int(moment.timestamp()) * 10**9 + moment.microsecond * 1000


def orientation_of(place):
    return EarthOrientation(place["ut1_utc_s"], place["xp_arcsec"], place["yp_arcsec"])


def site_of(place):
    return Site(place["latitude_deg"], place["longitude_deg"], place["height_m"])


def air_of(place):
    return Atmosphere(place["pressure_hpa"], place["temperature_c"])


def boresight_at(star):
    """Return the rotation (3, 3) of a camera whose boresight is a star, turned about it anyhow."""
    up = np.array([0.0, 0.0, 1.0])
    right = np.cross(star, up) / np.linalg.norm(np.cross(star, up))
    return np.column_stack([right, np.cross(star, right), star])


def camera_at(seen):
    """Return a camera (3, 3), to ENU, whose boresight is near the first of the stars."""
    return boresight_at(seen[0]) @ CAMERA_TURN.as_matrix()


def fix_of(camera, seen, field):
    """Fit the attitude of a camera (3, 3) that sees the stars of a field at `seen`, ENU."""
    catalogue = unit_vectors(np.radians(field["ra_deg"]), np.radians(field["dec_deg"]))
    fitted, _ = Rotation.align_vectors(catalogue, seen @ camera)
    return Fix(Attitude.from_rotation(fitted.as_matrix(), np.eye(3) * 1e-10), catalogue)


def error_arcsec(found, true):
    return np.linalg.norm(Rotation.from_matrix(found @ true.T).as_rotvec()) / ARCSEC


@pytest.mark.parametrize("seen_in", ["vacuum", "air"])
@pytest.mark.parametrize(("place", "field"), FIELDS)
def test_attitude_is_that_of_astropy(place, field, seen_in):
    seen = np.array(field[seen_in])
    camera = camera_at(seen)
    air = {"air": air_of(place)} if seen_in == "air" else {}
    found = enu_attitude(
        fix_of(camera, seen, field), nanoseconds(place["utc"]), site_of(place),
        orientation=orientation_of(place), **air,
    )
    assert error_arcsec(found.rotation, camera) < 0.1


@pytest.mark.parametrize(("place", "field"), FIELDS)
def test_attitude_of_the_boresight_alone_points_where_astropy_says(place, field):
    """One star in the middle: its direction is right; the rotation about it is not known."""
    first = {key: values[:1] for key, values in field.items()}
    seen = np.array(first["air"])
    (star,) = unit_vectors(np.radians(first["ra_deg"]), np.radians(first["dec_deg"]))
    found = enu_attitude(
        Fix.of_boresight(Attitude.from_rotation(boresight_at(star), np.eye(3))),
        nanoseconds(place["utc"]), site_of(place), orientation=orientation_of(place),
        air=air_of(place),
    )
    assert np.linalg.norm(found.rotation[:, 2] - seen[0]) < 0.1 * ARCSEC
    azimuth, altitude = azimuth_altitude_rad(found.rotation[:, 2])
    assert azimuth == pytest.approx(np.arctan2(seen[0, 0], seen[0, 1]) % (2 * np.pi), abs=1e-5)
    assert altitude == pytest.approx(np.arcsin(seen[0, 2]), abs=1e-6)


@pytest.mark.parametrize(("place", "field"), FIELDS)
def test_itrs_and_enu_agree_but_for_the_speed_of_the_ground(place, field):
    """The ground's speed is given to one by hand, the other knows it from the place."""
    seen, stamp, site = np.array(field["vacuum"]), nanoseconds(place["utc"]), site_of(place)
    fix, orientation = fix_of(camera_at(seen), seen, field), orientation_of(place)
    speed = itrs_from_gcrs(stamp, orientation).T @ site.velocity_itrs_m_per_s
    in_itrs = itrs_attitude(fix, stamp, orientation=orientation, velocity_m_per_s=speed)
    in_enu = enu_attitude(fix, stamp, site, orientation=orientation)
    assert error_arcsec(site.enu_from_itrs @ in_itrs.rotation, in_enu.rotation) < 1e-6
    without = itrs_attitude(fix, stamp, orientation=orientation)
    assert error_arcsec(without.rotation, in_itrs.rotation) < 0.33


@pytest.mark.parametrize("turn", TURNS, ids=[turn["utc"] for turn in TURNS])
def test_rotation_of_the_earth_is_that_of_skyfield(turn):
    found = itrs_from_gcrs(nanoseconds(turn["utc"]), EarthOrientation(turn["ut1_utc_s"]))
    assert error_arcsec(found, np.array(turn["itrs_from_gcrs"])) < 0.001
