"""Cells of votes: the best ones, their members, the triangle check, on tiny named catalogues."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from engines import (
    CAMERA,
    ELSEWHERE,
    FIGURE,
    PATIENT,
    centroids_of,
    database_of,
    frame_of,
    pairs_of,
    rotation_to,
    view,
)

from star_tracker.catalogue.sky_index import SkyIndex
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import ra_dec, separation
from star_tracker.identification.cells import (
    MEMBERS,
    MatchGroupSettings,
    best_cells,
    empty_room,
    members,
    triangle_check,
)
from star_tracker.identification.votes import (
    ROLL_BINS,
    cast,
    choose_rows,
    count_of,
    empty_votes,
    look_around,
)

#: The brightest stars of the Pleiades, (RA, Dec) in degrees.
PLEIADES = {
    "Alcyone": (56.871, 24.105), "Atlas": (57.291, 24.053), "Electra": (56.219, 24.113),
    "Maia": (56.457, 24.368), "Merope": (56.582, 23.948), "Taygeta": (56.302, 24.467),
    "Pleione": (57.297, 24.137), "Celaeno": (56.201, 24.290),
}


@compiled
def room_lists(room):
    return room.observed, room.catalog


class Found(NamedTuple):
    """A cell and the matches that pass the triangle check, the main star the last of them."""

    cell: int
    score: int
    observed: np.ndarray
    catalog: np.ndarray


def vote(database, frame, main, *, tolerance_px=2.0, companions=20, threshold=2):
    """Let the companions of a main star vote: the votes and how many companions did."""
    pairs, votes = pairs_of(database.pairs), empty_votes(len(database.catalog), companions)
    n = look_around(frame, main, companions, votes)
    end, _ = choose_rows(pairs, votes, n, tolerance_px / CAMERA.focal_length_px)
    cast(pairs, votes, end, threshold, PATIENT)
    return votes, end


def proposed(database, frame, main, *, tolerance_px=2.0, cells=48, **options):
    """The candidates of a main star, best cell first."""
    votes, end = vote(database, frame, main, tolerance_px=tolerance_px, **options)
    tolerance = tolerance_px / CAMERA.focal_length_px
    highest, scores = np.empty(cells, np.int64), np.empty(cells, np.int64)
    room, pairs = empty_room(cells), pairs_of(database.pairs)
    observed, catalog = room_lists(room)
    result = []
    for at in range(best_cells(votes, 0, votes.n_reached, highest, scores)):
        cell = int(highest[at])
        k = members(pairs, votes, end, cell, tolerance, room)
        k = triangle_check(frame, database.sky_index, room, k, tolerance)
        if k >= 2:
            observed[k], catalog[k] = main, cell // ROLL_BINS
            kept = observed[: k + 1].copy(), catalog[: k + 1].copy()
            result.append(Found(cell, int(scores[at]), *kept))
    return result


def central(frame):
    """The star nearest to the boresight."""
    return int(np.argmax(centroids_of(frame).vectors[:, 2]))


def stars(frame):
    return range(centroids_of(frame).n)


@pytest.fixture(scope="module")
def figure():
    return database_of(FIGURE, ELSEWHERE)


# Best cells


def votes_with(n_stars, **cells):
    """Votes with counts for cells, given as s2r63=5 for star 2 and roll 63, all reached."""
    votes = empty_votes(n_stars, 1)
    for at, (name, count) in enumerate(cells.items()):
        star, roll = map(int, name[1:].split("r"))
        for digit in range(6):
            words, word = (votes.low, digit) if digit < 2 else (votes.high, digit - 2)
            words[star, word] |= np.uint64((count >> digit & 1) << roll)
        votes.reached[at] = star * ROLL_BINS + roll
    return votes, len(cells)


def best(most=9, n_stars=4, **cells):
    votes, n = votes_with(n_stars, **cells)
    found, scores = np.empty(most, np.int64), np.empty(most, np.int64)
    k = best_cells(votes, 0, n, found, scores)
    return {
        f"s{cell // ROLL_BINS}r{cell % ROLL_BINS}": score
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
    assert found[0] == 2 * ROLL_BINS + 60
    assert best_cells(votes, 1, 1, found, scores) == 0


# Voting for stars


def test_the_highest_cell_names_every_star_rightly(figure):
    frame, truth = view(figure, rotation_to(56.9, 24.1))
    assert len(truth) == len(FIGURE)
    first = proposed(figure, frame, central(frame))[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])
    assert set(first.observed.tolist()) == set(range(len(FIGURE)))
    assert first.score == len(FIGURE) - 1


def test_every_main_star_finds_itself(figure):
    frame, truth = view(figure, rotation_to(56.9, 24.1))
    for main, star in enumerate(truth):
        (found,) = proposed(figure, frame, main, cells=1)
        assert found.cell // ROLL_BINS == star
        np.testing.assert_array_equal(found.catalog, truth[found.observed])


def test_no_roll_falls_between_two_bins_or_off_their_end(figure):
    """720 rolls, so eleven in each bin of 5.6 deg; bins 63 and 0 are neighbours."""
    for roll_deg in np.arange(0.0, 360.0, 0.5):
        frame, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
        first = proposed(figure, frame, central(frame))[0]
        np.testing.assert_array_equal(first.catalog, truth[first.observed])
        # Each companion has a vote in the cell: none is lost at a bin's edge.
        assert len(set(first.observed.tolist())) == len(truth), f"roll {roll_deg}"


@pytest.mark.parametrize("roll_deg", [359.99, 0.0, 0.01, 1.4, 357.2])
def test_rolls_about_the_end_of_the_bins(figure, roll_deg):
    frame, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
    first = proposed(figure, frame, central(frame))[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


@pytest.mark.parametrize("place", [(0.0, 0.0), (120.0, 89.0), (300.0, -89.5)])
def test_anywhere_on_the_sky_and_at_the_poles_too(place):
    """Near a pole position angles change quickly from star to star: the votes still agree."""
    rng = np.random.default_rng(1)
    rotation = rotation_to(*place, 77.0)
    ra, dec = np.degrees(ra_dec(CAMERA.vectors(rng.random((10, 2)) * 512) @ rotation.T))
    stars = {f"S{i}": pair for i, pair in enumerate(zip(ra, dec, strict=True))}
    database = database_of(stars, ELSEWHERE)
    frame, truth = view(database, rotation)
    first = proposed(database, frame, central(frame))[0]
    assert len(first.observed) >= 3
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_the_pleiades_are_told_from_a_large_figure_by_their_size():
    database = database_of(PLEIADES, {n: (ra + 90, dec) for n, (ra, dec) in FIGURE.items()})
    frame, truth = view(database, rotation_to(56.8, 24.1, 200.0))
    assert len(truth) == len(PLEIADES)
    first = proposed(database, frame, central(frame))[0]
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_a_mirror_image_of_the_sky_is_not_matched_whole(figure):
    frame, _ = view(figure, rotation_to(56.9, 24.1))
    mirrored = frame_of(centroids_of(frame).plane_px * (1, -1) + 256)
    found = [one for main in stars(frame) for one in proposed(figure, mirrored, main)]
    assert all(len(set(one.observed.tolist())) < 5 for one in found)


@pytest.mark.parametrize("n", [1, 2])
def test_a_field_without_triangles_has_no_candidate(figure, n):
    frame = frame_of([(100.0, 100), (130, 90)][:n])
    assert proposed(figure, frame, 0) == []


def test_stars_that_resemble_no_pair_have_no_candidate(figure):
    """Three stars less than 0.02 deg apart."""
    frame = frame_of([(256.0, 256), (256.5, 256), (256, 256.4)])
    for main in range(3):
        assert proposed(figure, frame, main) == []


def test_only_the_nearest_companions_vote(figure):
    frame, _ = view(figure, rotation_to(56.9, 24.1))
    vectors = centroids_of(frame).vectors
    for main in stars(frame):
        nearest = np.argsort(separation(vectors, vectors[main]))[:4]
        for found in proposed(figure, frame, main, companions=3):
            assert set(found.observed.tolist()) <= set(nearest.tolist())


# Members


def test_a_cell_has_as_many_members_as_votes(figure):
    frame, _ = view(figure, rotation_to(56.9, 24.1, 18.0))
    vectors, tolerance_px = centroids_of(frame).vectors, 25.0
    tolerance = tolerance_px / CAMERA.focal_length_px
    room, pairs = empty_room(1), pairs_of(figure.pairs)
    observed, catalog = room_lists(room)
    for main in stars(frame):
        votes, end = vote(figure, frame, main, tolerance_px=tolerance_px)
        most = 0
        for cell in range(len(figure.catalog) * ROLL_BINS):
            k = members(pairs, votes, end, cell, tolerance, room)
            assert k == count_of(votes, cell)
            star = figure.catalog.vectors[cell // ROLL_BINS]
            guide = separation(figure.catalog.vectors[catalog[:k]], star)
            image = separation(vectors[observed[:k]], vectors[main])
            assert np.all(np.abs(guide - image) < tolerance + 1e-7)
            most = max(most, k)
        assert most >= len(FIGURE) - 1


def test_no_more_than_64_members_are_looked_at():
    """80 guide stars 2 deg from the main star, all within 4 deg of one position angle."""
    angle = np.radians(30.0) + np.linspace(0, np.radians(4), 80)
    arc = {f"A{i}": (40 + 2 * np.sin(a), 2 * np.cos(a)) for i, a in enumerate(angle.tolist())}
    database = database_of({"Hub": (40.0, 0.0)}, arc)
    frame = frame_of([(256.0, 256), (256, 171)])
    votes, end = vote(database, frame, 0, tolerance_px=20.0)
    room, pairs = empty_room(1), pairs_of(database.pairs)
    observed, catalog = room_lists(room)
    observed[:] = catalog[:] = -1
    tolerance = 20.0 / CAMERA.focal_length_px
    found = [members(pairs, votes, end, cell, tolerance, room) for cell in range(ROLL_BINS)]
    assert max(found) == MEMBERS == 64
    assert (observed[64], catalog[64]) == (-1, -1)


# The triangle check


def checked(frame, vectors, observed, catalog, *, tolerance_px=1.0):
    """The members kept by the check."""
    room, n = empty_room(1), len(observed)
    o, c = room_lists(room)
    o[:n], c[:n] = observed, catalog
    k = triangle_check(
        frame, SkyIndex.build(vectors), room, n, tolerance_px / CAMERA.focal_length_px
    )
    return list(zip(o[:k].tolist(), c[:k].tolist(), strict=True))


@pytest.fixture(scope="module")
def triangle():
    """Five stars of an image, from left to right, and five guide stars in the same places."""
    xy = np.array([(60.0, 100), (150, 300), (220, 90), (330, 410), (450, 260)])
    return frame_of(xy), CAMERA.vectors(xy) @ rotation_to(30.0, -20.0, 50.0).T


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
    frame = frame_of([(226.0, 256), (289, 256)])
    vectors = CAMERA.vectors([(226.0, 256), (286, 256)])
    assert len(checked(frame, vectors, [0, 1], [0, 1], tolerance_px=tolerance_px)) == kept


@pytest.mark.parametrize("turn_deg", [-1.2, 1.2])
def test_the_triangle_check_leaves_out_a_companion_that_only_fits_the_main_star(turn_deg):
    """A false star at a companion's distance, 1.2 deg about the main star: the same cell or next.

    At 4.3 deg from the main star that is 0.09 deg or 3.8 px from the companion's place.
    """
    database = database_of(FIGURE)
    frame, truth = view(database, rotation_to(56.9, 24.1, 11.0))
    main, corner = (truth.tolist().index(list(FIGURE).index(name)) for name in ("Hub", "Corner"))
    before = centroids_of(frame).vectors
    vectors = before.copy()
    axis, angle, v = vectors[main], np.radians(turn_deg), before[corner]
    vectors[corner] = (  # Rodrigues' formula
        v * np.cos(angle) + np.cross(axis, v) * np.sin(angle)
        + axis * (axis @ v) * (1 - np.cos(angle))
    )
    change = CAMERA.focal_length_px * np.abs(
        separation(vectors, vectors[corner]) - separation(before, v)
    )
    assert change[main] == pytest.approx(0, abs=1e-9)
    assert np.all(np.delete(change, [main, corner]) > 0.5)
    moved = frame_of(CAMERA.pixels(vectors))
    row = centroids_of(moved).row
    (found,) = proposed(
        database, moved, row.tolist().index(main), tolerance_px=0.5, cells=1
    )
    assert set(row[found.observed].tolist()) == set(range(len(truth))) - {corner}
    np.testing.assert_array_equal(found.catalog, truth[row[found.observed]])


# Settings


@pytest.mark.parametrize("tolerances", [(), (2.0, 0.0), (math.nan,), (101.0,)])
def test_pair_tolerances_out_of_range_are_refused(tolerances):
    text = "^pair_tolerance_px needs one or more values from 0.01 to 100$"
    with pytest.raises(ValueError, match=text):
        MatchGroupSettings(pair_tolerance_px=tolerances)


@pytest.mark.parametrize("options", [
    {"companions": 0}, {"companions": -1}, {"companions": 41}, {"cells": 0},
])
def test_a_matcher_that_could_find_nothing_is_refused(options):
    text = "^companions must be from 1 to 40 and cells at least 1$"
    with pytest.raises(ValueError, match=text):
        MatchGroupSettings(**options)
