"""Match-group voting on tiny catalogues of named stars."""

import numpy as np
import pytest

from star_tracker.attitude import rotation_from_boresight
from star_tracker.camera import Camera
from star_tracker.catalog import StarCatalog
from star_tracker.database import FeatureDatabase
from star_tracker.distortion import Distortion
from star_tracker.field import StarField
from star_tracker.match_group import MatchGroupSettings, candidates
from star_tracker.spherical import ra_dec, separation, unit_vectors

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


def database_of(*groups, **options):
    stars = {name: place for group in groups for name, place in group.items()}
    ra, dec = np.radians(list(stars.values())).T
    none = np.zeros(len(stars), np.int64)
    catalog = StarCatalog(unit_vectors(ra, dec), np.full(len(stars), 4.0), none, none)
    return FeatureDatabase.build(catalog, **options)


def rotation_to(ra_deg, dec_deg, roll_deg=0.0):
    return rotation_from_boresight(*np.radians([ra_deg, dec_deg, roll_deg]))


def view(database, rotation, camera=CAMERA):
    """A frame of all stars that a camera sees, without noise: the field, the truth of its rows."""
    index = np.flatnonzero(database.catalog.vectors @ rotation[:, 2] > 0.9)
    xy = camera.pixels(database.catalog.vectors[index] @ rotation)
    inside = camera.contains(xy)
    return StarField.from_pixels(camera, xy[inside]), index[inside]


def proposed(database, field, settings=None):
    found = candidates(database, field, settings or MatchGroupSettings())
    return [candidate for _, candidate in found if candidate is not None]


def first_proposed(database, field):
    found = candidates(database, field, MatchGroupSettings())
    return next(candidate for _, candidate in found if candidate is not None)


@pytest.fixture(scope="module")
def figure():
    return database_of(FIGURE, ELSEWHERE)


# The field


def test_stars_are_taken_from_the_boresight_outwards():
    field = StarField.from_pixels(CAMERA, np.array([(0.0, 0), (256, 250), (300, 256)]))
    assert field.from_centre.tolist() == [1, 2, 0]


def test_neighbours_are_the_nearest_other_stars_in_order():
    """At the image's middle: one star 10 px to the right, one 20 px up, one 30 px to the left."""
    field = StarField.from_pixels(
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
    field = StarField.from_pixels(camera, np.array([(350.0, 400.0)]))
    np.testing.assert_allclose(field.vectors, camera.vectors([(350.0, 400.0)]))
    plane = field.vectors[:, :2] / field.vectors[:, 2:]
    np.testing.assert_allclose(field.plane_px, 400 * plane)
    assert field.plane_px[0, 1] < 0


# Voting


def test_the_first_candidate_names_every_star_rightly(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1))
    assert len(truth) == len(FIGURE)
    first = first_proposed(figure, field)
    np.testing.assert_array_equal(first.catalog, truth[first.observed])
    assert set(first.observed.tolist()) == set(range(len(FIGURE)))


def test_the_first_candidate_is_of_the_star_nearest_to_the_boresight(figure):
    field, truth = view(figure, rotation_to(57.9, 23.1))
    first = first_proposed(figure, field)
    assert truth[first.observed[0]] == list(FIGURE).index("Near")
    assert first.observed[0] == field.from_centre[0]


def test_a_candidate_begins_with_its_main_star(figure):
    """Companions vote for a cell of the main star; it is a member without a vote."""
    field, truth = view(figure, rotation_to(56.9, 24.1, 33.0))
    for candidate in proposed(figure, field):
        if candidate.catalog[0] == truth[candidate.observed[0]]:
            np.testing.assert_array_equal(candidate.catalog, truth[candidate.observed])
            break
    else:
        pytest.fail("no candidate has its main star right")


def test_every_main_star_finds_itself(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1))
    settings = MatchGroupSettings(pair_tolerance_px=(2.0,), cells=1)
    mains = {int(c.observed[0]): int(c.catalog[0]) for c in proposed(figure, field, settings)}
    assert mains == {i: int(star) for i, star in enumerate(truth)}


def test_no_roll_falls_between_two_bins_or_off_their_end(figure):
    """720 rolls, so four in each bin of 2.8 deg; bins 127 and 0 are neighbours."""
    for roll_deg in np.arange(0.0, 360.0, 0.5):
        field, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
        first = first_proposed(figure, field)
        np.testing.assert_array_equal(first.catalog, truth[first.observed])
        # Each companion has a vote in the cell: none is lost at a bin's edge.
        assert len(set(first.observed.tolist())) == len(truth), f"roll {roll_deg}"


@pytest.mark.parametrize("roll_deg", [359.99, 0.0, 0.01, 1.4, 357.2])
def test_rolls_about_the_end_of_the_bins(figure, roll_deg):
    field, truth = view(figure, rotation_to(56.9, 24.1, roll_deg))
    first = first_proposed(figure, field)
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
    first = first_proposed(database, field)
    assert len(first.observed) >= 3
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_the_pleiades_are_told_from_a_large_figure_by_their_size():
    database = database_of(PLEIADES, {n: (ra + 90, dec) for n, (ra, dec) in FIGURE.items()})
    field, truth = view(database, rotation_to(56.8, 24.1, 200.0))
    assert len(truth) == len(PLEIADES)
    first = first_proposed(database, field)
    np.testing.assert_array_equal(first.catalog, truth[first.observed])


def test_a_mirror_image_of_the_sky_is_not_matched_whole(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    mirrored = StarField.from_pixels(CAMERA, field.plane_px * (1, -1) + 256)
    settings = MatchGroupSettings(pair_tolerance_px=(2.0,))
    assert all(len(set(c.observed)) < 5 for c in proposed(figure, mirrored, settings))


@pytest.mark.parametrize("turn_deg", [-1.2, 1.2])
def test_the_triangle_check_leaves_out_a_companion_that_only_fits_the_main_star(turn_deg):
    """A false star at a companion's distance, 1.2 deg about the main star: the same cell or next.

    At 4.3 deg from the main star that is 0.09 deg or 3.8 px from the companion's place.
    """
    database = database_of(FIGURE)
    field, truth = view(database, rotation_to(56.9, 24.1, 11.0))
    main, corner = (list(truth).index(list(FIGURE).index(name)) for name in ("Hub", "Corner"))
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
    moved = StarField.from_pixels(CAMERA, CAMERA.pixels(vectors))
    settings = MatchGroupSettings(pair_tolerance_px=(0.5,), cells=1)
    (found,) = (c for c in proposed(database, moved, settings) if c.observed[0] == main)
    assert set(found.observed.tolist()) == set(range(len(truth))) - {corner}
    np.testing.assert_array_equal(found.catalog, truth[found.observed])


def test_none_is_yielded_for_main_stars_without_a_candidate(figure):
    """Three stars less than 0.02 deg apart resemble no pair: one None each, for each tolerance."""
    field = StarField.from_pixels(CAMERA, np.array([(256.0, 256), (256.5, 256), (256, 256.4)]))
    settings = MatchGroupSettings(pair_tolerance_px=(1.0, 2.0))
    assert [c for _, c in candidates(figure, field, settings)] == [None] * 6


def test_none_is_yielded_after_each_main_star(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1))
    settings = MatchGroupSettings(pair_tolerance_px=(2.0,), cells=1)
    found = list(candidates(figure, field, settings))
    assert [c is None for _, c in found] == [False, True] * len(truth)


@pytest.mark.parametrize("n", [0, 1])
def test_a_field_without_pairs_has_no_candidate(figure, n):
    field = StarField.from_pixels(CAMERA, np.full((n, 2), 100.0))
    assert proposed(figure, field) == []


def test_tolerances_are_tried_in_turn_and_written_on_the_candidate(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    settings = MatchGroupSettings(pair_tolerance_px=(1.0, 3.0))
    tolerances = [c.tolerance_px for c in proposed(figure, field, settings)]
    assert tolerances == sorted(tolerances)
    assert set(tolerances) == {1.0, 3.0}


def test_no_more_cells_than_asked_become_candidates(figure):
    field, truth = view(figure, rotation_to(56.9, 24.1))
    for cells in (1, 2):
        settings = MatchGroupSettings(pair_tolerance_px=(12.0,), cells=cells)
        mains = [int(c.observed[0]) for c in proposed(figure, field, settings)]
        assert max(mains.count(main) for main in range(len(truth))) <= cells


def test_only_the_nearest_companions_vote(figure):
    field, _ = view(figure, rotation_to(56.9, 24.1))
    settings = MatchGroupSettings(pair_tolerance_px=(2.0,), companions=3)
    for candidate in proposed(figure, field, settings):
        main = int(candidate.observed[0])
        nearest = np.argsort(separation(field.vectors, field.vectors[main]))[:4]
        assert set(candidate.observed.tolist()) <= set(nearest.tolist())


def test_n_compared_counts_the_votes_and_grows(figure):
    """A vote is a directed guide-star pair whose separation fits that of an observed pair."""
    field, _ = view(figure, rotation_to(56.9, 24.1))
    tolerances = (2.0, 6.0)
    catalog = figure.catalog.vectors
    guide = separation(catalog[:, None], catalog[None])
    guide = guide[(guide > 0) & (guide <= np.radians(12))]
    votes, expected = 0, {}
    for tolerance_px in tolerances:
        tolerance = tolerance_px / CAMERA.focal_length_px
        for main in field.from_centre.tolist():
            observed = np.delete(separation(field.vectors, field.vectors[main]), main)
            votes += np.count_nonzero(np.abs(guide[None] - observed[:, None]) <= tolerance)
            expected[tolerance_px, main] = votes
    steps = list(candidates(figure, field, MatchGroupSettings(pair_tolerance_px=tolerances)))
    found = [(n, candidate) for n, candidate in steps if candidate is not None]
    assert {candidate.tolerance_px for _, candidate in found} == set(tolerances)
    for n_compared, candidate in found:
        assert n_compared == expected[candidate.tolerance_px, candidate.observed[0]]
    assert np.all(np.diff([n_compared for n_compared, _ in steps]) >= 0)
