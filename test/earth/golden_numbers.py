"""Write down stars over three places, and the Earth's rotation, by other programs.

    python test/earth/golden_numbers.py astropy     (with astropy; writes golden_astropy.json)
    python test/earth/golden_numbers.py skyfield    (with skyfield; writes golden_skyfield.json)

astropy gives directions of stars in east, north, up, without and with air, with the UT1 and polar
motion of IERS. skyfield, whose series of nutation and formulas of precession are its own, gives
the rotation from GCRS to ITRS. The tests read the files and need neither.
"""

import json
import re
import sys
from datetime import datetime
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
#: Name, UTC, latitude, longitude (deg), height (m), pressure (hPa), temperature (deg C).
PLACES = (
    ("Paranal", "2003-03-20T04:11:32.25", -24.6272, -70.4042, 2635.0, 743.0, 11.0),
    ("Tromso", "2016-12-31T22:47:05.5", 69.6496, 18.9560, 30.0, 1002.0, -12.0),
    ("Singapore", "2026-05-14T15:02:59.125", 1.2897, 103.8501, 15.0, 1009.0, 29.0),
)
#: Azimuth and altitude of the middle of a field and of four stars about it, 10 deg away.
FIELDS = ((200.0, 75.0), (75.0, 40.0), (310.0, 22.0))


def stars_of(azimuth_deg, altitude_deg):
    """Return azimuths and altitudes of five stars, lopsided about the middle, deg."""
    away = np.array([(0, 0), (8, 1), (-3, 9), (2, -7), (9, 8)], float)
    altitude = altitude_deg + away[:, 1]
    return azimuth_deg + away[:, 0] / np.cos(np.radians(altitude)), altitude


def vectors_of(longitude, latitude):
    """Return unit vectors (n, 3)."""
    return np.stack([
        np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
        np.sin(latitude),
    ], axis=-1)


def by_astropy():
    """Return the stars of each place, by astropy."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_sun
    from astropy.time import Time
    from astropy.utils import iers

    iers.conf.auto_download = False
    table = iers.IERS_Auto.open()
    places = []
    for name, utc, latitude, longitude, height, pressure, temperature in PLACES:
        time = Time(utc, scale="utc")
        xp, yp = (value.to_value(u.arcsec) for value in table.pm_xy(time))
        location = EarthLocation.from_geodetic(longitude * u.deg, latitude * u.deg, height * u.m)
        frame = {"obstime": time, "location": location, "obswl": 0.55 * u.um}
        fields = []
        for middle in FIELDS:
            azimuth, altitude = stars_of(*middle)
            stars = SkyCoord(
                azimuth * u.deg, altitude * u.deg, frame=AltAz(**frame)
            ).icrs
            icrs = SkyCoord(np.round(stars.ra.deg, 6) * u.deg, np.round(stars.dec.deg, 6) * u.deg)
            sun = get_sun(time)  # its GCRS place: seen from here
            away = icrs.separation(SkyCoord(sun.ra, sun.dec))
            assert away.deg.min() > 30, "light bent by the Sun is left out"
            seen = {}
            for kind, hpa in (("vacuum", 0.0), ("air", pressure)):
                there = icrs.transform_to(AltAz(
                    **frame, pressure=hpa * u.hPa, temperature=temperature * u.deg_C,
                    relative_humidity=0.0,
                ))
                # Azimuth is counted from north towards east: x and y of ENU change places.
                north_east_up = vectors_of(there.az.rad, there.alt.rad)
                seen[kind] = np.round(north_east_up[:, [1, 0, 2]], 12).tolist()
            fields.append({
                "ra_deg": icrs.ra.deg.tolist(), "dec_deg": icrs.dec.deg.tolist(), **seen,
            })
        places.append({
            "name": name, "utc": utc, "latitude_deg": latitude, "longitude_deg": longitude,
            "height_m": height, "pressure_hpa": pressure, "temperature_c": temperature,
            "ut1_utc_s": float(time.delta_ut1_utc), "xp_arcsec": float(xp),
            "yp_arcsec": float(yp), "fields": fields,
        })
    return places


def by_skyfield():
    """Return the rotation from GCRS to ITRS of each date, by skyfield, without polar motion."""
    from skyfield.api import load
    from skyfield.framelib import itrs

    rotations = []
    timescale = load.timescale(builtin=True)
    for _, utc, *_ in PLACES:
        moment = datetime.fromisoformat(utc)
        time = timescale.utc(
            moment.year, moment.month, moment.day, moment.hour, moment.minute,
            moment.second + moment.microsecond / 1e6,
        )
        rotations.append({
            "utc": utc, "ut1_utc_s": float(time.dut1),
            "itrs_from_gcrs": itrs.rotation_at(time).tolist(),
        })
    return rotations


if __name__ == "__main__":
    made = {"astropy": by_astropy, "skyfield": by_skyfield}[sys.argv[1]]()
    path = HERE / f"golden_{sys.argv[1]}.json"
    text = json.dumps(made, indent=1)
    # A list of numbers in a line.
    text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text)
    path.write_text(text + "\n", encoding="utf-8")
    print(path)
