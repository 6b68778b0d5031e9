"""Guide stars near a direction, against a comparison with every star."""

import numpy as np
import pytest

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.sky_index import SkyIndex, stars_near
from star_tracker.geometry.spherical import ra_dec, separation, unit_vectors


def random_stars(n, seed):
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def near(index, direction, reach_rad):
    """The stars in ascending order; none may come twice."""
    found = np.empty(len(index.vectors), np.int64)
    vectors = np.empty(index.vectors.shape)
    n = stars_near(index, np.ascontiguousarray(direction), reach_rad, found, vectors)
    np.testing.assert_array_equal(vectors[:n], index.vectors[found[:n]])
    return np.sort(found[:n]).tolist()


def by_comparison(vectors, direction, reach_rad):
    return np.flatnonzero(separation(vectors, direction) < reach_rad).tolist()


def towards(ra_deg, dec_deg):
    return unit_vectors(*np.radians([ra_deg, dec_deg]))


@pytest.fixture(scope="module")
def stars():
    """3000 all over the sky, the poles and points at right ascension 0 among them."""
    special = [towards(*place) for place in [(0, 90), (0, -90), (0, 0), (0, 60), (180, -40)]]
    return np.concatenate([random_stars(3000, 1), special])


@pytest.fixture(scope="module")
def index(stars):
    return SkyIndex.build(stars)


def test_each_star_is_in_its_cell_once(stars, index):
    assert sorted(index.star.tolist()) == list(range(len(stars)))
    assert (index.cell_start[0], index.cell_start[-1]) == (0, len(stars))
    np.testing.assert_array_equal(index.sorted_vectors, stars[index.star])
    ra, dec = ra_dec(index.sorted_vectors)
    for begin, end in zip(index.cell_start, index.cell_start[1:], strict=False):
        if begin < end:
            assert np.all(np.diff(ra[begin:end]) >= 0)
            assert np.ptp(ra[begin:end]) <= np.radians(360 / 128)
            assert np.ptp(dec[begin:end]) <= np.radians(4) + 1e-12


@pytest.mark.parametrize("reach_deg", [1e-3, 0.3, 2.0, 8.49, 17.0, 45.0, 88.8, 89.99])
def test_stars_within_a_reach_of_random_directions(stars, index, reach_deg):
    reach = np.radians(reach_deg)
    for direction in random_stars(100, 2):
        assert near(index, direction, reach) == by_comparison(stars, direction, reach)


@pytest.mark.parametrize("reach_deg", [90.0, 120.0, 179.9])
def test_a_reach_beyond_a_hemisphere(stars, index, reach_deg):
    reach = np.radians(reach_deg)
    for direction in random_stars(20, 3):
        assert near(index, direction, reach) == by_comparison(stars, direction, reach)


@pytest.mark.parametrize("dec_deg", [90, 89.9999, 85, -86, -89.99, -90])
@pytest.mark.parametrize("reach_deg", [0.5, 3.999, 4.001, 4.5, 20.0])
def test_about_the_poles(stars, index, dec_deg, reach_deg):
    """Reaches that do and that do not take the pole in."""
    reach = np.radians(reach_deg)
    for ra_deg in (0, 1e-9, 90, 179, 300, 359.99):
        direction = towards(ra_deg, dec_deg)
        assert near(index, direction, reach) == by_comparison(stars, direction, reach)


@pytest.mark.parametrize("ra_deg", [0, 1e-12, 0.01, 5, 355, 359.99, 360 - 1e-12])
@pytest.mark.parametrize("dec_deg", [0, 35, -60, 78])
def test_across_right_ascension_zero(stars, index, ra_deg, dec_deg):
    direction = towards(ra_deg, dec_deg)
    for reach in np.radians([1.0, 6.0, 11.9]):
        assert near(index, direction, reach) == by_comparison(stars, direction, reach)


@pytest.mark.parametrize("dec_deg", [-88, -4, 0, 2, 40, 84])
def test_on_the_edges_of_the_bands(stars, index, dec_deg):
    """Bands are 4 deg wide, from -90 deg up."""
    for reach in np.radians([0.1, 2.0, 4.0]):
        for ra_deg in range(0, 360, 15):
            direction = towards(ra_deg, dec_deg)
            assert near(index, direction, reach) == by_comparison(stars, direction, reach)


def test_a_circle_that_all_but_touches_the_pole_is_not_lost(stars, index):
    """Declination and reach make 90 deg to the last digit: the widest run of right ascensions."""
    rng = np.random.default_rng(4)
    for reach in rng.uniform(0.02, 1.5, 2000):
        dec = (np.pi / 2 - reach) * (1 - rng.integers(0, 4) * 2.0**-53)
        direction = unit_vectors(rng.uniform(0, 2 * np.pi), rng.choice([-dec, dec]))
        inner = set(by_comparison(stars, direction, reach - 1e-7))
        outer = set(by_comparison(stars, direction, reach + 1e-7))
        assert inner <= set(near(index, direction, reach)) <= outer


def test_a_tiny_reach_finds_the_star_itself(stars, index):
    for star in range(0, len(stars), 50):
        assert near(index, stars[star], np.radians(1e-4)) == [star]


def test_a_sky_of_one_star_and_one_of_none():
    one = SkyIndex.build(np.array([(0.0, 0.0, 1.0)]))
    assert near(one, np.array([0.0, 0.1, 0.995]), 0.2) == [0]
    assert near(one, np.array([1.0, 0.0, 0.0]), 0.2) == []
    none = SkyIndex.build(np.empty((0, 3)))
    assert near(none, np.array([1.0, 0.0, 0.0]), 1.0) == []


def test_the_papers_stars_in_fields_of_all_sizes():
    catalog = StarCatalog.paper()
    index = SkyIndex.build(catalog.vectors)
    for direction in random_stars(30, 5):
        for reach in np.radians([4.3, 8.5, 14.2, 40.0]):
            expected = by_comparison(catalog.vectors, direction, reach)
            assert near(index, direction, reach) == expected
