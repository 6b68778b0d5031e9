"""The fallback matcher on tiny catalogues of named stars, and on seeded pieces of the real sky."""

import math
import re

import numpy as np
import pytest
from engines import CAMERA, ELSEWHERE, FIGURE, catalog_of, database_of, rotation_to

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.patterns import Pattern, PatternLevel, PatternSettings, star_pattern
from star_tracker.geometry.spherical import separation
from star_tracker.identification import fallback
from star_tracker.identification.fallback import (
    CAMERA_POLE,
    RadialCyclicSettings,
    StarField,
    candidates,
)
from star_tracker.identification.labels import StarState
from star_tracker.maps.simulation import random_rotation, uniform_noise, visible_stars
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

WIDE = Camera.from_fov(20, 1024, 1024)
#: Seeded fields of 20 deg, of which half of the stars are dropped.
N_THINNED = 40
#: The eight maps: labels in the paper's tables.
N_LABELS = 141


def view(database, rotation, camera=CAMERA):
    """A frame of all stars that a camera sees, without noise: the field, and who they are."""
    index, pixels = visible_stars(database.catalog, camera, rotation)
    return field_at(pixels, camera), index


def field_at(xy_px, camera=CAMERA):
    return StarField(camera.vectors(xy_px), camera.focal_length_px)


def steps_of(database, field, **options):
    return list(candidates(database, field, RadialCyclicSettings(**options)))


def proposed(database, field, **options):
    return [c for _, c in steps_of(database, field, **options) if c is not None]


def pointing(places):
    """Camera vectors (k, 3) at these (separation, position angle), degrees, of the boresight.

    Position angles count from the image's up direction towards the left.
    """
    apart, angle = np.radians(np.reshape(places, (-1, 2))).T
    return np.column_stack([
        -np.sin(apart) * np.sin(angle), -np.sin(apart) * np.cos(angle), np.cos(apart),
    ])


def field_of(places):
    return StarField(pointing(places), CAMERA.focal_length_px)


def sky_of(places, far=2):
    """A database of a hub, index 0, of stars about it and of some stars on the other side."""
    rotation = rotation_to(40.0, 10.0)
    vectors = pointing([(0.0, 0.0), *places]) @ rotation.T
    return FeatureDatabase.build(catalog_of(np.concatenate([vectors, -vectors[:far]])))


@pytest.fixture(scope="module")
def figure():
    return database_of(FIGURE, ELSEWHERE)


@pytest.fixture(scope="module")
def paper(database):
    return database


# The field


def test_the_star_nearest_to_the_boresight_comes_first_from_the_centre():
    field = field_at([(300.0, 256), (0, 0), (256, 250)])
    assert field.from_centre.tolist() == [2, 0, 1]


def test_neighbours_are_the_nearest_other_stars_in_order():
    """At the image's middle: one star 10 px to the right, one 20 px up, one 30 px to the left."""
    field = field_at([(226.0, 256), (256, 256), (256, 236), (266, 256)])
    index, apart, angle = field.neighbours(1, 20)
    assert index.tolist() == [3, 2, 0]
    np.testing.assert_allclose(apart, np.arctan(np.array([10, 20, 30]) / CAMERA.fx_px))
    # From up towards the left, as position angles on the sky grow from north towards east.
    np.testing.assert_allclose(np.degrees(angle), [270, 0, 90], atol=1e-9)
    assert field.neighbours(1, 2)[0].tolist() == [3, 2]


# Candidates of a tiny catalogue


@pytest.mark.slow
def test_the_first_candidate_names_the_right_stars_at_any_roll(figure):
    for roll_deg in np.arange(0.0, 360.0, 3.0):
        field, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
        assert len(truth) == len(FIGURE)
        first = proposed(figure, field)[0]
        assert len(first.observed) >= 4
        np.testing.assert_array_equal(first.catalog, truth[first.observed])


@pytest.mark.parametrize("roll_deg", [359.99, 0.0, 0.01, 180.0])
def test_the_hub_finds_itself_and_all_its_neighbours(figure, roll_deg):
    """All others lie within 6 deg of it, also where rolls wrap at the full circle."""
    field, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
    (found,) = proposed(figure, field, ring_factors=(1,), mains=1, matches=1)
    assert found.observed[0] == field.from_centre[0]
    assert set(found.observed.tolist()) == set(range(len(truth)))
    np.testing.assert_array_equal(found.catalog, truth[found.observed])


def test_every_main_star_finds_itself(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1, 71.0))
    found = proposed(figure, field, ring_factors=(1,), matches=1)
    assert {int(c.observed[0]): int(c.catalog[0]) for c in found} == dict(enumerate(truth))


@pytest.mark.parametrize("place", [(0.0, 0.0), (120.0, 89.0), (300.0, -89.5)])
def test_anywhere_on_the_sky_and_at_the_poles_too(place):
    rng = np.random.default_rng(1)
    rotation = rotation_to(*place, 77.0)
    vectors = CAMERA.vectors(rng.random((10, 2)) * 512) @ rotation.T
    database = FeatureDatabase.build(catalog_of(np.concatenate([vectors, -vectors])))
    field, truth = view(database, rotation)
    first = proposed(database, field)[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_a_mirror_image_of_the_sky_is_not_matched_whole(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    mirrored = StarField(field.vectors * (1, -1, 1), field.focal_px)
    for candidate in proposed(figure, mirrored, ring_factors=(1,)):
        assert len(set(candidate.observed.tolist())) < 5


def test_the_tolerance_is_the_width_of_the_rings(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    ring_px = np.radians(0.05) * CAMERA.focal_length_px
    tolerances = [c.tolerance_px for c in proposed(figure, field, ring_factors=(1, 2, 4))]
    assert tolerances == sorted(tolerances)
    assert sorted(set(tolerances)) == pytest.approx([ring_px, 2 * ring_px, 4 * ring_px])


def test_the_main_stars_are_those_nearest_to_the_images_centre(figure):
    field, _ = view(figure, rotation_to(57.9, 23.1))
    mains = {int(c.observed[0]) for c in proposed(figure, field, mains=3)}
    assert mains <= set(field.from_centre[:3].tolist())
    assert field.from_centre[0] in mains


@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_stars_have_no_candidate(figure, n):
    field = field_at(np.array([(100.0, 100.0), (200.0, 180.0)])[:n])
    assert proposed(figure, field) == []


def test_stars_that_resemble_nothing_have_no_candidate(figure):
    """Three stars less than 0.02 deg apart lie in the first ring, where no guide star is."""
    field = field_at([(256.0, 256), (256.5, 256), (256, 256.4)])
    assert proposed(figure, field, ring_factors=(1,)) == []


# The alignment


FOUR = [(1.02, 10.0), (2.07, 80.0), (3.13, 170.0), (4.22, 290.0)]
TWO = [(1.52, 40.0), (2.63, 220.0)]


def turned(places, by_deg):
    return [(apart, angle - by_deg) for apart, angle in places]


def aligned(database, places):
    """The only candidate of the hub at the image's centre: catalogue index by observed row."""
    field = field_of([(0.0, 0.0), *places])
    found = [
        c for c in proposed(database, field, ring_factors=(1,), mains=1) if c.catalog[0] == 0
    ]
    return dict(zip(found[0].observed.tolist(), found[0].catalog.tolist(), strict=True))


@pytest.mark.parametrize("roll_deg", [0.0, 30.0, 100.0, 359.0])
@pytest.mark.parametrize("other_deg", [90.0, 180.0, -60.0])
def test_the_largest_consistent_roll_wins(roll_deg, other_deg):
    """Four neighbours are turned by one roll, two by another: the four are named."""
    database = sky_of(FOUR + TWO)
    frame = turned(FOUR, roll_deg) + turned(TWO, roll_deg + other_deg)
    assert aligned(database, frame) == {0: 0, 1: 1, 2: 2, 3: 3, 4: 4}
    assert aligned(database, turned(FOUR[:1], roll_deg) + turned(TWO, roll_deg + other_deg)) == {
        0: 0, 2: 5, 3: 6,
    }


@pytest.mark.parametrize("roll_deg", [0.0, 1.0, 2.0, 358.0, 359.0])
def test_rolls_on_both_sides_of_zero_belong_together(roll_deg):
    places = [*FOUR[:3], (FOUR[3][0], FOUR[3][1] + 3.0)]
    assert len(aligned(sky_of(FOUR), turned(places, roll_deg))) == 5


@pytest.mark.parametrize(("off_deg", "n"), [(5.0, 5), (-5.0, 5), (6.5, 4), (-6.5, 4)])
def test_a_neighbour_that_is_turned_too_far_is_left_out(off_deg, n):
    """Two bins of the primary's rolls are 5.6 deg wide; so are the fallback's."""
    places = [*FOUR[:3], (FOUR[3][0], FOUR[3][1] + off_deg)]
    assert len(aligned(sky_of(FOUR), places)) == n


@pytest.mark.parametrize(("off_deg", "n"), [(0.04, 5), (-0.04, 5), (0.07, 4), (-0.07, 4)])
def test_a_neighbour_at_another_separation_is_left_out(off_deg, n):
    """By more than a ring, 0.05 deg."""
    places = [*FOUR[:3], (FOUR[3][0] + off_deg, FOUR[3][1])]
    assert len(aligned(sky_of(FOUR), places)) == n


def test_one_neighbour_is_not_enough():
    database = sky_of(FOUR)
    field = field_of([(0.0, 0.0), FOUR[0], (2.5, 10.0), (4.8, 200.0)])
    assert all(c.catalog[0] != 0 for c in proposed(database, field, ring_factors=(1,), mains=1))


# The similarity


def level_of(radial, companion, cyclic):
    settings = PatternSettings(np.radians(0.4), np.radians(0.1))
    return PatternLevel(settings, *(np.array(x, np.float32) for x in (radial, companion, cyclic)))


def pattern_of(radial, companion, cyclic):
    return Pattern(*(np.array(x, np.bool_) for x in (radial, companion, cyclic)))


def test_the_likelihood_by_hand():
    """Of a guide star with half of its bits set, q = 0.5 + 0.5 * 0.5 = 0.75.

    Two of three observed radial bits match: 2 ln(0.75 / 0.5) + ln(0.25 / 0.5). No companion bit.
    """
    level = level_of([[1, 1, 0, 0]], [[1, 1, 0, 0]], [[0] * 8])
    observed = pattern_of([1, 1, 1, 0], [0, 0, 0, 0], [1] * 8)
    similarity = fallback._likelihood(level, [observed])
    np.testing.assert_allclose(similarity, [[2 * math.log(1.5) - math.log(2)]], rtol=1e-6)


@pytest.mark.parametrize("fill", [0, 1])
def test_the_likelihood_of_empty_and_of_full_patterns_is_finite(fill):
    level = level_of([[fill] * 4], [[fill] * 4], [[fill] * 8])
    for bit in (0, 1):
        observed = pattern_of([bit] * 4, [bit] * 4, [bit] * 8)
        similarity = fallback._likelihood(level, [observed])
        assert np.isfinite(similarity).all()


def ranks_of_thinned_fields(database):
    """How many guide stars beat the true one: main stars with half a field."""
    rng = np.random.default_rng(41)
    level = database.patterns.level(1)
    ranks = []
    while len(ranks) < N_THINNED:
        field, truth = view(database, random_rotation(rng), WIDE)
        main = int(field.from_centre[0])
        near = separation(field.vectors, field.vectors[main]) < level.settings.radius_rad
        near &= rng.random(len(truth)) < 0.5
        near[main] = False
        if near.sum() < 5:
            continue
        observed = star_pattern(
            field.vectors[main], field.vectors[near], level.settings, pole=CAMERA_POLE,
            compensated=False,
        )
        similarity = fallback._likelihood(level, [observed])[0]
        ranks.append(np.count_nonzero(similarity > similarity[truth[main]]))
    return ranks


def test_missing_neighbours_do_not_count_against_a_guide_star(paper):
    """Half of the neighbours within 6 deg are dropped, five or more are left.

    The true star is nearly always first of 4908 and never misses the 20 that are aligned.
    """
    ranks = ranks_of_thinned_fields(paper)
    assert ranks.count(0) >= 0.9 * N_THINNED
    assert max(ranks) < RadialCyclicSettings().matches


def test_half_a_frame_still_brings_the_true_star_first_as_a_candidate(paper):
    rng = np.random.default_rng(42)
    field, truth = view(paper, rotation_to(84.0, -2.0, 50.0), WIDE)
    main = int(field.from_centre[0])
    kept = rng.random(len(truth)) < 0.5
    kept[main] = True
    thinned = StarField(field.vectors[kept], field.focal_px)
    options = {"ring_factors": (1,), "mains": 1, "matches": 1}
    (found,) = proposed(paper, thinned, **options)
    # Two stars in one ring and direction stand for each other here; verification tells them.
    right = found.catalog == truth[kept][found.observed]
    assert np.count_nonzero(right) >= 0.8 * len(right)
    assert found.catalog[0] == truth[main]


# What is compared, and the steps


def test_n_compared_counts_the_pairs_and_grows(figure):
    """A hypothesis is a directed guide-star pair of a separation in an observed pair's ring."""
    field, _ = view(figure, rotation_to(57.5, 24.8, 20.0))
    catalog = figure.catalog.vectors
    guide = separation(catalog[:, None], catalog[None])
    guide = guide[(guide > 0) & (guide <= np.radians(12))]
    expected, pairs = [0], 0
    for factor in (1, 2, 4):
        ring = factor * np.radians(0.05)
        for main in field.from_centre[:5].tolist():
            apart = np.delete(separation(field.vectors, field.vectors[main]), main)
            apart = apart[apart < np.radians(6)]
            pairs += np.count_nonzero(np.abs(guide[None] - apart[:, None]) <= ring)
            expected.append(pairs)
    steps = steps_of(figure, field, mains=5)
    counts = [n for n, _ in steps]
    assert sorted(set(counts)) == sorted(set(expected))
    assert counts == sorted(counts)
    ring_px = np.radians(0.05) * CAMERA.focal_length_px
    for n, candidate in steps:
        if candidate is not None:
            # All main stars of a width of ring are compared before the first candidate.
            width = [1, 2, 4].index(round(candidate.tolerance_px / ring_px))
            assert n == expected[5 * (1 + width)]


def test_a_frame_of_a_thousand_points_yields_often(paper, monkeypatch):
    """A step for each main star, three for each pattern of it, one for each guide star and level.

    What lies between two steps is bounded: no pattern is made of more than 60 neighbours.
    """
    sizes = []

    def watched(star, neighbours, *args, **options):
        sizes.append(len(neighbours))
        return star_pattern(star, neighbours, *args, **options)

    monkeypatch.setattr(fallback, "star_pattern", watched)
    field = field_at(uniform_noise(CAMERA, 1000, np.random.default_rng(7)))
    patterns_at_step = []
    steps = []
    for step in candidates(paper, field, RadialCyclicSettings(ring_factors=(1, 2))):
        steps.append(step)
        patterns_at_step.append(len(sizes))
    assert len(steps) == 15 + 2 * (3 * 15 + 1 + 15 * 20)
    assert [candidate for _, candidate in steps[:30]] == [None] * 30
    assert max(np.diff(patterns_at_step)) == 1
    assert max(sizes) == 60


def test_a_refused_pair_is_a_step_of_its_own(figure):
    """A step for each main star; for each ring width one, three a pattern, one a guide star."""
    field, truth = view(figure, rotation_to(56.9, 24.1))
    n = len(truth)
    steps = steps_of(figure, field, ring_factors=(1, 2))
    assert len(steps) == n + 2 * (3 * n + 1 + n * len(figure.catalog))
    assert sum(candidate is None for _, candidate in steps) > n + 2 * 3 * n


def test_no_more_guide_stars_than_asked_become_candidates(paper):
    field, _ = view(paper, rotation_to(84.0, -2.0))
    for matches in (1, 7):
        found = proposed(paper, field, ring_factors=(1,), mains=4, matches=matches)
        mains = [int(c.observed[0]) for c in found]
        assert max(mains.count(main) for main in mains) <= matches
        assert len(set(mains)) <= 4


@pytest.mark.parametrize(("options", "text"), [
    ({"ring_factors": ()}, "ring_factors, mains and matches must be at least 1"),
    ({"ring_factors": (1, 0)}, "ring_factors, mains and matches must be at least 1"),
    ({"mains": 0}, "ring_factors, mains and matches must be at least 1"),
    ({"matches": -1}, "ring_factors, mains and matches must be at least 1"),
])
def test_settings_that_could_find_nothing_are_refused(options, text):
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        RadialCyclicSettings(**options)


def test_factors_that_do_not_divide_the_rings_are_refused_before_any_frame(paper):
    """`solve` raises only for an array of another shape."""
    settings = SolveSettings(radial_cyclic=RadialCyclicSettings(ring_factors=(7,)))
    with pytest.raises(ValueError, match="120 rings cannot be joined by 7"):
        StarTracker(paper, CAMERA, settings)


# The eight maps without the primary


@pytest.fixture(scope="module")
def solved_maps(paper):
    """(map, solution) of the eight maps by the fallback alone."""
    settings = SolveSettings(method="radial_cyclic", deadline_ms=math.inf)
    return [
        (star_map, StarTracker(paper, star_map.camera, settings).solve(star_map.xy_px))
        for star_map in paper_maps()
    ]


def test_all_labels_of_the_eight_maps_are_right(paper, solved_maps):
    right = 0
    for star_map, solution in solved_maps:
        assert solution.status is Status.SOLVED
        assert solution.method == "radial_cyclic"
        index = solution.identification.catalog_index
        assert np.all(index >= 0)
        right += np.count_nonzero(paper.catalog.number[index] == star_map.star_number)
    assert right == N_LABELS


def test_exactly_the_far_displaced_stars_of_map_6_are_displaced(solved_maps):
    for number, (star_map, solution) in enumerate(solved_maps, start=1):
        state = solution.identification.state
        far = {"F02", "F05", "F08"} if number == 6 else set()
        displaced = {star_map.labels[i] for i in np.flatnonzero(state == StarState.DISPLACED)}
        assert displaced == far
        undisplaced = star_map.displaced_px == 0
        assert np.all(state[undisplaced] == StarState.IDENTIFIED)
