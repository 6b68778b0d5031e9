"""The fallback alone and behind the primary; `test/statistics` has how often it works.

Everything is seeded, and a frame may take as long as it needs.
"""

import itertools
import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

from star_tracker import frame_solution
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import separation
from star_tracker.identification import escalation, searcher
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.fallback import RadialCyclicSettings
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

CAMERA = Camera.from_fov(12, 512, 512)
#: A frame of 15 stars and 8 px noise that the primary misses and the fallback solves.
SEED_OF_THE_FALLBACKS_FRAME, HARD_NOISE_PX = 105, 8.0
NODE = {"parity": "normal", "deadline_ms": 60_000.0, "keep_up": False}


def tracker_of(database, method, camera=CAMERA, **options):
    return StarTracker(database, camera, SolveSettings(method, **{
        "deadline_ms": math.inf, **options,
    }))


def random_frame(database, rng, noise_px):
    return synthetic_field(
        database.catalog, CAMERA, random_rotation(rng), rng, Condition(noise_px=noise_px)
    )


def boresight_error_deg(solution, rotation):
    return np.degrees(separation(solution.attitude.rotation[:, 2], rotation[:, 2]))


# The fallback


@pytest.mark.parametrize(
    "method", [pytest.param("radial_cyclic", marks=pytest.mark.slow), "auto"]  # which has both
)
@pytest.mark.parametrize(
    "max_separation_deg", [0.5, *(pytest.param(x, marks=pytest.mark.slow) for x in (2.0, 6.0))]
)
def test_no_noise_is_solved_with_a_short_pair_table_either(method, max_separation_deg):
    """Nor by patterns, which reach beyond the primary's largest separation."""
    database = FeatureDatabase.build(
        StarCatalog.paper(), max_separation_deg=max_separation_deg
    )
    tracker = tracker_of(database, method)
    rng = np.random.default_rng(5)
    for _ in range(12):
        solution = tracker.solve(uniform_noise(CAMERA, 6, rng))
        assert solution.status is Status.NO_MATCH
        assert solution.log10_false_alarms > SolveSettings().max_log10_false_alarms


# Both


@pytest.fixture(scope="module")
def hard_frame(database):
    rng = np.random.default_rng(SEED_OF_THE_FALLBACKS_FRAME)
    return random_frame(database, rng, noise_px=HARD_NOISE_PX)


def test_auto_says_that_the_primary_answered(database):
    frame = random_frame(database, np.random.default_rng(1), noise_px=0.5)
    assert tracker_of(database, "auto").solve(frame.xy_px).method == "match_group"
    for method in ("match_group", "radial_cyclic"):
        assert tracker_of(database, method).solve(frame.xy_px).method == method


def test_both_methods_name_the_same_stars(database):
    """And their attitudes differ by far less than the noise makes them err."""
    rng = np.random.default_rng(2)
    for _ in range(5):
        frame = random_frame(database, rng, noise_px=0.5)
        first, second = (
            tracker_of(database, method).solve(frame.xy_px)
            for method in ("match_group", "radial_cyclic")
        )
        np.testing.assert_array_equal(
            first.identification.catalog_index, second.identification.catalog_index
        )
        sigma_rad = math.sqrt(np.trace(first.attitude.covariance_rad2))
        np.testing.assert_allclose(
            first.attitude.rotation, second.attitude.rotation, rtol=0, atol=0.1 * sigma_rad
        )


def test_the_fallback_solves_a_frame_of_8_px_noise_that_the_primary_misses(database, hard_frame):
    primary = tracker_of(database, "match_group").solve(hard_frame.xy_px)
    assert primary.status is Status.NO_MATCH
    assert primary.method == ""
    both = tracker_of(database, "auto").solve(hard_frame.xy_px)
    assert both.status is Status.SOLVED
    assert both.method == "radial_cyclic"
    assert boresight_error_deg(both, hard_frame.rotation) < 0.3
    named = both.identification.identified
    np.testing.assert_array_equal(
        both.identification.catalog_index[named], hard_frame.catalog_index[named]
    )


def test_what_both_have_compared_is_counted_and_not_charged(database, hard_frame):
    """The score is evidence: a search that was in vain before it does not lower it."""
    primary, fallback, both = (
        tracker_of(database, method).solve(hard_frame.xy_px)
        for method in ("match_group", "radial_cyclic", "auto")
    )
    assert both.n_hypotheses >= primary.n_hypotheses + fallback.n_hypotheses
    assert both.log10_false_alarms == fallback.log10_false_alarms
    assert both.wrong_probability >= fallback.wrong_probability


def test_what_neither_solves_has_no_method(database):
    xy = uniform_noise(CAMERA, 6, np.random.default_rng(3))
    solutions = [
        tracker_of(database, method).solve(xy)
        for method in ("match_group", "radial_cyclic", "auto")
    ]
    primary, fallback, both = solutions
    assert {s.status for s in solutions} == {Status.NO_MATCH}
    assert {s.method for s in solutions} == {""}
    assert both.n_hypotheses == primary.n_hypotheses + fallback.n_hypotheses
    assert f"the best of {both.n_hypotheses} hypotheses" in both.reason


def test_the_fallback_knows_both_parities(database, hard_frame):
    camera = CAMERA.with_parity("auto")
    solution = tracker_of(database, "radial_cyclic", camera).solve(hard_frame.xy_px)
    assert (solution.status, solution.parity) == (Status.SOLVED, "normal")


def test_an_unknown_method_is_refused():
    text = "^method 'guess' is unknown: use auto, match_group, radial_cyclic$"
    with pytest.raises(ValueError, match=text):
        SolveSettings(method="guess")


def test_only_the_fallback_minds_a_dense_catalogue(monkeypatch, database):
    monkeypatch.setattr("star_tracker.catalogue.database.MAX_PATTERN_STARS", 4907)
    dense = FeatureDatabase(database.catalog, database.pairs)
    for method in ("match_group", "auto"):
        tracker_of(dense, method)
    with pytest.raises(ValueError, match="4908 guide stars are too dense for method"):
        tracker_of(dense, "radial_cyclic")


# The deadline


@pytest.mark.parametrize("method", ["auto", "radial_cyclic"])
def test_a_deadline_that_has_passed_is_a_timeout(database, hard_frame, method):
    solution = tracker_of(database, method, deadline_ms=1e-6).solve(hard_frame.xy_px)
    assert solution.status is Status.TIMEOUT
    assert solution.attitude is None
    assert solution.method == ""
    assert solution.reason.startswith("deadline 1e-06 ms passed, ")


def test_a_thousand_points_are_a_timeout_too(database):
    xy = uniform_noise(CAMERA, 1000, np.random.default_rng(4))
    solution = tracker_of(database, "auto", deadline_ms=1e-6).solve(xy)
    assert solution.status is Status.TIMEOUT


#: Tolerances too narrow for any pair of a frame with noise keep the primary busy in vain: 15 main
#: stars, each for 150 steps.
NARROW = MatchGroupSettings(pair_tolerance_px=tuple(np.linspace(0.01, 0.012, 150).tolist()))


@pytest.fixture
def clock_of_one_ms_a_look(monkeypatch):
    """A clock that advances by 1 ms whenever it is read: after each main star and candidate."""
    reading = itertools.count()
    clock = SimpleNamespace(
        perf_counter=lambda: next(reading) / 1e3, monotonic=time.monotonic
    )
    for module in (frame_solution, escalation, searcher):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(frame_solution, "_WORK", 1.0)


@pytest.mark.usefixtures("clock_of_one_ms_a_look")
def test_the_primary_makes_way_after_half_of_the_deadline(database, hard_frame):
    """The fallback has 3 widths of ring and 15 main stars with 20 guide stars each: 963 steps."""
    tracker = tracker_of(database, "auto", deadline_ms=2000.0, match_group=NARROW)
    solution = tracker.solve(hard_frame.xy_px)
    assert solution.status is Status.SOLVED
    assert solution.method == "radial_cyclic"
    assert 1000 < solution.solve_ms <= 2000


@pytest.mark.usefixtures("clock_of_one_ms_a_look")
def test_the_primary_alone_has_the_whole_deadline(database, hard_frame):
    tracker = tracker_of(database, "match_group", deadline_ms=2000.0, match_group=NARROW)
    solution = tracker.solve(hard_frame.xy_px)
    assert solution.status is Status.TIMEOUT
    assert 2000 < solution.solve_ms <= 2010


@pytest.mark.usefixtures("clock_of_one_ms_a_look")
def test_a_primary_that_was_cut_off_gets_the_time_that_the_fallback_leaves(database, hard_frame):
    """The fallback, of one main star and one guide star, ends in time without a match."""
    settings = {
        "match_group": NARROW,
        "radial_cyclic": RadialCyclicSettings(ring_factors=(1,), mains=1, matches=1),
    }
    tracker = tracker_of(database, "auto", deadline_ms=2000.0, **settings)
    solution = tracker.solve(hard_frame.xy_px)
    assert solution.status is Status.TIMEOUT
    assert 2000 < solution.solve_ms <= 2010


@pytest.mark.usefixtures("clock_of_one_ms_a_look")
def test_both_parities_share_the_deadline(database, hard_frame):
    tracker = tracker_of(
        database, "match_group", CAMERA.with_parity("auto"), deadline_ms=1000.0,
        match_group=NARROW,
    )
    solution = tracker.solve(hard_frame.xy_px)
    assert solution.status is Status.TIMEOUT
    assert 1000 < solution.solve_ms <= 1010


# Through the node


@pytest.fixture
def ros():
    """The bench of the nodes; without ROS the tests of this part are skipped."""
    pytest.importorskip("rclpy")
    import ros_helpers

    from star_tracker.nodes import identify_node, parameters

    return SimpleNamespace(
        IdentifyNode=identify_node.IdentifyNode, ParameterError=parameters.ParameterError,
        **vars(ros_helpers),
    )


def answer(ros, frame, **parameters):
    """The outcome of one frame, sent to an identify_node with these parameters."""
    with ros.open_bench() as bench:
        client = ros.IdentifyClient(bench)
        bench.start(ros.IdentifyNode, {**NODE, **parameters})
        client.connect()
        return client.send(ros.frame_of(frame.xy_px))


def test_the_node_has_no_attitude_of_that_frame_by_the_primary_alone(ros, database, hard_frame):
    easy = random_frame(database, np.random.default_rng(1), noise_px=0.5)
    with ros.open_bench() as bench:
        client = ros.IdentifyClient(bench)
        bench.start(ros.IdentifyNode, {**NODE, "method": "match_group"})
        client.connect()
        outcome = client.unsolved(ros.frame_of(hard_frame.xy_px), ros.frame_of(easy.xy_px))
    assert outcome.attitude is None
    assert outcome.status == "NO_MATCH"
    assert outcome.values["method"] == ""


@pytest.mark.parametrize("method", ["auto", "radial_cyclic"])
def test_the_node_solves_that_frame_with_the_fallback(ros, hard_frame, method):
    outcome = answer(ros, hard_frame, method=method)
    assert outcome.status == "SOLVED"
    assert outcome.values["method"] == "radial_cyclic"
    assert outcome.attitude is not None


def test_the_node_says_that_the_primary_answered(ros, database):
    frame = random_frame(database, np.random.default_rng(1), noise_px=0.5)
    outcome = answer(ros, frame, method="auto")
    assert (outcome.status, outcome.values["method"]) == ("SOLVED", "match_group")


def test_the_fallback_is_on_by_default(ros, hard_frame):
    assert answer(ros, hard_frame).values["method"] == "radial_cyclic"


def test_the_node_refuses_an_unknown_method_in_one_line(ros):
    with ros.open_bench() as bench, pytest.raises(ros.ParameterError) as caught:
        bench.start(ros.IdentifyNode, {"method": "guess"})
    text = str(caught.value)
    assert "\n" not in text
    for word in ("method", "guess", "auto", "match_group", "radial_cyclic"):
        assert word in text


def test_the_node_refuses_a_catalogue_too_dense_for_the_fallback_in_one_line(ros, monkeypatch):
    monkeypatch.setattr("star_tracker.catalogue.database.MAX_PATTERN_STARS", 1000)
    with ros.open_bench() as bench:
        bench.start(ros.IdentifyNode, {"method": "radial_cyclic"})
        with pytest.raises(ros.ParameterError) as caught:
            bench.until_ready()
    text = str(caught.value)
    assert "\n" not in text
    assert "lower limiting_magnitude or set method to match_group" in text
