"""Votes for guide stars and rolls: who votes, and the counts against numpy's."""

import numpy as np
import pytest
from engines import (
    CAMERA,
    ELSEWHERE,
    FIGURE,
    LATE,
    PATIENT,
    centroids_of,
    database_of,
    frame_of,
    pairs_of,
    rotation_to,
    view,
)

from star_tracker.catalogue.pairs import PairTable
from star_tracker.geometry.spherical import separation
from star_tracker.identification.fallback import StarField
from star_tracker.identification.votes import (
    ANY_ORDER,
    ROLL_BINS,
    Reading,
    cast,
    choose_rows,
    clear,
    count_of,
    count_waiting,
    empty_votes,
    look_around,
    threshold_for,
    vote_rows,
)


def counts(votes):
    """The votes of all cells, (stars, rolls)."""
    n = len(votes.low)
    every = [count_of(votes, cell) for cell in range(n * ROLL_BINS)]
    return np.array(every).reshape(n, ROLL_BINS)


@pytest.fixture(scope="module")
def figure():
    return database_of(FIGURE, ELSEWHERE)


# Companions


@pytest.mark.parametrize("most", [1, 3, 8, 40])
def test_companions_are_the_nearest_stars_in_order(most):
    frame = frame_of(np.random.default_rng(most).random((25, 2)) * 512)
    field = StarField(centroids_of(frame).vectors, CAMERA.focal_length_px)
    votes = empty_votes(1, most)
    for main in range(25):
        n = look_around(frame, main, most, votes)
        index, apart, angle = field.neighbours(main, most)
        assert n == min(most, 24)
        np.testing.assert_array_equal(votes.companion[:n], index)
        np.testing.assert_allclose(votes.separation[:n], apart, rtol=1e-9)
        np.testing.assert_array_equal(votes.azimuth[:n], np.floor(angle * 256 / (2 * np.pi)))


@pytest.mark.parametrize("n", [1, 2])
def test_few_stars_have_few_companions(n):
    frame = frame_of([(100.0, 100), (130, 90)][:n])
    assert look_around(frame, 0, 20, empty_votes(1, 20)) == n - 1


# Rows to vote


def test_votes_are_the_pairs_whose_separation_fits(figure):
    """A vote is a directed guide-star pair whose separation fits that of an observed pair."""
    frame, _ = view(figure, rotation_to(56.9, 24.1))
    vectors, catalog = centroids_of(frame).vectors, figure.catalog.vectors
    guide = separation(catalog[:, None], catalog[None])
    guide = guide[(guide > 0) & (guide <= np.radians(12))]
    pairs, votes = pairs_of(figure.pairs), empty_votes(len(catalog), 20)
    for tolerance_px in (2.0, 6.0, 30.0):
        tolerance = tolerance_px / CAMERA.focal_length_px
        for main in range(len(vectors)):
            n = look_around(frame, main, 20, votes)
            end, total = choose_rows(pairs, votes, n, tolerance)
            assert end == n == len(FIGURE) - 1
            observed = np.delete(separation(vectors, vectors[main]), main)
            fits = np.abs(guide[None] - observed[:, None]) <= tolerance
            assert total == np.count_nonzero(fits)


def synthetic_table(separation_rad, main_azimuth, max_separation_rad):
    """A table for voting only: its rows by main star are empty."""
    bin_rad = np.radians(0.01)
    edges = np.arange(int(max_separation_rad / bin_rad) + 3) * bin_rad
    none = np.zeros(2, np.int64)
    return PairTable(
        separation_rad, main_azimuth, np.searchsorted(separation_rad, edges), none,
        np.zeros(0, np.float32), np.zeros(0, np.uint8), np.zeros(0, np.int32), max_separation_rad,
    )


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        # No more than 100,000 votes, but three companions in any case.
        (60_000, (3, 180_000)), (40_000, (3, 120_000)), (30_000, (3, 90_000)),
        (25_000, (4, 100_000)), (9999, (10, 99_990)), (100, (12, 1200)), (0, (12, 0)),
    ],
)
def test_a_deep_catalogue_needs_few_companions(rows, expected):
    table = synthetic_table(np.full(rows, 0.1, np.float32), np.zeros(rows, np.int32), 0.2)
    votes = empty_votes(1, 12)
    votes.separation[:] = 0.1
    assert choose_rows(pairs_of(table), votes, 12, 1e-3) == expected


# Counting


def rows_at_random(rng, n_stars, n_companions, most):
    """A table and votes in which each companion selects up to `most` rows of any azimuth."""
    n_rows = 2000
    main = rng.integers(0, n_stars, n_rows)
    coded = (main * 256 + rng.integers(0, 256, n_rows)).astype(np.int32)
    table = synthetic_table(np.linspace(0, 0.1, n_rows, dtype=np.float32), coded, 0.1)
    votes = empty_votes(n_stars, n_companions)
    votes.azimuth[:] = rng.integers(0, 256, n_companions)
    votes.first[:] = rng.integers(0, n_rows - most, n_companions)
    votes.last[:] = votes.first + rng.integers(0, most + 1, n_companions)
    return table, votes


def let_vote(table, votes, begin, end, threshold):
    """Let companions vote; return the cells that have reached the threshold so far."""
    for i in range(begin, end):
        rows = int(votes.first[i]), int(votes.last[i])
        reading = Reading(int(votes.azimuth[i]), 8, ANY_ORDER)
        vote_rows(table.main_azimuth, votes, rows, reading, threshold)
    count_waiting(votes, threshold)
    return votes.reached[: votes.n_reached].tolist()


def naive_counts(table, votes, begin, end):
    """Each pair votes for its main star at the difference of the azimuths, and at the next."""
    result = np.zeros((len(votes.low), ROLL_BINS), int)
    for i in range(begin, end):
        coded = table.main_azimuth[votes.first[i] : votes.last[i]]
        roll = (coded % 256 - votes.azimuth[i]) % 256 // 4
        np.add.at(result, (coded // 256, roll), 1)
        np.add.at(result, (coded // 256, (roll + 1) % ROLL_BINS), 1)
    return result


@pytest.mark.parametrize("seed", range(12))
def test_counts_agree_with_numpy_for_random_rows(seed):
    """From a few votes a cell to nearly 64; in two batches, as in a search by shape."""
    rng = np.random.default_rng(seed)
    n_stars, n_companions = int(rng.integers(1, 40)), int(rng.integers(2, 41))
    most = min(1500, 16 + 350 * n_stars // n_companions)
    table, votes = rows_at_random(rng, n_stars, n_companions, most)
    half = n_companions // 2
    let_vote(table, votes, 0, half, 4)
    np.testing.assert_array_equal(counts(votes), naive_counts(table, votes, 0, half))
    let_vote(table, votes, half, n_companions, 4)
    expected = naive_counts(table, votes, 0, n_companions)
    assert 3 < expected.max() < 64
    np.testing.assert_array_equal(counts(votes), expected)


@pytest.mark.parametrize("orders", [0b1, 0b10100110, 0b10000000, ANY_ORDER, 0])
def test_only_rows_of_the_orders_that_are_asked_for_vote(orders):
    rng = np.random.default_rng(21)
    main, order = rng.integers(0, 30, 3000), rng.integers(0, 8, 3000)
    rows = ((main * 8 + order) * 256 + rng.integers(0, 256, 3000)).astype(np.int32)
    votes = empty_votes(30, 1)
    vote_rows(rows, votes, (5, 2900), Reading(40, 11, orders), 4)
    count_waiting(votes, 4)
    voting = np.arange(5, 2900)[[orders >> one & 1 == 1 for one in order[5:2900]]]
    expected = np.zeros((30, ROLL_BINS), int)
    roll = (rows[voting] % 256 - 40) % 256 // 4
    np.add.at(expected, (main[voting], roll), 1)
    np.add.at(expected, (main[voting], (roll + 1) % ROLL_BINS), 1)
    np.testing.assert_array_equal(counts(votes), expected)


def test_a_count_goes_up_to_63():
    table, votes = rows_at_random(np.random.default_rng(20), 1, 63, 1)
    table.main_azimuth[:] = 0
    votes.azimuth[:], votes.last[:] = 4, votes.first + 1  # the roll before the last but one
    for n in range(63):
        let_vote(table, votes, n, n + 1, 2)
        assert count_of(votes, 63) == count_of(votes, 0) == n + 1
    assert counts(votes).sum() == 126


@pytest.mark.parametrize("threshold", [*range(2, 21), 25])
def test_cells_that_reach_the_threshold_are_remembered_once(threshold):
    rng = np.random.default_rng(threshold)
    # 64 cells a star, two of them for each vote: the mean is just above the threshold.
    n_companions = 40
    table, votes = rows_at_random(rng, 3, n_companions, 6 * threshold)
    reached = let_vote(table, votes, 0, n_companions, threshold)
    expected = naive_counts(table, votes, 0, n_companions)
    assert expected.max() < 64
    wanted = np.flatnonzero(expected >= threshold)
    assert 0 < len(wanted) < expected.size
    assert sorted(reached) == wanted.tolist()


def test_cells_of_a_second_batch_follow_those_of_the_first():
    table, votes = rows_at_random(np.random.default_rng(30), 4, 20, 60)
    before = let_vote(table, votes, 0, 10, 4)
    both = let_vote(table, votes, 10, 20, 4)
    assert both[: len(before)] == before
    assert 0 < len(before) < len(both)
    expected = np.flatnonzero(naive_counts(table, votes, 0, 20) >= 4)
    assert sorted(both) == expected.tolist()


def test_more_cells_than_there_is_room_for_are_forgotten():
    table, votes = rows_at_random(np.random.default_rng(31), 40, 40, 1500)
    reached = let_vote(table, votes, 0, 40, 2)
    expected = naive_counts(table, votes, 0, 40)
    assert np.count_nonzero(expected >= 2) > 1024
    assert len(reached) == len(votes.reached) == 1024
    assert all(expected.flat[cell] >= 2 for cell in reached)
    np.testing.assert_array_equal(counts(votes), expected)


@pytest.mark.parametrize("most", [20, 1500])
def test_votes_are_cleared(most):
    """With few and with more stars that have high digits than are remembered."""
    table, votes = rows_at_random(np.random.default_rng(32), 30, 40, most)
    assert let_vote(table, votes, 0, 40, 3)
    assert votes.low.any()
    assert votes.high.any() or most == 20
    clear(votes)
    assert not votes.low.any()
    assert not votes.high.any()
    assert (votes.n_touched, votes.n_carried, votes.n_reached) == (0, 0, 0)


@pytest.mark.parametrize("most", [3, 100])
def test_votes_of_a_whole_sky_are_cleared(most):
    """Of fewer stars than are remembered, and of more."""
    table, votes = rows_at_random(np.random.default_rng(33), 4000, 40, most)
    let_vote(table, votes, 0, 40, 3)
    n = np.count_nonzero(votes.low.any(axis=1))
    assert n == votes.n_touched if most == 3 else n > 1024
    clear(votes)
    assert not votes.low.any()
    assert votes.n_touched == 0


def test_votes_after_a_clearing_are_those_of_the_next_star_only(figure):
    frame, _ = view(figure, rotation_to(56.9, 24.1))
    pairs, votes = pairs_of(figure.pairs), empty_votes(len(figure.catalog), 20)
    for main in range(centroids_of(frame).n):
        n = look_around(frame, main, 20, votes)
        end, _ = choose_rows(pairs, votes, n, 0.001)
        cast(pairs, votes, end, 3, PATIENT)
        np.testing.assert_array_equal(counts(votes), naive_counts(figure.pairs, votes, 0, end))
        clear(votes)


def test_when_the_time_is_up_nobody_votes(figure):
    frame, _ = view(figure, rotation_to(56.9, 24.1))
    pairs, votes = pairs_of(figure.pairs), empty_votes(len(figure.catalog), 20)
    end, total = choose_rows(pairs, votes, look_around(frame, 0, 20, votes), 0.001)
    assert total > 0
    cast(pairs, votes, end, 2, LATE)
    assert not counts(votes).any()


# Which cells are voted for


@pytest.mark.parametrize("roll_bin", [0, 6, 31, 62, 63])
def test_votes_fall_into_the_cell_of_the_cameras_roll(roll_bin):
    """At the boresight an angle on the sky is the roll plus that in the image.

    The roll is at the middle of a bin of 360 / 64 deg: 2 units of 360 / 256 deg from its ends,
    so that angles rounded down to units on both sides cannot leave it.
    """
    database = database_of(FIGURE)
    hub = list(FIGURE).index("Hub")
    roll_deg = (roll_bin + 0.5) * 360 / ROLL_BINS
    frame, truth = view(database, rotation_to(*FIGURE["Hub"], roll_deg))
    found = counts(votes_of(database, frame, truth.tolist().index(hub)))[hub]
    assert found[roll_bin] == found[(roll_bin + 1) % ROLL_BINS] == len(FIGURE) - 1


def votes_of(database, frame, main):
    """The votes of all companions of a main star."""
    pairs, votes = pairs_of(database.pairs), empty_votes(len(database.catalog), 20)
    n = look_around(frame, main, 20, votes)
    end, _ = choose_rows(pairs, votes, n, 2.0 / CAMERA.focal_length_px)
    assert end == n
    cast(pairs, votes, end, 2, PATIENT)
    return votes


def test_a_known_pair_votes_for_two_known_cells():
    """West to east along the equator, seen with roll 90: east, 90 deg on the sky, is up, 0.

    The difference is 64 units of 256, bin 16; seen from the eastern star 270 - 180 = 90, too.
    Stars are put off the exact angles, as these lie on the edge of a unit.
    """
    database = database_of({"West": (10.0, 0.0), "East": (12.0, -0.02), "Far": (200.0, 5.0)})
    frame, truth = view(database, rotation_to(11.0, 0.0, 91.5))
    assert sorted(truth.tolist()) == [0, 1]
    for main, star in enumerate(truth.tolist()):
        expected = np.zeros((3, ROLL_BINS), int)
        # The pair fits in both directions: for the other star half a turn away.
        expected[star, [16, 17]] = 1
        expected[1 - star, [48, 49]] = 1
        np.testing.assert_array_equal(counts(votes_of(database, frame, main)), expected)


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
