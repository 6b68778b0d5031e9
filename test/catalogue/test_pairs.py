"""Guide-star pairs: counts, both directions, position angles, range query, refusals."""

import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.pairs import (
    AZIMUTH_UNITS,
    MAX_DIRECTED_PAIRS,
    PairTable,
    azimuth_units,
    first_near,
    first_row,
)
from star_tracker.geometry.spherical import chord, position_angle, separation, unit_vectors


def catalog_of(**stars):
    """A tiny catalogue from names to (RA, Dec) in degrees."""
    ra, dec = np.radians(list(stars.values())).T
    n = len(stars)
    none = np.zeros(n, np.int64)
    return StarCatalog(unit_vectors(ra, dec), np.full(n, 3.0), none, none)


def random_catalog(n, radius_rad, seed):
    rng = np.random.default_rng(seed)
    vectors = np.column_stack([radius_rad * rng.normal(size=(n, 2)), np.ones(n)])
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    none = np.zeros(n, np.int64)
    return StarCatalog(vectors, np.full(n, 3.0), none, none)


def directed(table):
    """Rows by main star: main, companion, azimuth units."""
    main = np.repeat(np.arange(len(table.near_start) - 1), np.diff(table.near_start))
    return main, table.near_companion, table.near_azimuth


def by_separation(table):
    """Rows in order of separation: main, azimuth units."""
    return table.main_azimuth // AZIMUTH_UNITS, table.main_azimuth % AZIMUTH_UNITS


@pytest.fixture
def paper(catalog):
    return catalog


@pytest.mark.parametrize(("limit_deg", "pairs"), [(12.0, 149_423), (17.0, 294_833)])
def test_pairs_of_the_papers_catalogue(paper, limit_deg, pairs):
    table = PairTable.build(paper, np.radians(limit_deg))
    assert table.n_pairs == pairs
    assert {
        len(rows) for rows in (
            table.separation_rad, table.main_azimuth, table.near_separation_rad,
            table.near_azimuth, table.near_companion,
        )
    } == {2 * pairs}
    assert len(table.near_start) == len(paper) + 1
    assert table.max_separation_rad == np.radians(limit_deg)


def test_the_database_takes_the_papers_12_degrees_by_default(paper):
    database = FeatureDatabase.build(paper)
    assert database.catalog is paper
    assert database.pairs.n_pairs == 149_423


def test_each_pair_is_stored_in_both_directions_with_one_separation():
    catalog = random_catalog(60, 0.1, 1)
    table = PairTable.build(catalog, 0.15)
    main, companion, _ = directed(table)
    apart = table.near_separation_rad
    there = dict(zip(zip(main, companion, strict=True), apart, strict=True))
    assert len(there) == len(main)
    assert all(there[c, m] == s for (m, c), s in there.items())


def test_pairs_are_all_those_up_to_the_limit_and_no_star_pairs_with_itself():
    catalog = random_catalog(60, 0.1, 2)
    table = PairTable.build(catalog, 0.15)
    distance = separation(catalog.vectors[:, None], catalog.vectors[None])
    expected = {(i, j) for i, j in np.argwhere(distance <= 0.15).tolist() if i != j}
    main, companion, _ = directed(table)
    assert set(zip(main.tolist(), companion.tolist(), strict=True)) == expected


def test_separations_ascend_and_are_those_of_the_catalogue():
    catalog = random_catalog(60, 0.1, 3)
    table = PairTable.build(catalog, 0.2)
    assert np.all(np.diff(table.separation_rad) >= 0)
    main, companion, _ = directed(table)
    exact = separation(catalog.vectors[main], catalog.vectors[companion])
    # Single precision: 2^-24 of at most 0.2 rad.
    np.testing.assert_allclose(table.near_separation_rad, exact, rtol=2.0**-24)
    np.testing.assert_allclose(table.separation_rad, np.sort(exact), rtol=2.0**-24)


def test_both_orders_hold_the_same_rows():
    table = PairTable.build(random_catalog(60, 0.1, 10), 0.2)
    main, _, azimuth = directed(table)
    near = zip(
        table.near_separation_rad.tolist(), main.tolist(), azimuth.tolist(), strict=True
    )
    every = zip(
        table.separation_rad.tolist(), *(column.tolist() for column in by_separation(table)),
        strict=True,
    )
    assert sorted(near) == sorted(every)


def test_companions_of_each_star_ascend_in_separation():
    table = PairTable.build(random_catalog(60, 0.1, 11), 0.2)
    assert (table.near_start[0], table.near_start[-1]) == (0, 2 * table.n_pairs)
    for begin, end in zip(table.near_start, table.near_start[1:], strict=False):
        assert np.all(np.diff(table.near_separation_rad[begin:end]) >= 0)


def test_size_in_memory_is_that_of_all_columns():
    """Two separations, main star with angle, angle, companion: 17 bytes a row; 8 a start."""
    table = PairTable.build(random_catalog(60, 0.1, 12), 0.2)
    starts = len(table.bin_start) + len(table.near_start)
    assert table.nbytes == 2 * table.n_pairs * (4 + 4 + 4 + 1 + 4) + 8 * starts


def test_azimuth_is_the_companions_position_angle_about_the_main_star():
    """WEST sees EAST at 91 deg, 64.7 units; EAST sees WEST at 271.1 deg, 192.8 units."""
    table = PairTable.build(catalog_of(WEST=(10, 0), EAST=(15, -0.0873)), np.radians(6))
    main, companion, azimuth = directed(table)
    by_star = sorted(zip(main.tolist(), companion.tolist(), azimuth.tolist(), strict=True))
    assert by_star == [(0, 1, 64), (1, 0, 192)]


def test_azimuths_of_all_pairs_are_position_angles_in_units():
    catalog = random_catalog(40, 0.1, 4)
    main, companion, azimuth = directed(PairTable.build(catalog, 0.2))
    angle = position_angle(catalog.vectors[main], catalog.vectors[companion])
    behind = angle * 256 / (2 * np.pi) - azimuth
    assert np.all((behind >= 0) & (behind < 1))


@pytest.mark.parametrize(
    ("angle_deg", "unit"),
    [
        (0.0, 0), (1.40, 0), (1.41, 1), (90.0, 64), (179.99, 127), (180.0, 128), (270.0, 192),
        (359.99, 255),
    ],
)
def test_azimuth_units_are_a_256th_of_a_turn_rounded_down(angle_deg, unit):
    assert azimuth_units(np.radians([angle_deg])) == [unit]


def test_the_angle_just_below_a_full_turn_is_a_unit_too():
    assert 0 <= azimuth_units(np.array([np.nextafter(2 * np.pi, 0)]))[0] <= 255


def test_range_query_finds_the_pairs_between_two_separations():
    table = PairTable.build(random_catalog(60, 0.1, 5), 0.2)
    rng = np.random.default_rng(6)
    low = rng.uniform(-0.01, 0.22, 200)
    high = low + rng.uniform(0, 0.01, 200)
    first, last = table.ranges(low, high)
    for f, t, a, b in zip(first, last, low, high, strict=True):
        inside = (table.separation_rad >= np.float32(a)) & (table.separation_rad <= np.float32(b))
        np.testing.assert_array_equal(np.flatnonzero(inside), np.arange(f, t))


def test_a_range_includes_both_of_its_ends():
    table = PairTable.build(random_catalog(30, 0.1, 9), 0.2)
    ends = table.separation_rad[[4, 100]].astype(float)
    first, last = table.ranges(ends[:1], ends[1:])
    # Both directions of a pair lie side by side.
    assert (first, last) == (4, 102)


def test_a_range_turned_round_is_empty():
    table = PairTable.build(random_catalog(30, 0.1, 7), 0.2)
    first, last = table.ranges(np.array([0.1]), np.array([0.05]))
    assert first == last


def probes(table, seed):
    """Separations at random, below 0 and beyond the table, on its rows and on edges of bins."""
    rng = np.random.default_rng(seed)
    end = table.max_separation_rad
    rows = rng.choice(table.separation_rad, 100).astype(float)
    return np.concatenate([
        rng.uniform(-0.1 * end, 1.2 * end, 300), rows, np.nextafter(rows, 0), rows + 1e-9,
        np.radians(0.01) * rng.integers(0, int(end / np.radians(0.01)) + 2, 100),
        [-5.0, -1e-12, 0.0, end, 3.0, 50.0],
    ])


@pytest.mark.parametrize("limit_rad", [0.01, 0.2, np.radians(17)])
def test_the_first_row_of_a_separation_is_where_numpy_finds_it(limit_rad):
    table = PairTable.build(random_catalog(120, 0.5 * limit_rad, 13), limit_rad)
    for value in probes(table, 14):
        expected = np.searchsorted(table.separation_rad, np.float32(value))
        assert first_row(table, value) == expected, value


def test_the_first_row_is_found_in_the_papers_catalogue_too(paper):
    table = PairTable.build(paper, np.radians(12))
    for value in probes(table, 15):
        assert first_row(table, value) == np.searchsorted(table.separation_rad, np.float32(value))


def test_the_first_companion_of_a_separation_is_where_numpy_finds_it():
    table = PairTable.build(random_catalog(60, 0.1, 16), 0.2)
    values = probes(table, 17)
    for star in range(60):
        begin, end = table.near_start[star : star + 2]
        own = table.near_separation_rad[begin:end]
        for value in np.concatenate([values[::25], own.astype(float)[::5]]):
            expected = begin + np.searchsorted(own, np.float32(value))
            assert first_near(table, star, value) == expected


def test_a_star_without_companions_has_no_rows():
    table = PairTable.build(catalog_of(A=(0, 0), LONELY=(90, 0), B=(1, 0)), np.radians(5))
    assert table.near_start.tolist() == [0, 1, 1, 2]
    for value in (0.0, 0.01, 1.0):
        assert first_near(table, 1, value) == 1


def test_stars_out_of_reach_make_no_pairs():
    table = PairTable.build(catalog_of(NORTH=(0, 80), SOUTH=(0, -80)), np.radians(12))
    assert table.n_pairs == 0
    first, last = table.ranges(np.array([0.0]), np.array([1.0]))
    assert first == last == 0
    assert [first_row(table, value) for value in (-1.0, 0.0, 0.1, 1.0)] == [0, 0, 0, 0]


def test_the_table_does_not_depend_on_how_the_tree_visits_the_stars():
    """A square has four equal sides: ties go by the lower star, then the other; then reversed."""
    square = catalog_of(A=(0, 1), B=(1, 0), C=(0, -1), D=(359, 0))
    table = PairTable.build(square, np.radians(3))
    main, _ = by_separation(table)
    forth, back, apart = main[::2], main[1::2], table.separation_rad[::2]
    rows = list(zip(apart.tolist(), forth.tolist(), back.tolist(), strict=True))
    assert rows == sorted(rows)
    assert np.all(forth < back)
    assert len(rows) == table.n_pairs == 6


def test_a_catalogue_too_deep_for_the_separation_is_refused():
    n = 3000
    assert n * (n - 1) > MAX_DIRECTED_PAIRS
    text = (
        "3000 stars make 8997000 directed pairs up to 5 deg, more than 8000000: "
        "set max_separation_deg to 4.6 or less (0 = automatic), or lower limiting_magnitude"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        PairTable.build(random_catalog(n, 1e-3, 8), np.radians(5))


def test_the_separation_that_is_named_instead_is_small_enough():
    """The sky to V = 8, whose pairs go with the area but for the Milky Way."""
    catalog = StarCatalog.hipparcos(limiting_magnitude=8.0)
    with pytest.raises(ValueError, match="more than 8000000") as refused:
        PairTable.build(catalog, np.radians(12.0))
    named_deg = float(re.search(r"max_separation_deg to ([0-9.]+) or", str(refused.value))[1])
    assert named_deg == pytest.approx(7.3, abs=0.3)
    tree = cKDTree(catalog.vectors)
    directed = tree.count_neighbors(tree, float(chord(np.radians(named_deg)))) - len(catalog)
    assert 0.9 * MAX_DIRECTED_PAIRS < directed <= MAX_DIRECTED_PAIRS


@pytest.mark.parametrize(
    ("value", "shown"), [(0.4, "0.4"), (30.5, "30.5"), (-12.0, "-12"), (float("nan"), "nan")]
)
def test_a_largest_separation_out_of_range_is_refused(value, shown):
    text = f"max_separation_deg {shown} is outside of 0.5 to 30 (0 = automatic)"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        FeatureDatabase.build(catalog_of(A=(0, 0), B=(1, 0)), max_separation_deg=value)
