"""Patterns of hand-made neighbours: bits, compensation codes, sectors, packing, rolls."""

import numpy as np
import pytest

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.patterns import (
    SECTORS,
    PatternSettings,
    PatternTable,
    _bits,
    star_pattern,
)
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.identification.fallback import CAMERA_POLE

SETTINGS = PatternSettings()
STAR = unit_vectors(1.0, 0.4)
NAMES = ("radial", "companion", "cyclic")
#: Fifty stars of the real sky about which patterns are made.
N_SEEDED = 50


def about(star, places):
    """Unit vectors (k, 3) at these (separation, position angle) of a star, degrees."""
    apart, angle = np.radians(np.reshape(places, (-1, 2))).T[:, :, None]
    z = np.array([0.0, 0.0, 1.0])
    north = z - star * star[2]
    north /= np.linalg.norm(north)
    east = np.cross(z, star) / np.linalg.norm(np.cross(z, star))
    return np.cos(apart) * star + np.sin(apart) * (np.cos(angle) * north + np.sin(angle) * east)


def pattern_of(places, *, compensated=False, settings=SETTINGS, star=STAR):
    return star_pattern(star, about(star, places), settings, compensated=compensated)


def bits(vector):
    return np.flatnonzero(vector).tolist()


def at_sectors(*sectors):
    """Neighbours at these sectors from the first one; each is 45 deg wide."""
    return [(2.0 + 0.1 * i, 45 * sector) for i, sector in enumerate(sectors)]


@pytest.fixture(scope="module")
def sky():
    """The catalogue's vectors, and (index, neighbours) of N_SEEDED stars."""
    vectors = StarCatalog.paper().vectors
    chosen = np.random.default_rng(31).choice(len(vectors), N_SEEDED, replace=False)
    near = []
    for star in chosen.tolist():
        apart = separation(vectors, vectors[star])
        near.append((star, np.flatnonzero((apart > 0) & (apart < SETTINGS.radius_rad))))
    return vectors, near


@pytest.fixture(scope="module")
def table(sky):
    return PatternTable.build(sky[0], SETTINGS)


# The rings (5-7) to (5-10)


def test_the_radius_is_cut_into_rings():
    """Equation (5-7): 6 deg / 0.05 deg = 120; packed, 15 + 15 + 1 bytes."""
    assert SETTINGS.n_rings == 120
    assert SETTINGS.n_bytes == 31
    for vector, n in zip(NAMES, (120, 120, 8), strict=True):
        assert getattr(pattern_of([(1.0, 0.0)]), vector).shape == (n,)


def test_number_of_rings_that_do_not_fill_bytes():
    settings = PatternSettings(np.radians(6), np.radians(0.1))
    assert (settings.n_rings, settings.n_bytes) == (60, 17)


def test_the_papers_example_of_a_discrete_value():
    """Discrete value v / e + 1 = 27.25 sets bit 27 of those counted from 1 (5-8, 5-9)."""
    apart_deg = (27.25 - 1) * 0.05
    assert bits(pattern_of([(apart_deg, 70.0)]).radial) == [27 - 1]


@pytest.mark.parametrize(
    ("apart_deg", "ring"),
    [(0.001, 0), (0.0499, 0), (0.0501, 1), (1.999, 39), (2.001, 40), (5.951, 119), (5.999, 119)],
)
def test_a_neighbour_sets_the_bit_of_its_ring(apart_deg, ring):
    assert bits(pattern_of([(apart_deg, 200.0)]).radial) == [ring]


def test_neighbours_beyond_the_radius_set_no_bit():
    pattern = pattern_of([(6.02, 10.0), (7.5, 100.0)])
    assert bits(pattern.radial) == []


def test_two_neighbours_in_one_ring_set_one_bit():
    assert bits(pattern_of([(1.01, 10.0), (1.04, 100.0)]).radial) == [20]


@pytest.mark.parametrize(
    ("first", "other", "apart_deg"),
    [((1.0, 30.0), (2.53, 30.0), 1.53), ((1.0, 30.0), (2.02, 210.0), 3.02),
     ((5.99, 0.0), (5.99, 180.0), 11.98)],
)
def test_companion_rings_are_twice_as_wide(first, other, apart_deg):
    """Equation (5-10): separations of neighbours, to 2 R_r, in as many bits as radial ones."""
    pattern = pattern_of([first, other])
    assert bits(pattern.companion) == [int(apart_deg / 0.1)]


def test_every_two_neighbours_set_a_companion_bit():
    """A star and three more on one line at 1.02, 2.55 and 5.07 deg: 1.53, 4.05 and 2.52 apart."""
    pattern = pattern_of([(1.02, 5.0), (2.55, 5.0), (5.07, 5.0)])
    assert bits(pattern.radial) == [20, 51, 101]
    assert bits(pattern.companion) == [15, 25, 40]


# Compensation codes


@pytest.mark.parametrize(
    ("value", "ring"),
    [(26.25, [25, 26]), (26.299, [25, 26]), (26.301, [26]), (26.5, [26]), (26.699, [26]),
     (26.701, [26, 27]), (0.001, [0]), (0.299, [0]), (0.301, [0]), (0.701, [0, 1]),
     (119.1, [118, 119]), (119.5, [119]), (119.701, [119]), (119.999, [119])],
)
def test_compensation_codes_of_rings(value, ring):
    """Below a fraction of 0.3 the ring before, above 0.7 the next; none off either end."""
    assert bits(pattern_of([(value * 0.05, 77.0)], compensated=True).radial) == ring


@pytest.mark.parametrize(
    ("value", "ring"),
    [(15.299, [14, 15]), (15.301, [15]), (15.699, [15]), (15.701, [15, 16]), (0.1, [0]),
     (0.9, [0, 1]), (59.9, [59, 60])],
)
def test_compensation_codes_of_companion_rings(value, ring):
    pattern = pattern_of([(0.02, 77.0), (0.02 + value * 0.1, 77.0)], compensated=True)
    assert bits(pattern.companion) == ring


@pytest.mark.parametrize(
    ("sector", "expected"),
    [(3.299, [2, 3]), (3.301, [3]), (3.699, [3]), (3.701, [3, 4]), (6.701, [6, 7]),
     (7.2, [6, 7])],
)
def test_compensation_codes_of_sectors(sector, expected):
    """The smallest angle is that between the first two neighbours, 0.1 and then 0.4 sectors.

    The first side itself lies at fraction 0: bit 0, and by the cyclic wrap bit 7.
    """
    pattern = pattern_of(at_sectors(0, 0.1, sector), compensated=True)
    assert bits(pattern.cyclic) == sorted({0, 7, *expected})


def test_the_first_side_is_compensated_into_the_last_sector():
    places = at_sectors(0, 0.1, 3.5)
    assert bits(pattern_of(places).cyclic) == [0, 3]
    assert bits(pattern_of(places, compensated=True).cyclic) == [0, 3, 7]


def test_the_last_sector_is_compensated_into_the_first():
    """Of whole patterns only the bits alone show it: the first side sets bit 0 anyway."""
    for compensated, expected in ((False, [7]), (True, [0, 7])):
        found = _bits(np.array([7.701]), SECTORS, compensated=compensated, cyclic=True)
        assert bits(found) == expected


def test_raw_bits_are_among_the_compensated_ones(sky):
    vectors, near = sky
    more = 0
    for star, index in near:
        raw, full = (
            star_pattern(vectors[star], vectors[index], SETTINGS, compensated=compensated)
            for compensated in (False, True)
        )
        for name in NAMES:
            assert not np.any(getattr(raw, name) & ~getattr(full, name))
            more += np.count_nonzero(getattr(full, name)) - np.count_nonzero(getattr(raw, name))
    assert more > 0


# The sectors


@pytest.mark.parametrize("turn_deg", [0.0, 1.0, 100.0, 200.0, 350.0])
def test_sectors_are_counted_from_the_first_side_of_the_smallest_angle(turn_deg):
    """Neighbours at 10, 130, 150 and 290 deg: the smallest angle begins at 130.

    From there they are 240, 0, 20 and 160 deg on: sectors 5, 0, 0 and 3.
    """
    places = [(2.0, 10 + turn_deg), (3.0, 130 + turn_deg), (1.0, 150 + turn_deg),
              (4.0, 290 + turn_deg)]
    assert bits(pattern_of(places).cyclic) == [0, 3, 5]


def test_the_smallest_angle_may_lie_across_north():
    """355 and 5 deg: from 355, the neighbours are 0, 10, 95 and 185 deg on."""
    places = [(2.0, 5.0), (3.0, 90.0), (1.0, 180.0), (4.0, 355.0)]
    assert bits(pattern_of(places).cyclic) == [0, 2, 4]


def test_the_order_of_the_neighbours_does_not_matter():
    places = [(2.0, 5.0), (3.0, 90.0), (1.0, 180.0), (4.0, 355.0)]
    for order in (places[::-1], places[2:] + places[:2]):
        for name in NAMES:
            np.testing.assert_array_equal(
                getattr(pattern_of(order), name), getattr(pattern_of(places), name)
            )


def test_a_star_without_neighbours_has_no_bit():
    for compensated in (False, True):
        pattern = star_pattern(STAR, np.empty((0, 3)), SETTINGS, compensated=compensated)
        assert [bits(getattr(pattern, name)) for name in NAMES] == [[], [], []]


@pytest.mark.parametrize("angle_deg", [0.0, 44.0, 180.0, 359.0])
def test_one_neighbour_is_the_first_side_itself(angle_deg):
    pattern = pattern_of([(1.01, angle_deg)])
    assert [bits(getattr(pattern, name)) for name in NAMES] == [[20], [], [0]]


# Rolls and mirrors


def camera_frame(vectors, star, index, rng):
    """The star and its neighbours in a camera that points near the star at any roll."""
    ra, dec = np.arctan2(vectors[star, 1], vectors[star, 0]), np.arcsin(vectors[star, 2])
    offset = rng.uniform(-0.04, 0.04, 2)
    rotation = rotation_from_boresight(
        ra + offset[0], np.clip(dec + offset[1], -1.57, 1.57), rng.uniform(0, 2 * np.pi)
    )
    return vectors[star] @ rotation, vectors[index] @ rotation


@pytest.mark.parametrize("compensated", [False, True])
def test_a_camera_at_any_roll_sees_the_catalogues_pattern(sky, compensated):
    """Off the image's middle too, and counted about the camera's own pole."""
    vectors, near = sky
    rng = np.random.default_rng(32)
    for star, index in near:
        expected = star_pattern(vectors[star], vectors[index], SETTINGS, compensated=compensated)
        for _ in range(4):
            main, others = camera_frame(vectors, star, index, rng)
            found = star_pattern(
                main, others, SETTINGS, pole=CAMERA_POLE, compensated=compensated
            )
            for name in NAMES:
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_mirror_image_has_other_sectors(sky):
    """Separations survive a mirror, the sense in which sectors are counted does not.

    Nearly all stars tell: only a symmetric or an almost full circle does not.
    """
    vectors, near = sky
    rng = np.random.default_rng(33)
    other = 0
    for star, index in near:
        raw = star_pattern(vectors[star], vectors[index], SETTINGS, compensated=False)
        main, others = camera_frame(vectors, star, index, rng)
        flip = np.array([1, -1, 1])
        found = star_pattern(
            main * flip, others * flip, SETTINGS, pole=CAMERA_POLE, compensated=False
        )
        np.testing.assert_array_equal(found.radial, raw.radial)
        np.testing.assert_array_equal(found.companion, raw.companion)
        other += not np.array_equal(found.cyclic, raw.cyclic)
    assert other > 0.5 * len(near)


def test_a_hand_made_mirror_image_has_other_sectors():
    """0, 20 and 100 deg: sectors 0, 0 and 2. Mirrored, from -20: 0, 20 and 280: 0, 0 and 6."""
    assert bits(pattern_of([(1, 0), (2, 20), (3, 100)]).cyclic) == [0, 2]
    assert bits(pattern_of([(1, 0), (2, -20), (3, -100)]).cyclic) == [0, 6]


# The table


def test_the_table_holds_each_stars_compensated_pattern(sky, table):
    """Packing and unpacking change nothing."""
    vectors, near = sky
    assert table.packed.shape == (len(vectors), SETTINGS.n_bytes)
    assert table.packed.dtype == np.uint8
    level = table.level(1)
    assert level.settings == SETTINGS
    for star, index in near:
        expected = star_pattern(vectors[star], vectors[index], SETTINGS, compensated=True)
        for name in NAMES:
            np.testing.assert_array_equal(getattr(level, name)[star], getattr(expected, name))


def test_rings_that_do_not_fill_bytes_survive_packing():
    settings = PatternSettings(np.radians(6), np.radians(0.5))  # 12 rings
    near = about(STAR, [(0.8, 10.0), (5.75, 60.0), (2.2, 250.0)])
    vectors = np.concatenate([STAR[None], near])
    level = PatternTable.build(vectors, settings).level(1)
    expected = star_pattern(STAR, near, settings, compensated=True)
    for name in NAMES:
        np.testing.assert_array_equal(getattr(level, name)[0], getattr(expected, name))


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 60])
def test_a_wide_ring_is_set_where_one_of_its_narrow_rings_is(table, factor):
    narrow, wide = table.level(1), table.level(factor)
    assert wide.settings.n_rings == 120 // factor
    assert wide.settings.ring_rad == pytest.approx(factor * SETTINGS.ring_rad)
    assert wide.settings.radius_rad == SETTINGS.radius_rad
    for name in ("radial", "companion"):
        parts = [getattr(narrow, name)[:, i::factor] > 0 for i in range(factor)]
        found = getattr(wide, name)
        np.testing.assert_array_equal(found > 0, np.logical_or.reduce(parts))
        assert found.dtype == np.float32
        assert set(np.unique(found)) <= {0.0, 1.0}
    np.testing.assert_array_equal(wide.cyclic, narrow.cyclic)


@pytest.mark.parametrize("factor", [2, 4])
def test_a_joined_ring_is_the_ring_of_the_widened_settings(sky, factor):
    """So an observed raw pattern of wide rings is compared with the same rings."""
    vectors, near = sky
    wide = PatternSettings(SETTINGS.radius_rad, SETTINGS.ring_rad * factor)
    for star, index in near:
        narrow_bits, wide_bits = (
            star_pattern(vectors[star], vectors[index], settings, compensated=False)
            for settings in (SETTINGS, wide)
        )
        for name in ("radial", "companion"):
            joined = getattr(narrow_bits, name).reshape(-1, factor).any(axis=1)
            np.testing.assert_array_equal(joined, getattr(wide_bits, name))


def test_a_level_is_built_once(table):
    assert table.level(2) is table.level(2)


@pytest.mark.parametrize("factor", [7, 9, 240])
def test_a_factor_that_does_not_divide_the_rings_is_refused(table, factor):
    text = f"120 rings cannot be joined by {factor}: use a factor that divides 120"
    with pytest.raises(ValueError, match=f"^{text}$"):
        table.level(factor)


def test_stars_far_from_each_other_have_empty_patterns():
    vectors = unit_vectors(np.radians([0.0, 90, 200]), np.radians([0.0, 10, -40]))
    np.testing.assert_array_equal(PatternTable.build(vectors, SETTINGS).packed, 0)


@pytest.mark.parametrize(
    ("radius_deg", "ring_deg"),
    [(6.0, 0.0), (6.0, -0.05), (6.0, 6.0), (6.0, 7.0), (45.0, 0.05), (6.0, np.nan),
     (np.nan, 0.05), (np.inf, 0.05)],
)
def test_settings_that_make_no_rings_are_refused(radius_deg, ring_deg):
    text = "^pattern rings must be narrower than the radius, that below 45 deg$"
    with pytest.raises(ValueError, match=text):
        PatternSettings(np.radians(radius_deg), np.radians(ring_deg))
