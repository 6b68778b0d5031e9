"""One engine as Python sees it: how sure it is of its best pose, and when it makes way."""

import math
import time

import numpy as np
import pytest
from engines import CAMERA, Bench

from star_tracker.compiled import compiled
from star_tracker.identification.ended import Ended
from star_tracker.identification.labels import LABEL
from star_tracker.identification.progress import PROGRESS, wrong_probability
from star_tracker.identification.searcher import Task
from star_tracker.maps.simulation import uniform_noise


@pytest.mark.parametrize(
    ("score", "rival", "expected"),
    [
        (3.5, -math.inf, 10**-3.5 / (1 + 10**-3.5)),
        (3.5, -2.0, (10**-3.5 + 10**-5.5) / (1 + 10**-3.5 + 10**-5.5)),
        (3.5, 3.5, (1 + 10**-3.5) / (2 + 10**-3.5)),
        (0.0, -math.inf, 0.5),
        (-400.0, -math.inf, 1.0),
        (400.0, 380.0, 1e-20),
        (400.0, -math.inf, 0.0),
    ],
    ids=[
        "enough", "with a weak rival", "with an equal rival", "as likely as not", "hopeless",
        "beyond doubt, with a rival", "beyond doubt",
    ],
)
def test_probability_of_being_wrong(score, rival, expected):
    """Bayes' theorem for three explanations: this pose, its best rival and none."""
    progress = np.zeros(1, PROGRESS)
    progress["score"], progress["rival_score"] = score, rival
    found = of_record(progress)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-290)


@compiled
def of_record(progress):
    return wrong_probability(progress[0])


@pytest.mark.parametrize(
    ("n_matched", "n_in_view", "explains"), [(7, 30, False), (8, 30, True), (5, 15, True)]
)
def test_a_pose_explains_half_of_the_centroids_or_a_third_of_the_guide_stars(
    database, n_matched, n_in_view, explains
):
    bench = Bench(database)
    bench.show(uniform_noise(CAMERA, 16, np.random.default_rng(4)))
    bench.results.progress["n_matched"] = n_matched
    bench.results.progress["n_in_view"] = n_in_view
    assert bench.searcher.explains_its_view is explains


def searched(bench, task):
    """Go on to the end; return what was found."""
    while bench.searcher.ended == Ended.MORE:
        bench.searcher.go_on(task)
    return bench.searcher.ended, bench.searcher.score, bench.results.progress["n_judged"][0]


def test_a_search_that_time_has_stopped_goes_on_where_it_was(database):
    bench, xy = Bench(database), uniform_noise(CAMERA, 15, np.random.default_rng(4))
    task = Task(xy, np.empty(0), np.empty(len(xy), LABEL), time.perf_counter(), math.inf)
    bench.searcher.follow(task)
    whole = searched(bench, task)
    bench.searcher.follow(task)
    assert bench.searcher.ended == Ended.MORE
    place = [bench.results.progress[name][0] for name in ("level", "next_main")]
    bench.searcher.stop_at(time.perf_counter() - 1.0)
    for _ in range(3):
        bench.searcher.go_on(task)
        assert bench.searcher.ended == Ended.MORE
        assert [bench.results.progress[name][0] for name in ("level", "next_main")] == place
    bench.searcher.stop_at(math.inf)
    ended, score, n_judged = searched(bench, task)
    assert (ended, score) == whole[:2]
    # Each time that it was stopped it had judged one candidate of a main star, at the most.
    assert 0 <= n_judged - whole[2] <= 3


def test_the_next_frame_has_its_own_time(database):
    bench, xy = Bench(database), uniform_noise(CAMERA, 15, np.random.default_rng(4))
    task = Task(xy, np.empty(0), np.empty(len(xy), LABEL), time.perf_counter(), math.inf)
    bench.searcher.follow(task)
    bench.searcher.stop_at(time.perf_counter() - 1.0)
    bench.searcher.follow(task)
    assert bench.results.progress["stop_s"][0] == math.inf


def test_a_frame_whose_time_is_up_is_begun_and_can_be_gone_on_with(database):
    bench, xy = Bench(database), uniform_noise(CAMERA, 15, np.random.default_rng(4))
    task = Task(xy, np.empty(0), np.empty(len(xy), LABEL), time.perf_counter(), math.inf)
    bench.searcher.follow(task)
    whole = searched(bench, task)
    bench.searcher.follow(task, time.perf_counter() - 1.0)
    assert bench.searcher.ended == Ended.MORE
    assert bench.results.progress["n_judged"][0] <= 1
    assert (task.labels["catalog_index"] == -1).all()
    bench.searcher.stop_at(math.inf)
    assert searched(bench, task)[:2] == whole[:2]
