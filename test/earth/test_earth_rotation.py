"""The Earth's rotation by numbers that can be checked by hand, and what it refuses."""

import re
import sys
from datetime import datetime, timezone

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.earth.rotation import (
    EarthOrientation,
    earth_velocity_m_per_s,
    itrs_from_gcrs,
)

ARCSEC = np.radians(1 / 3600)
#: 2024-06-05 00:00:00 UTC.
STAMP_NS = int(datetime(2024, 6, 5, tzinfo=timezone.utc).timestamp()) * 10**9
SECOND_NS = 10**9


def turn_arcsec(a, b):
    """Return the rotation vector (3,) from one rotation to another, arcseconds."""
    return Rotation.from_matrix(b @ a.T).as_rotvec() / ARCSEC


def test_the_earth_turns_by_15_041_arcsec_a_second_about_its_axis():
    turn = turn_arcsec(itrs_from_gcrs(STAMP_NS), itrs_from_gcrs(STAMP_NS + SECOND_NS))
    np.testing.assert_allclose(turn, [0, 0, -15.04107], atol=2e-5)


def test_a_sidereal_day_is_23_h_56_min_4_0905_s():
    later = STAMP_NS + int(86164.0905 * SECOND_NS)
    turn = turn_arcsec(itrs_from_gcrs(STAMP_NS), itrs_from_gcrs(later))
    # Precession in a day, 50.3"/365.25 = 0.14", and nutation are left.
    assert np.linalg.norm(turn) < 0.3


def test_greenwich_mean_sidereal_time_of_a_day_by_hand():
    """GMST at 0 h UT1 of JD 2460466.5, D = 8921.5: 18.697374558 h + 24.06570982441908 h D."""
    gmst_deg = 15 * (18.697374558 + 24.06570982441908 * 8921.5) % 360
    # The mean equinox of date lies where the equinox of J2000 has gone: 46.124" a year in RA.
    precession_deg = 46.124 * 8921.5 / 365.25 / 3600
    rotation = itrs_from_gcrs(STAMP_NS)
    angle_deg = np.degrees(np.arctan2(rotation[0, 1], rotation[0, 0])) % 360
    # Nutation in right ascension, up to 17", is left out here.
    assert angle_deg == pytest.approx((gmst_deg - precession_deg) % 360, abs=20 / 3600)


def test_ut1_turns_the_earth_forward():
    late = itrs_from_gcrs(STAMP_NS, EarthOrientation(ut1_utc_s=0.9))
    np.testing.assert_allclose(
        turn_arcsec(itrs_from_gcrs(STAMP_NS), late), [0, 0, -13.537], atol=1e-3
    )


def test_polar_motion_moves_the_pole_towards_greenwich_and_90_degrees_west():
    """The celestial pole, z, is seen at (xp, -yp) in ITRS."""
    without = itrs_from_gcrs(STAMP_NS)
    moved = itrs_from_gcrs(STAMP_NS, EarthOrientation(xp_arcsec=0.2, yp_arcsec=0.5))
    pole = moved @ without.T @ [0, 0, 1]
    np.testing.assert_allclose(pole[:2] / ARCSEC, [0.2, -0.5], atol=1e-4)


def test_the_leap_second_of_2016_counts():
    """Over it 2 s of UT1 go by while the stamps count 1."""
    before = int(datetime(2016, 12, 31, 23, 59, 59, tzinfo=timezone.utc).timestamp()) * SECOND_NS
    # TT - UTC counts only for precession and nutation, and for the Earth's place: 30 km more.
    velocities = [earth_velocity_m_per_s(before + k * SECOND_NS) for k in range(-1, 3)]
    steps = np.linalg.norm(np.diff(velocities, axis=0), axis=1)
    np.testing.assert_allclose(steps[1] / steps[[0, 2]], 2, atol=0.01)


def test_the_earth_moves_at_30_km_a_second_at_right_angles_to_the_sun():
    """At the equinox of March the Sun stands along x: the Earth moves along -y and -z."""
    stamp = int(datetime(2024, 3, 20, 3, 6, tzinfo=timezone.utc).timestamp()) * SECOND_NS
    velocity = earth_velocity_m_per_s(stamp)
    assert np.linalg.norm(velocity) == pytest.approx(29_900, rel=0.01)
    obliquity = np.radians(23.44)
    across = velocity @ [0, -np.cos(obliquity), -np.sin(obliquity)]
    assert across / np.linalg.norm(velocity) == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("stamp_ns", [0, 63_071_999 * SECOND_NS])
def test_a_stamp_that_is_no_time_of_day_is_refused(stamp_ns):
    with pytest.raises(ValueError, match=re.escape(
        f"stamp {stamp_ns / 1e9:.3f} s lies before 1972: the stars tell the attitude against "
        "the Earth only with the time; set the clock that makes the stamps to UTC"
    )):
        itrs_from_gcrs(stamp_ns)


def test_the_first_stamp_of_1972_is_taken():
    assert np.linalg.det(itrs_from_gcrs(63_072_000 * SECOND_NS)) == pytest.approx(1)


@pytest.mark.parametrize(("values", "sentence"), [
    ({"ut1_utc_s": 37.0}, "ut1_utc_s is 37.0: it must be from -1 to 1 s"),
    ({"xp_arcsec": float("nan")}, "xp_arcsec is nan: it must be from -1 to 1 arcsec"),
    ({"yp_arcsec": 411.0}, "yp_arcsec is 411.0: it must be from -1 to 1 arcsec"),
])
def test_a_number_in_another_unit_is_refused(values, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        EarthOrientation(**values)


def test_a_missing_pyerfa_is_told_with_its_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "erfa", None)
    with pytest.raises(ImportError, match=re.escape(
        "the attitude against the Earth needs pyerfa: apt install python3-erfa, "
        "or pip install pyerfa"
    )):
        itrs_from_gcrs(STAMP_NS)
