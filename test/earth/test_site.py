"""A place's frame and speed, by numbers that can be checked by hand."""

import numpy as np
import pytest

from star_tracker.earth.site import Site


@pytest.mark.parametrize(("place", "east", "north", "up"), [
    (Site(0.0, 0.0), [0, 1, 0], [0, 0, 1], [1, 0, 0]),
    (Site(0.0, 90.0), [-1, 0, 0], [0, 0, 1], [0, 1, 0]),
    (Site(90.0, 0.0), [0, 1, 0], [-1, 0, 0], [0, 0, 1]),
    (Site(-90.0, 0.0), [0, 1, 0], [1, 0, 0], [0, 0, -1]),
    (Site(30.0, 180.0), [0, -1, 0], [0.5, 0, 0.75**0.5], [-(0.75**0.5), 0, 0.5]),
])
def test_east_north_and_up_in_itrs(place, east, north, up):
    np.testing.assert_allclose(place.enu_from_itrs, [east, north, up], atol=1e-15)


@pytest.mark.parametrize(("place", "east_m_per_s"), [
    # The equator's radius, 6378137 m, times 7.292115e-5 rad/s.
    (Site(0.0, 17.0), 465.101),
    (Site(0.0, 17.0, 10_000.0), 465.830),
    (Site(90.0, 0.0), 0.0),
    # N cos(45 deg) with N = 6388838.29 m (WGS 84).
    (Site(45.0, -60.0), 329.428),
])
def test_the_ground_moves_east(place, east_m_per_s):
    velocity = place.enu_from_itrs @ place.velocity_itrs_m_per_s
    np.testing.assert_allclose(velocity, [east_m_per_s, 0, 0], atol=1e-3)


@pytest.mark.parametrize(("place", "sentence"), [
    ((91.0, 0.0), "latitude_deg is 91.0: it must be from -90 to 90 deg"),
    ((0.0, 361.0), "longitude_deg is 361.0: it must be from -180 to 360 deg"),
    ((0.0, 0.0, 400e3), "height_m is 400000.0: it must be from -12000 to 100000 m"),
    ((float("nan"), 0.0), "latitude_deg is nan: it must be from -90 to 90 deg"),
])
def test_what_is_no_place_on_the_ground_is_refused(place, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        Site(*place)
