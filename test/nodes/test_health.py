"""The rolling statistics of a node's health, without ROS."""

from collections import Counter

import pytest

from star_tracker.nodes.identify.health import WINDOW_S, FrameRecord, Health, input_age_s, quantile

SECOND = 1_000_000_000
NONE = Counter()


def record(solved=True, latency_ms=2.0, n_stars=10, n_false=2, **changes):
    values = {"reason": "SOLVED: identified" if solved else "NO_MATCH: nothing", "age_s": 0.01,
              "mode": "tracking" if solved else "lost_in_space"}
    return FrameRecord(
        solved=solved, latency_ms=latency_ms, n_stars=n_stars, n_false=n_false,
        **{**values, **changes},
    )


def health_of(records, per_s=10.0):
    """Return the health after frames at this rate, and the time of the last."""
    health = Health(0.0)
    for i, one in enumerate(records, start=1):
        health.add(one, i / per_s)
    return health, len(records) / per_s


def test_a_node_without_frames_warns_and_knows_no_ratio():
    level, message, values = Health(0.0).report(NONE, 5.0)
    assert (level, message) == ("warn", "no frame in the last 10 s")
    assert values["frames_per_s"] == 0.0
    for key in ("solve_ratio", "latency_p50_ms", "latency_p95_ms", "latency_max_ms",
                "input_age_s", "false_star_ratio", "mode", "last_reason"):
        assert values[key] is None


def test_rates_and_ratio():
    health, now = health_of([record(i % 4 != 0) for i in range(80)])
    level, message, values = health.report(NONE, now)
    assert (level, message) == ("ok", "75 % of 80 frames solved")
    assert values["frames_per_s"] == pytest.approx(10.0)
    assert values["solved_per_s"] == pytest.approx(7.5)
    assert values["solve_ratio"] == 0.75
    assert (values["frames"], values["solved"]) == (80, 60)
    assert (values["mode"], values["last_reason"]) == ("tracking", "NO_MATCH: nothing")


def test_the_window_slides_but_the_counts_stay():
    health, now = health_of([record(False)] * 50)
    for i in range(100):
        health.add(record(), now + WINDOW_S + i / 100)
    _, _, values = health.report(NONE, now + WINDOW_S + 1.0)
    assert values["solve_ratio"] == 1.0
    assert values["frames_per_s"] == pytest.approx(10.0)
    assert (values["frames"], values["solved"]) == (150, 100)


def test_a_flood_keeps_its_rate_and_its_memory():
    health, now = health_of([record()] * 30_000, per_s=5000.0)
    _, _, values = health.report(NONE, now)
    assert values["frames_per_s"] == pytest.approx(5000.0, rel=0.01)
    assert len(health._frames) == 10_000


def test_the_first_frame_is_no_rate_of_thousands():
    health = Health(0.0)
    health.add(record(), 0.001)
    assert health.report(NONE, 0.002)[2]["frames_per_s"] == 1.0


def test_latencies():
    health, now = health_of([record(latency_ms=float(i)) for i in range(100, 0, -1)], per_s=20)
    _, _, values = health.report(NONE, now)
    keys = ("latency_p50_ms", "latency_p95_ms", "latency_max_ms")
    assert [values[key] for key in keys] == [50.0, 95.0, 100.0]


def test_false_stars_are_those_of_solved_frames():
    health, now = health_of([
        record(n_stars=10, n_false=2), record(False, n_stars=50, n_false=50),
        record(n_stars=30, n_false=6),
    ])
    assert health.report(NONE, now)[2]["false_star_ratio"] == pytest.approx(0.2)


def test_rejects_are_counted_by_reason():
    rejected = Counter(malformed_cloud=3, bad_centroids=1)
    values = Health(0.0).report(rejected, 1.0)[2]
    assert (values["rejected_malformed_cloud"], values["rejected_bad_centroids"]) == (3, 1)


@pytest.mark.parametrize(("n_solved", "level"), [(0, "error"), (4, "warn"), (5, "ok")])
def test_level_follows_the_ratio(n_solved, level):
    health, now = health_of([record(i < n_solved) for i in range(10)])
    found, message, _ = health.report(NONE, now)
    assert found == level
    assert message.startswith(f"{10 * n_solved} % of 10 frames solved")
    assert ("NO_MATCH: nothing" in message) == (level != "ok")


@pytest.mark.parametrize(("stamp_ns", "age_s"), [
    (99 * SECOND, 1.0), (100 * SECOND, 0.0), (40 * SECOND, 60.0),
    (0, None), (39 * SECOND, None), (101 * SECOND, None), (-5, None),
])
def test_age_is_known_only_where_the_clocks_fit(stamp_ns, age_s):
    assert input_age_s(stamp_ns, 100 * SECOND) == age_s


def test_quantile_is_the_nearest_rank():
    assert quantile([], 0.5) is None
    assert quantile([3.0], 0.5) == 3.0
    assert quantile([1.0, 2.0], 0.5) == 1.0
    assert quantile([1.0, 2.0], 0.95) == 2.0
    assert quantile([float(i) for i in range(1, 1001)], 0.95) == 950.0
