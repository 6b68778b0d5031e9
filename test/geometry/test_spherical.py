"""Directions on the sphere: axes, ranges, small and large separations, position angles."""

import numpy as np
import pytest

from star_tracker.geometry.spherical import (
    chord,
    position_angle,
    ra_dec,
    separation,
    tangent_basis,
    unit_vectors,
)

ARCSEC = np.pi / 180 / 3600


def random_directions(n, seed):
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def degrees(ra, dec):
    return unit_vectors(np.radians(ra), np.radians(dec))


@pytest.mark.parametrize(
    ("ra", "dec", "vector"),
    [
        (0, 0, (1, 0, 0)),
        (90, 0, (0, 1, 0)),
        (180, 0, (-1, 0, 0)),
        (123, 90, (0, 0, 1)),
        (0, -90, (0, 0, -1)),
        (45, 0, (np.sqrt(0.5), np.sqrt(0.5), 0)),
        (270, 30, (0, -np.sqrt(0.75), 0.5)),
    ],
)
def test_unit_vector_of_a_direction(ra, dec, vector):
    np.testing.assert_allclose(degrees(ra, dec), vector, atol=1e-15)


def test_unit_vectors_stack_along_the_last_axis():
    assert unit_vectors(np.zeros((4, 2)), np.zeros((4, 2))).shape == (4, 2, 3)


def test_directions_come_back_from_their_vectors():
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 2 * np.pi, 1000), np.arcsin(rng.uniform(-1, 1, 1000))
    again = ra_dec(unit_vectors(ra, dec))
    np.testing.assert_allclose(again, (ra, dec), rtol=0, atol=1e-12)


def test_right_ascension_and_declination_of_axes_in_their_ranges():
    ra, dec = ra_dec([(0, -1, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)])
    np.testing.assert_allclose(np.degrees(ra), (270, 180, 0, 0))
    np.testing.assert_allclose(np.degrees(dec), (0, 0, 90, -90))


def test_right_ascension_just_below_zero_never_becomes_a_full_turn():
    ra, _ = ra_dec([1.0, -1e-20, 0.0])
    assert ra == 0.0


def test_right_ascension_does_not_depend_on_the_length_of_the_vector():
    v = random_directions(20, 2)
    np.testing.assert_allclose(ra_dec(7.5 * v), ra_dec(v), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle_rad", [1e-12, 1e-8, ARCSEC, 0.2, 1.5, np.pi - 1e-8, np.pi])
def test_separation_is_exact_from_microarcseconds_to_half_a_turn(angle_rad):
    # Vectors are rounded to about 1e-16; an arccosine would be wrong by 1e-8 at both ends.
    assert separation(degrees(0, 0), unit_vectors(angle_rad, 0)) == pytest.approx(
        angle_rad, rel=0, abs=4e-16
    )


def test_separation_of_a_direction_from_itself_is_zero():
    v = random_directions(100, 3)
    assert np.all(separation(v, v) == 0)


def test_separation_broadcasts_to_a_table():
    v = random_directions(5, 4)
    table = separation(v[:, None], v[None])
    assert table.shape == (5, 5)
    np.testing.assert_array_equal(table, table.T)


def test_separation_of_two_well_known_stars():
    """The Pointers of the Plough, Dubhe and Merak, are 5.37 deg apart."""
    dubhe, merak = degrees(165.93196, 61.75103), degrees(165.46032, 56.38243)
    assert np.degrees(separation(dubhe, merak)) == pytest.approx(5.374, abs=0.001)


def test_chord_of_known_angles():
    np.testing.assert_allclose(chord(np.radians([0, 60, 90, 180])), (0, 1, np.sqrt(2), 2))


def test_chord_is_the_distance_of_the_end_points():
    a, b = random_directions(50, 5), random_directions(50, 6)
    np.testing.assert_allclose(chord(separation(a, b)), np.linalg.norm(a - b, axis=1))


@pytest.mark.parametrize(
    ("ra", "dec", "east", "north"),
    [
        (0, 0, (0, 1, 0), (0, 0, 1)),
        (90, 0, (-1, 0, 0), (0, 0, 1)),
        (0, 45, (0, 1, 0), (-np.sqrt(0.5), 0, np.sqrt(0.5))),
    ],
)
def test_east_and_north_at_known_places(ra, dec, east, north):
    np.testing.assert_allclose(tangent_basis(degrees(ra, dec)), (east, north), atol=1e-15)


@pytest.mark.parametrize(("pole", "north"), [((0, 0, 1), (-1, 0, 0)), ((0, 0, -1), (1, 0, 0))])
def test_at_a_pole_the_basis_is_that_of_right_ascension_zero(pole, north):
    np.testing.assert_array_equal(tangent_basis(np.array(pole, float)), ((0, 1, 0), north))


def test_east_north_and_the_direction_are_a_right_handed_triad():
    v = random_directions(200, 7)
    east, north = tangent_basis(v)
    triads = np.stack([east, north, v], axis=1)
    unit = np.broadcast_to(np.eye(3), (200, 3, 3))
    np.testing.assert_allclose(triads @ triads.swapaxes(1, 2), unit, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(triads), 1.0)


@pytest.mark.parametrize(
    ("ra", "dec", "expected"), [(0, 1, 0), (1, 0, 90), (0, -1, 180), (359, 0, 270)]
)
def test_position_angle_counts_from_north_towards_east(ra, dec, expected):
    angle = np.degrees(position_angle(degrees(0, 0), degrees(ra, dec)))
    assert (angle - expected + 180) % 360 - 180 == pytest.approx(0, abs=1e-12)


def test_position_angle_agrees_with_the_textbook_formula():
    """tan P = sin(a2 - a1) / (cos d1 tan d2 - sin d1 cos(a2 - a1)), Meeus 1998, chapter 17."""
    rng = np.random.default_rng(8)
    a1, a2 = rng.uniform(0, 2 * np.pi, (2, 300))
    d1, d2 = np.arcsin(rng.uniform(-0.999, 0.999, (2, 300)))
    textbook = np.arctan2(
        np.sin(a2 - a1) * np.cos(d2),
        np.cos(d1) * np.sin(d2) - np.sin(d1) * np.cos(d2) * np.cos(a2 - a1),
    )
    found = position_angle(unit_vectors(a1, d1), unit_vectors(a2, d2))
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * textbook), atol=1e-9)


def test_position_angle_is_in_range_and_never_a_full_turn():
    v, t = random_directions(1000, 9), random_directions(1000, 10)
    angle = position_angle(v, t)
    assert np.all((angle >= 0) & (angle < 2 * np.pi))
    assert position_angle([1.0, 0, 0], [1.0, -1e-20, 0.1]) == 0.0


def test_position_angle_about_another_pole():
    """With -y, the camera's up, as north, x right lies at 270 deg: seen outwards east is left."""
    boresight, up = (0, 0, 1), (0.0, -1.0, 0.0)
    angle = position_angle(boresight, [(0.1, 0, 1), (0, -0.1, 1), (-0.1, 0, 1)], up)
    np.testing.assert_allclose(np.degrees(angle), (270, 0, 90), atol=1e-12)
