"""Match-group voting on tiny catalogues of named stars, and its counts against numpy."""

from typing import NamedTuple

import numpy as np
import pytest
from engine_bench import Field, pairs_of

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.pairs import PairTable
from star_tracker.catalogue.sky_index import SkyIndex
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import ra_dec, separation, unit_vectors
from star_tracker.identification.cells import (
    MatchGroupSettings,
    best_cells,
    empty_room,
    members,
    triangle_check,
)
from star_tracker.identification.evidence import EXACT
from star_tracker.identification.plan import levels
from star_tracker.identification.votes import (
    cast,
    choose_rows,
    clear,
    count_of,
    empty_votes,
    look_around,
    threshold_for,
)
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

CAMERA = Camera.from_fov(12, 512, 512)
#: The brightest stars of the Pleiades, (RA, Dec) in degrees.
PLEIADES = {
    "Alcyone": (56.871, 24.105), "Atlas": (57.291, 24.053), "Electra": (56.219, 24.113),
    "Maia": (56.457, 24.368), "Merope": (56.582, 23.948), "Taygeta": (56.302, 24.467),
    "Pleione": (57.297, 24.137), "Celaeno": (56.201, 24.290),
}
#: A figure as large as a field of 12 deg, with Alcyone's place at its middle.
FIGURE = {
    "Hub": (56.9, 24.1), "North": (57.1, 28.2), "East": (61.2, 24.9), "South": (56.2, 20.4),
    "West": (53.0, 23.2), "Corner": (59.9, 27.4), "Near": (57.9, 23.1), "Odd": (54.6, 26.6),
}
#: Two stars of another part of the sky, 0.9 deg apart.
ELSEWHERE = {"One": (200.0, -40.0), "Other": (200.0, -40.9)}
N_ROLLS = 64


def database_of(*groups, **options):
    stars = {name: place for group in groups for name, place in group.items()}
    ra, dec = np.radians(list(stars.values())).T
    none = np.zeros(len(stars), np.int64)
    catalog = StarCatalog(unit_vectors(ra, dec), np.full(len(stars), 4.0), none, none)
    return FeatureDatabase.build(catalog, **options)


def rotation_to(ra_deg, dec_deg, roll_deg=0.0):
    return rotation_from_boresight(*np.radians([ra_deg, dec_deg, roll_deg]))


def view(database, rotation, camera=CAMERA):
    """A frame of all stars that a camera sees, without noise: the field and its true stars."""
    index = np.flatnonzero(database.catalog.vectors @ rotation[:, 2] > 0.9)
    xy = camera.pixels(database.catalog.vectors[index] @ rotation)
    inside = camera.contains(xy)
    field = Field.at(camera, xy[inside])
    return field, index[inside][field.frame.row]


class Found(NamedTuple):
    """A cell and the matches that pass the triangle check, the main star the last of them."""

    cell: int
    score: int
    observed: np.ndarray
    catalog: np.ndarray


def vote(database, field, main, *, tolerance_px=2.0, companions=20, threshold=2):
    """Let the companions of a main star vote: the votes, and how many companions did."""
    votes = empty_votes(len(database.catalog), companions)
    n = look_around(field.frame, main, companions, votes)
    tolerance = tolerance_px / field.camera.focal_length_px
    pairs = pairs_of(database.pairs)
    end, _ = choose_rows(pairs, votes, 0, n, tolerance)
    cast(pairs, votes, 0, end, threshold)
    return votes, end


def proposed(database, field, main, *, tolerance_px=2.0, cells=48, **options):
    """The candidates of a main star, best cell first."""
    votes, end = vote(database, field, main, tolerance_px=tolerance_px, **options)
    tolerance = tolerance_px / field.camera.focal_length_px
    pairs, room, result = pairs_of(database.pairs), empty_room(cells), []
    for at in range(best_cells(votes, 0, votes.n_reached, room.cells, room.scores)):
        cell, score = int(room.cells[at]), int(room.scores[at])
        k = members(pairs, votes, end, cell, tolerance, room)
        k = triangle_check(field.frame, database.sky_index, room, k, tolerance)
        if k >= 2:
            room.observed[k], room.catalog[k] = main, cell // N_ROLLS
            kept = room.observed[: k + 1].copy(), room.catalog[: k + 1].copy()
            result.append(Found(cell, score, *kept))
    return result


def central(field):
    """The star nearest to the boresight."""
    return int(field.from_centre[0])


def counts(votes):
    """The votes of all cells, (stars, rolls)."""
    n = len(votes.low)
    every = [count_of(votes, cell) for cell in range(n * N_ROLLS)]
    return np.array(every).reshape(n, N_ROLLS)


@pytest.fixture(scope="module")
def figure():
    return database_of(FIGURE, ELSEWHERE)


# The field


def test_the_star_nearest_to_the_boresight_comes_first_from_the_centre():
    field = Field.at(CAMERA, np.array([(300.0, 256), (0, 0), (256, 250)]))
    assert field.frame.row[field.from_centre].tolist() == [2, 0, 1]


def test_a_frame_goes_from_left_to_right_and_knows_the_rows_of_the_input():
    xy = np.random.default_rng(1).random((80, 2)) * 512
    frame = Field.at(CAMERA, xy).frame
    np.testing.assert_array_equal(frame.row, np.argsort(xy[:, 0]))
    np.testing.assert_allclose(frame.vectors, CAMERA.vectors(xy)[frame.row], rtol=1e-13)
    np.testing.assert_allclose(frame.plane_px, xy[frame.row] - 256, atol=1e-9)


def test_centroids_that_are_not_finite_or_far_outside_are_left_out():
    """The margin is a twentieth of the larger side, 25.6 px."""
    inf, nan = np.inf, np.nan
    xy = np.array([
        (nan, 5.0), (500, 100), (5, inf), (-25, 9), (-26, 9), (100, 537), (100, 538), (7, -inf),
    ])
    assert Field.at(CAMERA, xy).frame.row.tolist() == [3, 5, 1]


def test_main_stars_with_the_nearest_companions_are_tried_first():
    """Two groups of four on squares of 40 px and 90 px, and one star far from all."""
    square = np.array([(0.0, 0), (1, 0), (0, 1), (1, 1)])
    xy = np.concatenate([300 + 90 * square, 60 + 40 * square, [(480.0, 20)]])
    frame = Field.at(CAMERA, xy).frame
    order = frame.row[frame.mains].tolist()
    assert set(order[:4]) == {4, 5, 6, 7}
    assert set(order[4:8]) == {0, 1, 2, 3}
    assert order[8] == 8


def test_stars_too_close_together_count_as_if_they_were_15_px_apart():
    """Squares of 1 px and of 10 px, whose diagonal is 14 px, are no better than one of 15 px."""
    square = np.array([(0.0, 0), (1, 0), (0, 1), (1, 1)])
    for side, first in ((1.0, False), (10.0, False), (15.5, True)):
        xy = np.concatenate([300 + side * square, 100 + 15 * square * (1, 1.01)])
        frame = Field.at(CAMERA, xy).frame
        # Sums of distances to three: 45 px against 15 + 15.15 + 21.32 = 51.5 px.
        large = frame.row[frame.mains][4:] < 4
        assert large.all() == first


def test_bright_main_stars_are_tried_before_faint_ones_of_the_same_figure():
    square = np.array([(0.0, 0), (50, 0), (0, 50), (50, 50)]) + 200
    intensity = np.array([1.0, 40.0, 300.0, 9.0])
    frame = Field.at(CAMERA, square, intensity).frame
    assert frame.row[frame.mains].tolist() == [2, 1, 3, 0]
    np.testing.assert_allclose(frame.magnitude, -2.5 * np.log10(intensity[frame.row]))


def test_intensities_that_mean_nothing_are_unknown():
    xy = np.column_stack([np.arange(6.0) * 50, np.full(6, 80.0)])
    intensity = np.array([100.0, 0.0, -3.0, np.nan, np.inf, 1.0])
    magnitude = Field.at(CAMERA, xy, intensity).frame.magnitude
    np.testing.assert_allclose(magnitude, [-5, np.nan, np.nan, np.nan, np.nan, 0])
    assert not Field.at(CAMERA, xy).frame.has_brightness


@pytest.mark.parametrize("n", [0, 1, 2, 3, 40])
def test_each_star_is_a_main_star_once(n):
    frame = Field.at(CAMERA, np.random.default_rng(n).random((n, 2)) * 512).frame
    assert sorted(frame.mains.tolist()) == list(range(n))


def test_neighbours_are_the_nearest_other_stars_in_order():
    """At the image's middle: one star 10 px to the right, one 20 px up, one 30 px to the left."""
    field = Field.at(
        CAMERA, np.array([(226.0, 256), (256, 256), (256, 236), (266, 256)])
    )
    index, apart, angle = field.neighbours(1, 20)
    assert index.tolist() == [3, 2, 0]
    np.testing.assert_allclose(apart, np.arctan(np.array([10, 20, 30]) / CAMERA.fx_px))
    # From up towards the left, as position angles on the sky grow from north towards east.
    np.testing.assert_allclose(np.degrees(angle), [270, 0, 90], atol=1e-9)
    assert field.neighbours(1, 2)[0].tolist() == [3, 2]


def test_a_field_keeps_undistorted_pixels_with_y_down():
    lens = Distortion("plumb_bob", (-0.2, 0.0, 0.0, 0.0, 0.0))
    camera = Camera(512, 512, 400.0, 400.0, 250, 260, "mirrored", lens)
    field = Field.at(camera, np.array([(350.0, 400.0)]))
    np.testing.assert_allclose(field.vectors, camera.vectors([(350.0, 400.0)]))
    plane = field.vectors[:, :2] / field.vectors[:, 2:]
    np.testing.assert_allclose(field.frame.plane_px, 400 * plane)
    assert field.frame.plane_px[0, 1] < 0


# Companions


@pytest.mark.parametrize("most", [1, 3, 8, 40])
def test_companions_are_the_nearest_stars_in_order(most):
    field = Field.at(CAMERA, np.random.default_rng(most).random((25, 2)) * 512)
    votes = empty_votes(1, most)
    for main in range(25):
        n = look_around(field.frame, main, most, votes)
        index, apart, angle = field.neighbours(main, most)
        assert n == min(most, 24)
        np.testing.assert_array_equal(votes.companion[:n], index)
        np.testing.assert_allclose(votes.separation[:n], apart, rtol=1e-9)
        np.testing.assert_array_equal(votes.azimuth[:n], np.floor(angle * 256 / (2 * np.pi)))


@pytest.mark.parametrize("n", [1, 2])
def test_few_stars_have_few_companions(n):
    field = Field.at(CAMERA, np.array([(100.0, 100), (130, 90)])[:n])
    votes = empty_votes(1, 20)
    assert look_around(field.frame, 0, 20, votes) == n - 1


# Rows to vote


def test_votes_are_the_pairs_whose_separation_fits(figure):
    """A vote is a directed guide-star pair whose separation fits that of an observed pair."""
    field, _ = view(figure, rotation_to(56.9, 24.1))
    catalog = figure.catalog.vectors
    guide = separation(catalog[:, None], catalog[None])
    guide = guide[(guide > 0) & (guide <= np.radians(12))]
    votes, pairs = empty_votes(len(catalog), 20), pairs_of(figure.pairs)
    for tolerance_px in (2.0, 6.0, 30.0):
        tolerance = tolerance_px / CAMERA.focal_length_px
        for main in range(len(field)):
            n = look_around(field.frame, main, 20, votes)
            end, total = choose_rows(pairs, votes, 0, n, tolerance)
            assert end == n == len(FIGURE) - 1
            observed = np.delete(separation(field.vectors, field.vectors[main]), main)
            fits = np.abs(guide[None] - observed[:, None]) <= tolerance
            assert total == np.count_nonzero(fits)


def synthetic_table(separation_rad, main_azimuth, max_separation_rad):
    """A table for voting only: its rows by main star are empty."""
    bin_rad = np.radians(0.01)
    edges = np.arange(int(max_separation_rad / bin_rad) + 3) * bin_rad
    none = np.zeros(2, np.int64)
    return pairs_of(PairTable(
        separation_rad, main_azimuth, np.searchsorted(separation_rad, edges), none,
        np.zeros(0, np.float32), np.zeros(0, np.uint8), np.zeros(0, np.int32), max_separation_rad,
    ))


@pytest.mark.parametrize(
    ("rows", "begin", "expected"),
    [
        # No more than 100,000 votes, but three companions in any case.
        (60_000, 0, (3, 180_000)), (40_000, 0, (3, 120_000)), (30_000, 0, (3, 90_000)),
        (25_000, 0, (4, 100_000)), (9999, 0, (10, 99_990)), (100, 0, (12, 1200)),
        (60_000, 4, (7, 180_000)), (60_000, 10, (12, 120_000)), (0, 0, (12, 0)),
    ],
)
def test_a_deep_catalogue_needs_few_companions(rows, begin, expected):
    pairs = synthetic_table(np.full(rows, 0.1, np.float32), np.zeros(rows, np.int32), 0.2)
    votes = empty_votes(1, 12)
    votes.separation[:] = 0.1
    assert choose_rows(pairs, votes, begin, 12, 1e-3) == expected


# Counting


def rows_at_random(rng, n_stars, n_companions, most):
    """A table and votes in which each companion selects up to `most` rows of any azimuth."""
    n_rows = 2000
    main = rng.integers(0, n_stars, n_rows)
    coded = (main * 256 + rng.integers(0, 256, n_rows)).astype(np.int32)
    pairs = synthetic_table(np.linspace(0, 0.1, n_rows, dtype=np.float32), coded, 0.1)
    votes = empty_votes(n_stars, n_companions)
    votes.azimuth[:] = rng.integers(0, 256, n_companions)
    votes.first[:] = rng.integers(0, n_rows - most, n_companions)
    votes.last[:] = votes.first + rng.integers(0, most + 1, n_companions)
    return pairs, votes


def naive_counts(pairs, votes, begin, end):
    """Each pair votes for its main star at the difference of the azimuths, and at the next."""
    result = np.zeros((len(votes.low), N_ROLLS), int)
    for i in range(begin, end):
        coded = pairs.main_azimuth[votes.first[i] : votes.last[i]]
        roll = (coded % 256 - votes.azimuth[i]) % 256 // 4
        np.add.at(result, (coded // 256, roll), 1)
        np.add.at(result, (coded // 256, (roll + 1) % N_ROLLS), 1)
    return result


@pytest.mark.parametrize("seed", range(12))
def test_counts_agree_with_numpy_for_random_rows(seed):
    """From a few votes a cell to nearly 64; in two batches, as in a short search."""
    rng = np.random.default_rng(seed)
    n_stars, n_companions = int(rng.integers(1, 40)), int(rng.integers(2, 41))
    most = min(1500, 16 + 350 * n_stars // n_companions)
    pairs, votes = rows_at_random(rng, n_stars, n_companions, most)
    half = n_companions // 2
    cast(pairs, votes, 0, half, 4)
    np.testing.assert_array_equal(counts(votes), naive_counts(pairs, votes, 0, half))
    cast(pairs, votes, half, n_companions, 4)
    expected = naive_counts(pairs, votes, 0, n_companions)
    assert 3 < expected.max() < 64
    np.testing.assert_array_equal(counts(votes), expected)


def test_a_count_goes_up_to_63():
    pairs, votes = rows_at_random(np.random.default_rng(20), 1, 63, 1)
    pairs.main_azimuth[:] = 0
    votes.azimuth[:], votes.last[:] = 4, votes.first + 1  # the roll before the last but one
    for n in range(63):
        cast(pairs, votes, n, n + 1, 2)
        assert count_of(votes, 63) == count_of(votes, 0) == n + 1
    assert counts(votes).sum() == 126


@pytest.mark.parametrize(
    "threshold", [*range(2, 21), 25]
)
def test_cells_that_reach_the_threshold_are_remembered_once(threshold):
    rng = np.random.default_rng(threshold)
    # 64 cells a star, two of them for each vote: the mean is just above the threshold.
    n_companions = 40
    pairs, votes = rows_at_random(rng, 3, n_companions, 6 * threshold)
    cast(pairs, votes, 0, n_companions, threshold)
    expected = naive_counts(pairs, votes, 0, n_companions)
    assert expected.max() < 64
    wanted = np.flatnonzero(expected >= threshold)
    assert 0 < len(wanted) < expected.size
    assert sorted(votes.reached[: votes.n_reached].tolist()) == wanted.tolist()


def test_cells_of_a_second_batch_follow_those_of_the_first():
    pairs, votes = rows_at_random(np.random.default_rng(30), 4, 20, 60)
    cast(pairs, votes, 0, 10, 4)
    first = votes.n_reached
    before = votes.reached[:first].tolist()
    cast(pairs, votes, 10, 20, 4)
    both = votes.n_reached
    assert votes.reached[:first].tolist() == before
    assert 0 < first < both
    expected = np.flatnonzero(naive_counts(pairs, votes, 0, 20) >= 4)
    assert sorted(votes.reached[:both].tolist()) == expected.tolist()


def test_more_cells_than_there_is_room_for_are_forgotten():
    pairs, votes = rows_at_random(np.random.default_rng(31), 40, 40, 1500)
    cast(pairs, votes, 0, 40, 2)
    expected = naive_counts(pairs, votes, 0, 40)
    assert np.count_nonzero(expected >= 2) > 1024
    assert votes.n_reached == len(votes.reached) == 1024
    assert all(expected.flat[cell] >= 2 for cell in votes.reached)
    np.testing.assert_array_equal(counts(votes), expected)


@pytest.mark.parametrize("most", [20, 1500])
def test_votes_are_cleared(most):
    """With few and with more stars that have high digits than are remembered."""
    pairs, votes = rows_at_random(np.random.default_rng(32), 30, 40, most)
    cast(pairs, votes, 0, 40, 3)
    assert votes.low.any()
    assert votes.high.any() or most == 20
    clear(votes)
    assert not votes.low.any()
    assert not votes.high.any()
    assert votes.n_carried == votes.n_reached == 0


def test_votes_after_a_clearing_are_those_of_the_next_star_only(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    votes, pairs = empty_votes(len(figure.catalog), 20), pairs_of(figure.pairs)
    for main in range(len(field)):
        n = look_around(field.frame, main, 20, votes)
        end, _ = choose_rows(pairs, votes, 0, n, 0.001)
        cast(pairs, votes, 0, end, 3)
        np.testing.assert_array_equal(counts(votes), naive_counts(pairs, votes, 0, end))
        clear(votes)


# Thresholds


@pytest.mark.parametrize(
    ("total", "n_stars", "threshold"),
    [
        # No votes: two are wanted at least.
        (0, 100, 2), (5, 4908, 2),
        # 314,112 cells, mean 0.0955: 314112 m^2 / 2 = 1433, m^3 / 6 = 45.6.
        (15_000, 4908, 3),
        # Mean 0.318: m^4 / 24 = 134, one vote less is 1688.
        (50_000, 4908, 4),
        # Mean 1 in 64 cells: each star's 64 cells are fewer than 150.
        (32, 1, 2),
    ],
)
def test_few_cells_reach_the_threshold_by_chance(total, n_stars, threshold):
    assert threshold_for(total, n_stars) == threshold


@pytest.mark.parametrize("n_stars", [50, 4908, 40_000])
def test_the_threshold_grows_with_the_votes(n_stars):
    found = [threshold_for(total, n_stars) for total in range(0, 200_000, 5000)]
    assert found == sorted(found)
    assert found[0] == 2


# Best cells


def votes_with(n_stars, **cells):
    """Votes with counts for cells, given as s2r63=5 for star 2 and roll 63, all reached."""
    votes = empty_votes(n_stars, 1)
    for at, (name, count) in enumerate(cells.items()):
        star, roll = map(int, name[1:].split("r"))
        for digit in range(6):
            words, word = (votes.low, digit) if digit < 2 else (votes.high, digit - 2)
            words[star, word] |= np.uint64((count >> digit & 1) << roll)
        votes.reached[at] = star * N_ROLLS + roll
    return votes, len(cells)


def best(most=9, n_stars=4, **cells):
    votes, n = votes_with(n_stars, **cells)
    found, scores = np.empty(most, np.int64), np.empty(most, np.int64)
    k = best_cells(votes, 0, n, found, scores)
    return {
        f"s{cell // N_ROLLS}r{cell % N_ROLLS}": score
        for cell, score in zip(found[:k].tolist(), scores[:k].tolist(), strict=True)
    }


def test_the_highest_cells_come_first():
    cells = {"s0r3": 4, "s1r9": 7, "s2r60": 2, "s3r0": 6, "s3r20": 5}
    found = best(**cells)
    assert list(found) == ["s1r9", "s3r0", "s3r20", "s0r3", "s2r60"]
    assert found == cells


def test_no_more_cells_than_asked_are_taken():
    cells = {"s0r3": 4, "s1r9": 7, "s2r60": 2, "s3r0": 6, "s3r20": 5}
    for most in (1, 2, 3):
        assert list(best(most, **cells)) == ["s1r9", "s3r0", "s3r20"][:most]


@pytest.mark.parametrize(
    ("cells", "taken"),
    [
        ({"s1r5": 4, "s1r6": 3}, ["s1r5"]),
        ({"s1r6": 3, "s1r5": 4}, ["s1r5"]),
        ({"s1r5": 4, "s1r6": 4}, ["s1r5"]),
        # Rolls 63 and 0 are neighbours.
        ({"s1r63": 3, "s1r0": 4}, ["s1r0"]),
        ({"s1r0": 3, "s1r63": 4}, ["s1r63"]),
        # Not adjacent: another star, a roll farther.
        ({"s1r63": 4, "s2r0": 3}, ["s1r63", "s2r0"]),
        ({"s1r5": 4, "s1r7": 3}, ["s1r5", "s1r7"]),
        ({"s1r63": 4, "s1r1": 3}, ["s1r63", "s1r1"]),
        # Two that are both beaten by the one between them.
        ({"s1r5": 3, "s1r7": 4, "s1r6": 5}, ["s1r6"]),
        ({"s1r6": 5, "s1r5": 3, "s1r7": 4}, ["s1r6"]),
    ],
)
def test_of_adjacent_cells_only_the_higher_is_taken(cells, taken):
    assert list(best(**cells)) == taken


def test_a_full_list_makes_room_where_an_adjacent_cell_goes():
    assert list(best(2, s0r3=5, s1r9=4, s1r10=6)) == ["s1r10", "s0r3"]


def test_only_the_cells_of_a_range_are_looked_at():
    votes, _ = votes_with(4, s0r3=4, s1r9=7, s2r60=2)
    found, scores = np.empty(9, np.int64), np.empty(9, np.int64)
    assert best_cells(votes, 2, 3, found, scores) == 1
    assert found[0] == 2 * N_ROLLS + 60
    assert best_cells(votes, 1, 1, found, scores) == 0


# Voting for stars


def test_the_highest_cell_names_every_star_rightly(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1))
    assert len(truth) == len(FIGURE)
    first = proposed(figure, field, central(field))[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])
    assert set(first.observed.tolist()) == set(range(len(FIGURE)))
    assert first.score == len(FIGURE) - 1


@pytest.mark.parametrize("roll_bin", [0, 6, 31, 62, 63])
def test_votes_fall_into_the_cell_of_the_cameras_roll(roll_bin):
    """At the boresight an angle on the sky is the roll plus that in the image.

    The roll is at the middle of a bin of 360 / 64 deg: 2 units of 360 / 256 deg from its ends,
    so that angles rounded down to units on both sides cannot leave it.
    """
    database = database_of(FIGURE)
    hub = list(FIGURE).index("Hub")
    field, truth = view(database, rotation_to(*FIGURE["Hub"], (roll_bin + 0.5) * 360 / N_ROLLS))
    votes, _ = vote(database, field, truth.tolist().index(hub))
    found = counts(votes)[hub]
    assert found[roll_bin] == found[(roll_bin + 1) % N_ROLLS] == len(FIGURE) - 1


def test_a_known_pair_votes_for_two_known_cells():
    """West to east along the equator, seen with roll 90: east, 90 deg on the sky, is up, 0.

    The difference is 64 units of 256, bin 16; seen from the eastern star 270 - 180 = 90, too.
    Stars are put off the exact angles, as these lie on the edge of a unit.
    """
    database = database_of({"West": (10.0, 0.0), "East": (12.0, -0.02), "Far": (200.0, 5.0)})
    field, truth = view(database, rotation_to(11.0, 0.0, 91.5))
    assert sorted(truth.tolist()) == [0, 1]
    for main, star in enumerate(truth.tolist()):
        votes, end = vote(database, field, main)
        assert end == 1
        expected = np.zeros((3, N_ROLLS), int)
        # The pair fits in both directions: for the other star half a turn away.
        expected[star, [16, 17]] = 1
        expected[1 - star, [48, 49]] = 1
        np.testing.assert_array_equal(counts(votes), expected)


def test_every_main_star_finds_itself(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1))
    for main, star in enumerate(truth):
        (found,) = proposed(figure, field, main, cells=1)
        assert found.cell // N_ROLLS == star
        np.testing.assert_array_equal(found.catalog, truth[found.observed])


def test_no_roll_falls_between_two_bins_or_off_their_end(figure):
    """720 rolls, so eleven in each bin of 5.6 deg; bins 63 and 0 are neighbours."""
    for roll_deg in np.arange(0.0, 360.0, 0.5):
        field, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
        first = proposed(figure, field, central(field))[0]
        np.testing.assert_array_equal(first.catalog, truth[first.observed])
        # Each companion has a vote in the cell: none is lost at a bin's edge.
        assert len(set(first.observed.tolist())) == len(truth), f"roll {roll_deg}"


@pytest.mark.parametrize("roll_deg", [359.99, 0.0, 0.01, 1.4, 357.2])
def test_rolls_about_the_end_of_the_bins(figure, roll_deg):
    field, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
    first = proposed(figure, field, central(field))[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


@pytest.mark.parametrize("place", [(0.0, 0.0), (120.0, 89.0), (300.0, -89.5)])
def test_anywhere_on_the_sky_and_at_the_poles_too(place):
    """Near a pole position angles change quickly from star to star: the votes still agree."""
    rng = np.random.default_rng(1)
    rotation = rotation_to(*place, 77.0)
    ra, dec = np.degrees(ra_dec(CAMERA.vectors(rng.random((10, 2)) * 512) @ rotation.T))
    stars = {f"S{i}": pair for i, pair in enumerate(zip(ra, dec, strict=True))}
    database = database_of(stars, ELSEWHERE)
    field, truth = view(database, rotation)
    first = proposed(database, field, central(field))[0]
    assert len(first.observed) >= 3
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_the_pleiades_are_told_from_a_large_figure_by_their_size():
    database = database_of(PLEIADES, {n: (ra + 90, dec) for n, (ra, dec) in FIGURE.items()})
    field, truth = view(database, rotation_to(56.8, 24.1, 200.0))
    assert len(truth) == len(PLEIADES)
    first = proposed(database, field, central(field))[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_a_mirror_image_of_the_sky_is_not_matched_whole(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    mirrored = Field.at(CAMERA, field.frame.plane_px * (1, -1) + 256)
    found = [one for main in range(len(field)) for one in proposed(figure, mirrored, main)]
    assert all(len(set(one.observed.tolist())) < 5 for one in found)


@pytest.mark.parametrize("n", [1, 2])
def test_a_field_without_triangles_has_no_candidate(figure, n):
    field = Field.at(CAMERA, np.array([(100.0, 100), (130, 90)])[:n])
    assert proposed(figure, field, 0) == []


def test_stars_that_resemble_no_pair_have_no_candidate(figure):
    """Three stars less than 0.02 deg apart."""
    field = Field.at(CAMERA, np.array([(256.0, 256), (256.5, 256), (256, 256.4)]))
    for main in range(3):
        assert proposed(figure, field, main) == []


def test_only_the_nearest_companions_vote(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    for main in range(len(field)):
        nearest = np.argsort(separation(field.vectors, field.vectors[main]))[:4]
        for found in proposed(figure, field, main, companions=3):
            assert set(found.observed.tolist()) <= set(nearest.tolist())


# Members


def test_a_cell_has_as_many_members_as_votes(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1, 18.0))
    tolerance_px, pairs, room = 25.0, pairs_of(figure.pairs), empty_room(1)
    for main in range(len(field)):
        votes, end = vote(figure, field, main, tolerance_px=tolerance_px)
        found = counts(votes)
        assert found.max() >= len(FIGURE) - 1
        for cell in range(found.size):
            k = members(pairs, votes, end, cell, tolerance_px / CAMERA.focal_length_px, room)
            assert k == found.flat[cell]
            star = figure.catalog.vectors[cell // N_ROLLS]
            guide = separation(figure.catalog.vectors[room.catalog[:k]], star)
            image = separation(field.vectors[room.observed[:k]], field.vectors[main])
            assert np.all(np.abs(guide - image) < tolerance_px / CAMERA.focal_length_px + 1e-7)


def test_no_more_than_64_members_are_looked_at():
    """80 guide stars stand on 10 deg of a circle about the main star: all fit one companion."""
    angle = np.linspace(0, np.radians(2.5), 80, endpoint=False)
    ring = {
        f"R{i}": (40 + 2 * np.cos(a), 2 * np.sin(a)) for i, a in enumerate(angle.tolist())
    }
    database = database_of({"Hub": (40.0, 0.0)}, ring)
    field = Field.at(CAMERA, np.array([(256.0, 256), (256, 171)]))
    tolerance_px = 20.0
    votes, end = vote(database, field, 0, tolerance_px=tolerance_px)
    room = empty_room(1)
    room.observed[:], room.catalog[:] = -1, -1
    cell = int(np.argmax(counts(votes)[0]))  # of the main star
    k = members(
        pairs_of(database.pairs), votes, end, cell, tolerance_px / CAMERA.focal_length_px, room
    )
    assert k == 64
    assert (room.observed[64], room.catalog[64]) == (-1, -1)


# The triangle check


def checked(field, vectors, observed, catalog, *, tolerance_px=1.0):
    """The members kept by the check."""
    room, n = empty_room(1), len(observed)
    room.observed[:n], room.catalog[:n] = observed, catalog
    tolerance = tolerance_px / field.camera.focal_length_px
    k = triangle_check(field.frame, SkyIndex.build(vectors), room, n, tolerance)
    return list(zip(room.observed[:k].tolist(), room.catalog[:k].tolist(), strict=True))


@pytest.fixture(scope="module")
def triangle():
    """Five stars of an image, from left to right, and five guide stars in the same places."""
    xy = np.array([(60.0, 100), (150, 300), (220, 90), (330, 410), (450, 260)])
    field = Field.at(CAMERA, xy)
    return field, CAMERA.vectors(xy) @ rotation_to(30.0, -20.0, 50.0).T


def test_members_that_agree_with_each_other_are_all_kept(triangle):
    every = [(i, i) for i in range(5)]
    assert checked(*triangle, range(5), range(5)) == every


def test_two_members_that_agree_are_enough(triangle):
    assert checked(*triangle, [1, 3], [1, 3]) == [(1, 1), (3, 3)]


def test_members_that_do_not_agree_with_the_best_one_are_left_out(triangle):
    """Stars 0 to 2 agree; 3 and 4 are given each other's names."""
    assert checked(*triangle, [0, 1, 2, 3, 4], [0, 1, 2, 4, 3]) == [(0, 0), (1, 1), (2, 2)]
    assert checked(*triangle, [4, 0, 3, 1, 2], [3, 0, 4, 1, 2]) == [(0, 0), (1, 1), (2, 2)]


def test_members_without_agreement_are_none(triangle):
    assert checked(*triangle, [0, 1, 2], [1, 3, 4]) == []


@pytest.mark.parametrize("observed", [[], [2]])
def test_fewer_than_two_members_make_no_triangle(triangle, observed):
    assert checked(*triangle, np.array(observed, int), np.array(observed, int)) == []


def test_a_star_that_is_a_member_twice_over_does_not_agree_with_itself(triangle):
    """One star of the image for two guide stars, or the reverse: 0 on one side only."""
    assert checked(*triangle, [0, 0], [0, 1]) == []
    assert checked(*triangle, [0, 1], [1, 1]) == []
    # With others the right name is the one that most agree with.
    assert checked(*triangle, [0, 0, 2, 3], [0, 1, 2, 3]) == [(0, 0), (2, 2), (3, 3)]


@pytest.mark.parametrize(("tolerance_px", "kept"), [(2.8, 0), (3.2, 2)])
def test_the_tolerance_is_of_the_separation(triangle, tolerance_px, kept):
    """A star 3 px farther from another, along the line between them, at the image's middle."""
    field = Field.at(CAMERA, np.array([(226.0, 256), (289, 256)]))
    vectors = CAMERA.vectors([(226.0, 256), (286, 256)])
    assert len(checked(field, vectors, [0, 1], [0, 1], tolerance_px=tolerance_px)) == kept


@pytest.mark.parametrize("turn_deg", [-1.2, 1.2])
def test_the_triangle_check_leaves_out_a_companion_that_only_fits_the_main_star(turn_deg):
    """A false star at a companion's distance, 1.2 deg about the main star: the same cell or next.

    At 4.3 deg from the main star that is 0.09 deg or 3.8 px from the companion's place.
    """
    database = database_of(FIGURE)
    field, truth = view(database, rotation_to(56.9, 24.1, 11.0))
    main, corner = (truth.tolist().index(list(FIGURE).index(name)) for name in ("Hub", "Corner"))
    vectors = field.vectors.copy()
    axis, angle, v = vectors[main], np.radians(turn_deg), field.vectors[corner]
    vectors[corner] = (  # Rodrigues' formula
        v * np.cos(angle) + np.cross(axis, v) * np.sin(angle)
        + axis * (axis @ v) * (1 - np.cos(angle))
    )
    change = CAMERA.focal_length_px * np.abs(
        separation(vectors, vectors[corner]) - separation(field.vectors, v)
    )
    assert change[main] == pytest.approx(0, abs=1e-9)
    assert np.all(np.delete(change, [main, corner]) > 0.5)
    moved = Field.at(CAMERA, CAMERA.pixels(vectors))
    row = moved.frame.row
    (found,) = proposed(
        database, moved, row.tolist().index(main), tolerance_px=0.5, cells=1
    )
    assert set(row[found.observed].tolist()) == set(range(len(truth))) - {corner}
    np.testing.assert_array_equal(found.catalog, truth[row[found.observed]])


# The levels of a search


def test_the_full_search_tries_the_tolerances_in_turn():
    found = levels(MatchGroupSettings((1.0, 3.0), companions=9, quick=False), EXACT)
    assert found["tolerance_px"].tolist() == [1, 3]
    assert found["companions"].tolist() == found["batch"].tolist() == [9, 9]
    assert not found["by_shape"].any()


@pytest.mark.parametrize(("tolerances", "second"), [((2.0,), 2), ((2.0, 6.0, 12.0), 6)])
def test_a_short_search_comes_before_the_full_one(tolerances, second):
    found = levels(MatchGroupSettings(tolerances), EXACT)
    assert len(found) == 3 + len(tolerances)
    assert found["tolerance_px"].tolist() == [2, 2, second, *tolerances]
    assert np.all(found["mains"][:3] < 10)
    # The votes of all batches have room.
    assert np.all(found["batch"] <= found["companions"])
