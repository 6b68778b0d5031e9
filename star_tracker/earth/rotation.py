"""How the Earth is turned at a time: from GCRS, which has the axes of ICRS, to ITRS.

UTC to TT by leap seconds, precession and nutation (IAU 2006/2000A), the Earth rotation angle and
polar motion (IERS Conventions 2010, chapter 5) are those of ERFA. Stamps are nanoseconds since
1970 in UTC, as the clock of a computer counts them. Needs pyerfa, an extra.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from types import ModuleType
from typing import Any

import numpy as np

from star_tracker.geometry.spherical import Floats

_DAY_S, _JD_OF_1970 = 86400, 2440587.5
#: Before, UTC had no leap seconds.
_DAY_OF_1972 = 730
_TT_MINUS_TAI_S = 32.184
_ARCSEC = np.pi / 648000
_AU_M = 149597870700.0
#: The largest numbers that the Earth has; larger ones are in another unit.
UT1_UTC_RANGE_S, POLAR_MOTION_RANGE_ARCSEC = (-1.0, 1.0), (-1.0, 1.0)


@dataclass(frozen=True)
class EarthOrientation:
    """What of the Earth's rotation can only be measured; IERS Bulletin A has it for each day.

    Left at 0, UT1 - UTC costs up to 0.9 s, which is 13.5" about the Earth's axis, and polar motion
    up to 0.6". Raises ValueError for values that the Earth does not have.

    Attributes:
        ut1_utc_s: UT1 - UTC.
        xp_arcsec, yp_arcsec: the pole in ITRS: x towards longitude 0, y towards 90 degrees west.
    """

    ut1_utc_s: float = 0.0
    xp_arcsec: float = 0.0
    yp_arcsec: float = 0.0

    def __post_init__(self) -> None:
        for name, unit, (low, high) in (
            ("ut1_utc_s", "s", UT1_UTC_RANGE_S),
            ("xp_arcsec", "arcsec", POLAR_MOTION_RANGE_ARCSEC),
            ("yp_arcsec", "arcsec", POLAR_MOTION_RANGE_ARCSEC),
        ):
            value = getattr(self, name)
            if not (isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} is {value}: it must be from {low:g} to {high:g} {unit}")


_ALL_ZERO = EarthOrientation()


def itrs_from_gcrs(stamp_ns: int, orientation: EarthOrientation = _ALL_ZERO) -> Floats:
    """Return the rotation (3, 3) that turns vectors in GCRS into ITRS (`eraC2t06a`).

    Raises ValueError for a stamp before 1972, ImportError where pyerfa is missing. Years that are
    more than five after ERFA's table of leap seconds warn, as ERFA does.
    """
    day, second = _day_and_second(stamp_ns)
    tt_s = second + _leap_seconds(day) + _TT_MINUS_TAI_S
    jd = _JD_OF_1970 + day
    return np.asarray(load_erfa().c2t06a(
        jd, tt_s / _DAY_S, jd, (second + orientation.ut1_utc_s) / _DAY_S,
        orientation.xp_arcsec * _ARCSEC, orientation.yp_arcsec * _ARCSEC,
    ))


def earth_velocity_m_per_s(stamp_ns: int) -> Floats:
    """Return the Earth's velocity (3,) about the solar system's barycentre, ICRS (`eraEpv00`).

    Right to 6 mm/s, which is 4e-6" of aberration. Raises as `itrs_from_gcrs` does.
    """
    day, second = _day_and_second(stamp_ns)
    tt_s = second + _leap_seconds(day) + _TT_MINUS_TAI_S
    _, barycentric = load_erfa().epv00(_JD_OF_1970 + day, tt_s / _DAY_S)
    return np.asarray(barycentric["v"]) * (_AU_M / _DAY_S)


def load_erfa() -> Any:
    """Return the module erfa. Raises ImportError, with the remedy, where it is missing."""
    try:
        import erfa as module  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError(
            "the attitude against the Earth needs pyerfa: apt install python3-erfa, "
            "or pip install pyerfa"
        ) from error
    assert isinstance(module, ModuleType)
    return module


def _day_and_second(stamp_ns: int) -> tuple[int, float]:
    """Return the whole days since 1970 and the second of the day, both UTC."""
    day, ns = divmod(int(stamp_ns), _DAY_S * 1_000_000_000)
    if day < _DAY_OF_1972:
        raise ValueError(
            f"stamp {stamp_ns / 1e9:.3f} s lies before 1972: the stars tell the attitude against "
            "the Earth only with the time; set the clock that makes the stamps to UTC"
        )
    return day, ns / 1e9


@lru_cache(maxsize=64)
def _leap_seconds(day: int) -> float:
    """Return TAI - UTC, s, of a day counted from 1970. Asked once a day: ERFA may warn."""
    year, month, of_month, _ = load_erfa().jd2cal(_JD_OF_1970, float(day))
    return float(load_erfa().dat(int(year), int(month), int(of_month), 0.0))
