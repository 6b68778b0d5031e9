"""In which order the search looks."""

import math

import numpy as np
import pytest

from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.evidence import EXACT, ScalePrior, scale_prior
from star_tracker.identification.plan import LEVEL, levels

UNKNOWN = ScalePrior(-0.3, 0.3, 2.0, told=False, sigma=math.inf)
#: Centroids of an average frame.
EXPECTED = 30.0
#: As many main stars as there are.
ALL = np.iinfo(np.int64).max


def of_all_frames(found):
    """Without the levels that are only for frames of more centroids than stars are expected."""
    return found[found["least_n"] == 0]


def told_with_tolerance(settings):
    return of_all_frames(levels(settings, scale_prior(5.0), EXPECTED))


def test_the_full_search_tries_the_tolerances_in_turn():
    settings = MatchGroupSettings((1.0, 3.0), companions=9, cells=7, quick=False)
    found = of_all_frames(levels(settings, EXACT, EXPECTED))
    assert found.dtype == LEVEL
    assert not found["by_shape"].any()
    assert found["tolerance_px"].tolist() == [1, 3]
    for name, value in (("companions", 9), ("batch", 9), ("mains", ALL), ("cells", 7)):
        assert found[name].tolist() == [value, value], name


@pytest.mark.parametrize(("tolerances", "short"), [
    ((2.0,), [2, 2, 2, 2]), ((2.0, 6.0, 12.0), [2, 4, 2, 6]),
])
def test_a_short_search_by_shape_comes_before_the_full_one(tolerances, short):
    found = of_all_frames(levels(MatchGroupSettings(tolerances), EXACT, EXPECTED))
    assert found["tolerance_px"].tolist() == [*short, *tolerances]
    short, full = found[:4], found[4:]
    assert short["by_shape"].all()
    assert not full["by_shape"].any()
    assert np.all(short["mains"] < ALL)
    assert np.all(full["mains"] == ALL)
    assert np.all(short["companions"] <= full["companions"][0])
    # Intensities may mean nothing: what the short search misses the full one has to find.
    assert short["in_order"].all()
    assert not full["in_order"].any()
    assert not found["pause"].any()


def test_where_more_centroids_come_than_stars_are_expected_companions_come_before_noise():
    found = levels(MatchGroupSettings((2.0, 6.0)), EXACT, EXPECTED)
    usual, crowded = (
        found[(found["least_n"] <= n) & (n <= found["most_n"])][["tolerance_px", "companions"]]
        for n in (42, 43)
    )
    assert usual[1].tolist() == (4.0, 8)
    assert crowded[1].tolist() == (2.0, 8)
    np.testing.assert_array_equal(np.delete(usual, 1), np.delete(crowded, 1))


@pytest.mark.parametrize("quick", [True, False])
def test_where_four_of_five_are_false_many_companions_vote_before_the_full_search(quick):
    found = levels(MatchGroupSettings(quick=quick), EXACT, EXPECTED)
    at = 5 * quick
    assert found["least_n"][at] == 4 * EXPECTED
    assert found["most_n"][at] == ALL
    assert found["mains"][at] == ALL
    assert found["companions"][at] > found["companions"][at + 1]


@pytest.mark.parametrize("prior", [EXACT, scale_prior(5.0), UNKNOWN], ids=["exact", "5 %", "any"])
@pytest.mark.parametrize("quick", [True, False])
@pytest.mark.parametrize("companions", [1, 20, 40])
def test_the_votes_of_all_batches_have_room(prior, quick, companions):
    """The engine makes room for the most companions of any level."""
    found = levels(MatchGroupSettings(companions=companions, quick=quick), prior, EXPECTED)
    assert np.all(found["batch"] <= found["companions"])
    assert np.all(found["companions"] >= 1)
    assert np.all(found["cells"] >= 1)


def test_where_the_focal_length_is_told_with_a_tolerance_the_full_search_takes_turns():
    """As it is told first, and what is quick before what is full."""
    settings = MatchGroupSettings((2.0, 6.0, 12.0))
    found = told_with_tolerance(settings)
    assert found["by_shape"].tolist() == [True] * 4 + [False, True] * 3
    assert found["tolerance_px"].tolist() == [2, 4, 2, 6, 2, 2, 6, 6, 12, 12]
    assert not found["pause"].any()


@pytest.mark.parametrize("quick", [True, False])
def test_what_is_told_exactly_is_a_part_of_what_is_told_with_a_tolerance(quick):
    settings = MatchGroupSettings((2.0, 6.0), quick=quick)
    exact, both = of_all_frames(levels(settings, EXACT, EXPECTED)), told_with_tolerance(settings)
    n_short = 4 * quick
    np.testing.assert_array_equal(both[:n_short], exact[:n_short])
    np.testing.assert_array_equal(both[n_short::2], exact[n_short:])


@pytest.mark.parametrize("quick", [True, False])
def test_where_the_focal_length_is_not_told_only_shapes_are_left(quick):
    settings = MatchGroupSettings((2.0, 6.0), quick=quick)
    found = levels(settings, UNKNOWN, EXPECTED)
    assert found["by_shape"].all()
    n_short = 4 * quick
    # Triangles of all sizes vote: with a tight tolerance at first.
    assert found["tolerance_px"][:n_short].tolist() == [1, 1, 2, 6][:n_short]
    full = told_with_tolerance(settings)[4 * quick + 1 :: 2]
    names = [name for name in LEVEL.names if name != "pause"]
    np.testing.assert_array_equal(found[names][n_short:], full[names])
    # Other cameras have their turn after each level of a full search.
    assert found["pause"][n_short:].all()


def test_a_candidate_by_shape_has_votes_that_chance_does_not_give():
    """Of one triangle alone there are many; what its members are worth is asked besides."""
    found = levels(MatchGroupSettings(), UNKNOWN, EXPECTED)
    assert np.all(found["votes"] >= 3)
    assert np.all(found["worth"] > 1)
