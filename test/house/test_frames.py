"""Every number in the tables of docs/frames.md is what the package computes."""

from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from test_conventions import last_digit, tables_of, value

from star_tracker.earth.apparent import Atmosphere, aberrated, refracted
from star_tracker.earth.attitude import EarthAttitude
from star_tracker.earth.rotation import itrs_from_gcrs
from star_tracker.earth.site import Site

pytest.importorskip("erfa", reason="pyerfa is an extra")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "frames.md"
ARCSEC = np.radians(1 / 3600)
DIRECTIONS = {
    "up": (0, 0, 1), "north": (0, 1, 0), "east": (1, 0, 0), "south": (0, -1, 0),
}


def stamp_of(utc):
    moment = datetime.fromisoformat(utc).replace(tzinfo=timezone.utc)
    return int(moment.timestamp()) * 10**9 + moment.microsecond * 1000


def rotation_angle(row):
    stamp = stamp_of(row["utc"])
    # Greenwich's meridian in ITRS is x; the pole's own motion moves its right ascension by < 1".
    x = itrs_from_gcrs(stamp)[0]
    return {
        "jd": stamp / 86400e9 + 2440587.5, "era_deg": np.degrees(np.arctan2(x[1], x[0])) % 360,
    }


def pole(row):
    site, rotation = Site(value(row["latitude_deg"]), 8.5), itrs_from_gcrs(stamp_of("2024-06-05"))
    intermediate_pole = rotation.T @ [0, 0, 1]  # without polar motion, ITRS z is the axis
    return dict(zip(
        ("east", "north", "up"), site.enu_from_itrs @ rotation @ intermediate_pole, strict=True
    ))


def camera(row):
    z, y = np.array(DIRECTIONS[row["looks"]]), -np.array(DIRECTIONS[row["top"]])
    attitude = EarthAttitude.from_rotation(np.column_stack([np.cross(y, z), y, z]), np.eye(3))
    return dict(zip("xyzw", attitude.quaternion_xyzw, strict=True))


def aberration(row):
    velocity = np.array([1e3 * value(row["speed_km_s"]), 0, 0])
    (seen,) = aberrated(np.array([[0.0, 0.0, 1.0]]), velocity)
    return {"arcsec": np.arctan2(seen[0], seen[2]) / ARCSEC}


def refraction(row):
    altitude = np.radians(value(row["altitude_deg"]))
    true = np.array([[np.cos(altitude), 0.0, np.sin(altitude)]])
    (seen,) = refracted(true, np.array([0.0, 0.0, 1.0]), Atmosphere(1010.0, 10.0))
    return {"arcsec": (np.arctan2(seen[2], seen[0]) - altitude) / ARCSEC}


CHECKERS = {
    "The Earth's rotation angle": rotation_angle, "Where the celestial pole stands": pole,
    "A camera in east, north, up": camera, "Aberration": aberration, "Refraction": refraction,
}


@pytest.mark.parametrize("heading", CHECKERS)
def test_numbers_of_the_page(heading):
    by_hand = PAGE.read_text(encoding="utf-8").split("## Check by hand")[1].split("## What is")[0]
    for row in tables_of("## " + by_hand)[heading]:
        for column, computed in CHECKERS[heading](row).items():
            # Half a unit of the last digit; the sign of 0 does not count.
            assert abs(value(row[column]) - computed) <= 0.51 * last_digit(row[column]), (
                f"{heading}, {row}: {column} is {computed}"
            )
