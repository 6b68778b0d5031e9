"""Aberration and refraction, and the rotation that they put into a fit."""

import re

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.earth.apparent import (
    Atmosphere,
    ScaleFit,
    aberrated,
    absorbed_rotation,
    refracted,
)

ARCSEC = np.radians(1 / 3600)
C = 299792458.0
UP = np.array([0.0, 0.0, 1.0])
RNG = np.random.default_rng(3)


def directions(n):
    vectors = RNG.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def at_zenith_distance(degrees):
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


def lopsided_field(axis, n=20):
    """Return stars of a field 20 deg wide, on one side of its axis only."""
    away = RNG.uniform(0, 0.17, size=(n, 2))
    across = np.cross(axis, [0.3, -0.5, 0.2])
    across /= np.linalg.norm(across)
    vectors = axis + away[:, :1] * across + away[:, 1:] * np.cross(axis, across)
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def turn_arcsec(rotation):
    return Rotation.from_matrix(rotation).as_rotvec() / ARCSEC


def test_aberration_is_that_of_erfa():
    velocity, vectors = np.array([20e3, -21e3, 7e3]), directions(20)
    beta = velocity / C
    far_from_sun = 1e12  # erfa adds the Sun's potential: left out
    expected = [erfa.ab(v, beta, far_from_sun, np.sqrt(1 - beta @ beta)) for v in vectors]
    np.testing.assert_allclose(aberrated(vectors, velocity), expected, atol=1e-14)


@pytest.mark.parametrize(("speed_m_per_s", "arcsec"), [
    (29_784.7, 20.4927), (7_600.0, 5.2290), (465.1, 0.3200),
])
def test_aberration_at_right_angles_is_the_speed_over_that_of_light(speed_m_per_s, arcsec):
    (seen,) = aberrated(UP[None, :], np.array([speed_m_per_s, 0.0, 0.0]))
    assert np.arctan2(seen[0], seen[2]) / ARCSEC == pytest.approx(arcsec, abs=1e-4)


def test_a_star_ahead_stays():
    np.testing.assert_allclose(aberrated(UP[None, :], 30e3 * UP), [UP], atol=1e-15)


@pytest.mark.parametrize(("seen_deg", "arcsec"), [
    # Bennett (1982), 1010 hPa and 10 deg C, apparent altitudes 90, 45, 20 and 10 deg: within
    # 0.07' of the Nautical Almanac's tables.
    (0.0, 0.0), (45.0, 59.3), (70.0, 160.0), (80.0, 321.0),
])
def test_refraction_of_standard_air(seen_deg, arcsec):
    true = at_zenith_distance(np.array([seen_deg + arcsec / 3600]))
    (seen,) = refracted(true, UP, Atmosphere(1010.0, 10.0))
    lifted = np.radians(seen_deg + arcsec / 3600) - np.arctan2(seen[0], seen[2])
    assert lifted / ARCSEC == pytest.approx(arcsec, abs=4)


def test_what_is_seen_satisfies_the_formula_of_erfa():
    true = at_zenith_distance(np.array([10.0, 50.0, 75.0, 84.0]))
    air = Atmosphere(743.0, 11.0, 0.4, 0.6)
    seen = refracted(true, UP, air)
    a, b = erfa.refco(743.0, 11.0, 0.4, 0.6)
    z = np.arctan2(seen[:, 0], seen[:, 2])
    np.testing.assert_allclose(
        z + a * np.tan(z) + b * np.tan(z) ** 3, np.arctan2(true[:, 0], true[:, 2]), atol=1e-12
    )


def test_humidity_hardly_counts_above_30_degrees():
    true = at_zenith_distance(np.array([60.0]))
    dry, wet = (refracted(true, UP, Atmosphere(1010.0, 10.0, h)) for h in (0.0, 1.0))
    assert np.linalg.norm(dry - wet) / ARCSEC < 0.2


def test_without_air_nothing_moves():
    vectors = directions(5)  # below the horizon too
    np.testing.assert_array_equal(refracted(vectors, UP, Atmosphere()), vectors)


def test_a_star_near_the_horizon_is_refused():
    low = at_zenith_distance(np.array([20.0, 87.0]))
    with pytest.raises(ValueError, match=re.escape(
        "a star stands 3.0 deg above the horizon: refraction is known down to 5 deg; "
        "point the camera higher, or set pressure_hpa to 0 and bear the error"
    )):
        refracted(low, UP, Atmosphere(1010.0))


@pytest.mark.parametrize(("values", "sentence"), [
    ({"pressure_hpa": 101325.0}, "pressure_hpa is 101325.0: it must be from 0 to 1100 hPa"),
    ({"temperature_c": 283.0}, "temperature_c is 283.0: it must be from -100 to 60 deg C"),
    ({"relative_humidity": 40.0}, "relative_humidity is 40.0: it must be from 0 to 1"),
    ({"wavelength_um": 550.0}, "wavelength_um is 550.0: it must be from 0.1 to 20 um"),
])
def test_air_in_another_unit_is_refused(values, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        Atmosphere(**values)


def test_a_rotation_is_found_again():
    vectors = directions(4)
    turn = Rotation.from_rotvec([0.004, -0.007, 0.002]).as_matrix()
    np.testing.assert_allclose(absorbed_rotation(vectors, vectors @ turn.T), turn, atol=1e-12)


def test_it_is_the_difference_of_two_fits():
    """As Wahba's problem is solved with catalogue directions, and with those that are seen."""
    axis = directions(1)[0]
    vectors = lopsided_field(axis)
    seen = aberrated(vectors, np.array([12e3, 25e3, -9e3]))
    camera = Rotation.from_rotvec([1.0, 2.0, -0.5])
    right, _ = Rotation.align_vectors(seen, camera.inv().apply(seen))
    fitted, _ = Rotation.align_vectors(vectors, camera.inv().apply(seen))
    corrected = absorbed_rotation(vectors, seen) @ fitted.as_matrix()
    assert np.linalg.norm(turn_arcsec(corrected @ right.as_matrix().T)) < 1e-3
    # The boresight alone would leave more than 0.1".
    of_boresight = absorbed_rotation(axis[None, :], aberrated(axis[None, :], [12e3, 25e3, -9e3]))
    left = of_boresight @ fitted.as_matrix() @ right.as_matrix().T
    assert np.linalg.norm(turn_arcsec(left)) > 0.1


def test_a_single_direction_is_turned_along_the_great_circle():
    velocity = np.array([25e3, 0.0, 0.0])
    rotation = absorbed_rotation(UP[None, :], aberrated(UP[None, :], velocity))
    np.testing.assert_allclose(turn_arcsec(rotation), [0, 25e3 / C / ARCSEC, 0], atol=1e-6)


def test_a_field_that_shrinks_evenly_is_no_rotation_where_the_focal_length_was_fitted():
    """Flying along the boresight: all stars move towards it."""
    axis = directions(1)[0]
    vectors = lopsided_field(axis)
    seen = aberrated(vectors, 30e3 * axis)
    assert np.linalg.norm(turn_arcsec(absorbed_rotation(vectors, seen))) > 1
    free = absorbed_rotation(vectors, seen, ScaleFit(axis))
    assert np.linalg.norm(turn_arcsec(free)) < 0.2
    # Well known beforehand, it is as good as not fitted.
    known = absorbed_rotation(vectors, seen, ScaleFit(axis, prior=1e9))
    np.testing.assert_allclose(known, absorbed_rotation(vectors, seen), atol=1e-9)
