"""A place on the Earth, and its local frame: x east, y north, z up (REP-103).

Latitude and height are geodetic, of the ellipsoid WGS 84, as satellite navigation gives them. Up
is the ellipsoid's normal; a plumb line may differ by some ten arcseconds, near mountains by more.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from star_tracker.earth.rotation import load_erfa
from star_tracker.geometry.spherical import Floats

#: The Earth's rate, rad/s (IERS Conventions 2010, table 1.2).
EARTH_RATE_RAD_PER_S = 7.292115e-5
LATITUDE_RANGE_DEG, LONGITUDE_RANGE_DEG = (-90.0, 90.0), (-180.0, 360.0)
#: From the deepest trench to the edge of space; what moves faster than the ground is no site.
HEIGHT_RANGE_M = (-12000.0, 100000.0)
_WGS84 = 1


@dataclass(frozen=True)
class Site:
    """A place on the Earth. Raises ValueError for a place that is none, naming the number.

    Attributes:
        latitude_deg: geodetic, north positive.
        longitude_deg: east positive.
        height_m: above the ellipsoid. It counts only for the speed of the ground: 1 km is 5e-5".
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        for name, unit, (low, high) in (
            ("latitude_deg", "deg", LATITUDE_RANGE_DEG),
            ("longitude_deg", "deg", LONGITUDE_RANGE_DEG),
            ("height_m", "m", HEIGHT_RANGE_M),
        ):
            value = getattr(self, name)
            if not (isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} is {value}: it must be from {low:g} to {high:g} {unit}")

    @property
    def enu_from_itrs(self) -> Floats:
        """The rotation (3, 3) that turns vectors in ITRS into east, north, up."""
        latitude, longitude = np.radians(self.latitude_deg), np.radians(self.longitude_deg)
        (sin_lat, sin_lon), (cos_lat, cos_lon) = (
            np.sin([latitude, longitude]), np.cos([latitude, longitude])
        )
        return np.array([
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ])

    @property
    def velocity_itrs_m_per_s(self) -> Floats:
        """The velocity (3,) of the ground about the Earth's axis, along the axes of ITRS."""
        place = load_erfa().gd2gc(
            _WGS84, np.radians(self.longitude_deg), np.radians(self.latitude_deg), self.height_m
        )
        return np.cross([0.0, 0.0, EARTH_RATE_RAD_PER_S], np.asarray(place))
