"""Triangles of guide stars: each in the cell of its shape, whatever the scale and the roll."""

import math
from collections import Counter

import numpy as np
import pytest
from engines import random_sky

from star_tracker.catalogue.triangles import (
    ANY_SCALE,
    COMPANIONS,
    KNOWN_SCALE,
    RATIO_LOW,
    RATIO_RANGE,
    SIZE_LOW,
    SIZE_RANGE,
    TriangleTable,
)
from star_tracker.geometry.spherical import position_angle, separation
from star_tracker.maps.simulation import random_rotation

N_STARS, N_COMPANIONS = 60, 8


@pytest.fixture(scope="module")
def sky():
    return random_sky(N_STARS, 1)


@pytest.fixture(scope="module")
def v_mag():
    """Whole magnitudes, so that some are alike."""
    return np.random.default_rng(6).integers(1, 6, N_STARS).astype(float)


@pytest.fixture(scope="module", params=[KNOWN_SCALE, ANY_SCALE], ids=["known", "any"])
def table(sky, v_mag, request):
    return TriangleTable.build(sky, v_mag, N_COMPANIONS, request.param)


def row_of(main, first, second, turn, v_mag):
    """A row: the main star, which stars are the brighter ones, the second's position angle."""
    two = (main, first), (main, second), (first, second)
    order = sum(1 << bit for bit, (a, b) in enumerate(two) if v_mag[a] < v_mag[b])
    return (main * 8 + order) * 256 + math.floor(turn / (2 * math.pi) * 256)


def cell_of(grid, log_ratio, log_size, turn):
    """The cell of a shape, None where it is kept nowhere."""
    at = math.floor((log_ratio - RATIO_LOW) / (RATIO_RANGE / grid.ratios))
    size = math.floor((log_size - SIZE_LOW) / (SIZE_RANGE / grid.sizes))
    if not (0 <= at < grid.ratios and 0 <= size < grid.sizes):
        return None
    around = math.floor(turn % (2 * math.pi) / (2 * math.pi) * grid.angles) % grid.angles
    return (at * grid.angles + around) * grid.sizes + size


def rows_with_cells(table):
    n = np.diff(table.cell_start)
    return Counter(zip(np.repeat(np.arange(len(n)), n), table.rows, strict=True))


def naive_rows(sky, v_mag, n_companions, grid):
    """Each pair of companions in both orders, one star after the other."""
    found = Counter()
    log_spacing = math.log(math.sqrt(4 / len(sky)))
    for main in range(len(sky)):
        apart = np.array(separation(sky, sky[main]))
        near = np.argsort(apart)[1 : n_companions + 1]
        angle = np.array(position_angle(sky[main], sky[near]))
        for i, first in enumerate(near.tolist()):
            for j, second in enumerate(near.tolist()):
                log_size = math.log(apart[second])
                cell = cell_of(
                    grid, log_size - math.log(apart[first]), log_size - log_spacing,
                    angle[j] - angle[i],
                )
                if i != j and cell is not None:
                    found[cell, row_of(main, first, second, angle[j], v_mag)] += 1
    return found


def test_each_triangle_is_in_the_cell_of_its_shape_and_no_other(sky, v_mag, table):
    expected = naive_rows(sky, v_mag, N_COMPANIONS, table.grid)
    assert rows_with_cells(table) == expected
    # Of two orders the farther companion is the second, mostly; few are too oblong or too small.
    assert sum(expected.values()) > 0.5 * N_STARS * N_COMPANIONS * (N_COMPANIONS - 1)


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.7])
def test_a_triangle_is_found_by_its_shape_at_any_scale_and_roll(sky, v_mag, table, scale):
    """Of the size nothing but the cell along its axis depends on the scale."""
    rng = np.random.default_rng(2)
    rows = rows_with_cells(table)
    grid = table.grid
    shapes = {(*divmod(cell // grid.sizes, grid.angles), code) for cell, code in rows}
    n_found = 0
    for _ in range(300):
        main, (i, j) = int(rng.integers(N_STARS)), rng.choice(N_COMPANIONS, 2, replace=False)
        first, second = table.fan_star[main, [i, j]]
        turned = sky @ random_rotation(rng)
        apart = scale * separation(turned[[first, second]], turned[main])
        angle = position_angle(turned[main], turned[[first, second]], (0.0, -1.0, 0.0))
        at = (math.log(apart[1] / apart[0]) - RATIO_LOW) / (RATIO_RANGE / grid.ratios)
        around = (angle[1] - angle[0]) % (2 * math.pi) / (2 * math.pi) * grid.angles
        on_an_edge = min(at % 1, around % 1, 1 - at % 1, 1 - around % 1) < 1e-6
        size = (math.log(apart[1] / scale) - table.log_spacing - SIZE_LOW) / SIZE_RANGE
        if on_an_edge or not (0 <= at < grid.ratios and 0 <= size < 1):
            continue
        on_sky = float(position_angle(sky[main], sky[second]))
        code = row_of(main, first, second, on_sky, v_mag)
        assert (math.floor(at), math.floor(around), code) in shapes
        n_found += 1
    assert n_found > 150


def test_a_fan_lists_the_nearest_companions_in_order(sky, table):
    for main in range(N_STARS):
        apart = np.array(separation(sky, sky[main]))
        near = np.argsort(apart)[1 : N_COMPANIONS + 1]
        np.testing.assert_array_equal(table.fan_star[main], near)
        np.testing.assert_allclose(np.exp(table.fan_log_separation[main]), apart[near], rtol=1e-6)
        np.testing.assert_allclose(
            table.fan_azimuth[main], position_angle(sky[main], sky[near]), atol=1e-6
        )


def test_the_spacing_is_that_of_stars_spread_over_the_sphere(table):
    """4 pi / n steradians a star, and its square root over pi / 4 of a square."""
    assert math.exp(table.log_spacing) == pytest.approx(math.sqrt(4 / N_STARS))


@pytest.mark.parametrize("n", [2, 3, 10])
def test_a_few_stars_have_few_companions(n):
    table = TriangleTable.build(random_sky(n, n), np.full(n, 4.0))
    assert table.fan_star.shape == (n, n - 1)
    assert table.cell_start[-1] == len(table.rows)


def test_stars_at_one_place_do_not_become_their_own_companions():
    sky = random_sky(30, 3)
    sky[7] = sky[3] + 1e-9
    sky[7] /= np.linalg.norm(sky[7])
    table = TriangleTable.build(sky, np.full(30, 4.0), 5)
    assert np.all(table.fan_star != np.arange(30)[:, None])
    assert table.fan_star[7, 0] == 3
    assert table.fan_star[3, 0] == 7


def test_an_empty_table_has_no_triangles():
    table = TriangleTable.empty()
    assert len(table.rows) == 0
    assert table.cell_start[-1] == 0


def test_as_many_companions_as_the_search_looks_at():
    table = TriangleTable.build(random_sky(40, 4), np.full(40, 4.0))
    assert table.fan_star.shape == (40, COMPANIONS)
