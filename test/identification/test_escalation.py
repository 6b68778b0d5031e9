"""After the first stretch of a search: who has his turn, and what is doubted, by scripted ones.

The searchers here do as they are told, and each step of theirs takes a millisecond of a clock of
the test's own; test_tracker.py and test_parity.py have the same with real ones.
"""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from engines import rotation_to

from star_tracker.identification import escalation as module
from star_tracker.identification.ended import Ended
from star_tracker.identification.escalation import Escalation
from star_tracker.identification.search import Limits
from star_tracker.identification.searcher import Task

LIMITS = Limits(8.0, 3.0, 10.0, 20_000.0, 40.0)
HERE, THERE = rotation_to(10.0, 20.0), rotation_to(200.0, -30.0)
MORE, EXHAUSTED, SOLVED = (Ended.MORE, -math.inf), (Ended.EXHAUSTED, -math.inf), (Ended.SOLVED, 20)


class Bench:
    """A clock and a record of what is done in turn."""

    def __init__(self, monkeypatch):
        self.now_ms, self.done = 0.0, []
        clock = SimpleNamespace(perf_counter=lambda: self.now_ms / 1e3)
        monkeypatch.setattr(module, "time", clock)

    def step(self, name):
        self.now_ms += 1.0
        self.done.append(name)

    def task(self, deadline_ms=math.inf):
        return Task(np.zeros((6, 2)), np.empty(0), np.zeros(6), 0.0, deadline_ms)

    def searcher(self, name, *steps, **options):
        return Scripted(self, name, steps, **options)


class Scripted:
    """A searcher whose steps end as told, each (how, score); the last one is repeated."""

    def __init__(self, bench, name, steps, *, parity="normal", rival=-math.inf, rotation=HERE):
        self._bench, self._name, self._steps = bench, name, [*steps]
        self.camera = SimpleNamespace(
            parity=parity, tolerance_percent=0.0, fov_deg=12.0,
            scaled=lambda scale: SimpleNamespace(fov_deg=12.0 / scale),
        )
        self.scale_is_told, self.scale, self.contradicts_the_told_scale = True, 1.0, False
        self.rival_score, self.rotation, self.n_hypotheses = rival, rotation, 100
        self.labelled_as, self.explains_its_view = Ended.SOLVED, True
        self.certain = 0.0  # from which evidence a candidate of the fallback is certain
        self.ended, self.score = Ended.MORE, -math.inf

    def _next(self):
        self.ended, self.score = self._steps.pop(0) if len(self._steps) > 1 else self._steps[0]

    def follow(self, task, stop_s=math.inf):
        self._bench.step(f"{self._name} follows")
        self._next()

    def go_on(self, task):
        self._bench.step(f"{self._name} goes on")
        self._next()

    def begun(self):
        """As a tracker hands it over: its first stretch is done."""
        self._next()
        return self

    def stop_at(self, stop_s):
        pass

    def judge(self, task, candidate):
        self._bench.step(f"{self._name} judges {candidate}")
        self.score = max(self.score, candidate)
        return candidate > LIMITS.certain

    def label(self, task):
        self._bench.step(f"{self._name} labels")
        self.ended = self.labelled_as

    def field(self):
        return self._name


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def run(bench, asked, mirrors=(), *, deadline_ms=math.inf, **options):
    return Escalation(asked, mirrors, LIMITS, **options).run(bench.task(deadline_ms))


# Who has his turn


def test_a_search_goes_on_until_it_is_exhausted(bench):
    one = bench.searcher("one", MORE, MORE, MORE, (Ended.EXHAUSTED, 1.0)).begun()
    verdict = run(bench, [one])
    assert bench.done == ["one goes on"] * 3
    assert (verdict.ended, verdict.best) == (Ended.EXHAUSTED, one)
    assert verdict.reason == "the best of 100 hypotheses has log10 false alarms -1.0"


def test_what_is_solved_is_labelled_already(bench):
    one = bench.searcher("one", MORE, MORE, SOLVED).begun()
    verdict = run(bench, [one])
    assert bench.done == ["one goes on"] * 2
    assert (verdict.ended, verdict.best, verdict.reason) == (Ended.SOLVED, one, "")


def test_the_other_parity_follows_before_the_first_goes_on(bench):
    one = bench.searcher("one", MORE, SOLVED).begun()
    other = bench.searcher("other", SOLVED, parity="mirrored")
    verdict = run(bench, [one, other])
    assert bench.done == ["other follows"]
    assert verdict.best is other
    assert verdict.n_hypotheses == 200


def test_both_parities_go_on_in_turn(bench):
    one = bench.searcher("one", MORE, MORE, EXHAUSTED).begun()
    other = bench.searcher("other", MORE, MORE, MORE, SOLVED, parity="mirrored")
    assert run(bench, [one, other]).best is other
    assert bench.done == [
        "other follows", "one goes on", "other goes on", "one goes on", "other goes on",
        "other goes on",
    ]


@pytest.mark.parametrize("deadline_ms", [3.5, 10.5])
def test_a_search_ends_with_the_step_that_meets_the_deadline(bench, deadline_ms):
    one = bench.searcher("one", MORE, (Ended.MORE, 1.25)).begun()
    verdict = run(bench, [one], deadline_ms=deadline_ms)
    assert verdict.ended == Ended.MORE
    assert verdict.reason == (
        f"deadline {deadline_ms:g} ms passed, the best of 100 hypotheses has "
        "log10 false alarms -1.2"
    )
    assert bench.now_ms == math.ceil(deadline_ms)


# The fallback


def candidates(bench, name, *steps):
    """What the fallback proposes: for each step a candidate or None."""
    for n, step in enumerate(steps, start=1):
        bench.step(f"fallback of {name}")
        yield 10 * n, step


def test_the_fallback_has_its_turn_after_the_primary(bench):
    one = bench.searcher("one", MORE, MORE, EXHAUSTED).begun()
    verdict = run(
        bench, [one], fallback=lambda field: candidates(bench, field, None, 1.0, None, 9.0, 2.0)
    )
    assert bench.done == [
        "one goes on", "one goes on", "fallback of one", "fallback of one", "one judges 1.0",
        "fallback of one", "fallback of one", "one judges 9.0", "one labels",
    ]
    assert (verdict.ended, verdict.best) == (Ended.SOLVED, one)
    # 100 of the primary, 40 of the fallback.
    assert verdict.n_hypotheses == 140


def test_the_fallback_looks_at_both_parities_in_turn(bench):
    one, other = (
        bench.searcher(name, EXHAUSTED, parity=parity).begun()
        for name, parity in (("one", "normal"), ("other", "mirrored"))
    )
    steps = {"one": (1.0, 2.0), "other": (1.5, 1.0, 9.0)}
    verdict = run(
        bench, [one, other], fallback=lambda field: candidates(bench, field, *steps[field])
    )
    judged = [step for step in bench.done if "judges" in step]
    assert judged == [
        "one judges 1.0", "other judges 1.5", "one judges 2.0", "other judges 1.0",
        "other judges 9.0",
    ]
    assert verdict.best is other
    assert verdict.n_hypotheses == 200 + 20 + 30


def test_a_pose_that_is_enough_needs_no_fallback(bench):
    one = bench.searcher("one", (Ended.EXHAUSTED, 5.0)).begun()
    mirror = bench.searcher("mirror", EXHAUSTED, parity="mirrored")
    verdict = run(
        bench, [one], [mirror], fallback=lambda field: candidates(bench, field, 9.0)
    )
    assert verdict.ended == Ended.SOLVED
    assert "fallback of one" not in bench.done


def test_the_primary_makes_way_at_half_of_the_deadline_and_has_what_is_left(bench):
    one = bench.searcher("one", MORE, MORE).begun()
    verdict = run(
        bench, [one], deadline_ms=20.0, fallback=lambda field: candidates(bench, field, None, 1.0)
    )
    assert bench.done == [
        *["one goes on"] * 11, "fallback of one", "fallback of one", "one judges 1.0",
        *["one goes on"] * 7,
    ]
    assert verdict.ended == Ended.MORE


def test_a_fallback_that_meets_the_deadline_is_a_timeout(bench):
    one = bench.searcher("one", EXHAUSTED).begun()
    verdict = run(
        bench, [one], deadline_ms=5.0,
        fallback=lambda field: candidates(bench, field, *[1.0] * 50),
    )
    assert verdict.ended == Ended.MORE
    assert bench.now_ms == 6
    assert verdict.reason.startswith("deadline 5 ms passed, the best of 130 hypotheses")


def test_where_the_fallback_searches_alone_the_primary_does_not_before_it(bench):
    one = bench.searcher("one", EXHAUSTED).begun()
    run(bench, [one], primary=False, fallback=lambda field: candidates(bench, field, 9.0))
    assert bench.done == ["fallback of one", "one judges 9.0", "one labels"]


# Doubt


def doubted(bench, score, mirror_score, **options):
    one = bench.searcher("one", (Ended.EXHAUSTED, score), **options).begun()
    mirror = bench.searcher("mirror", MORE, (Ended.EXHAUSTED, mirror_score), parity="mirrored")
    return run(bench, [one], [mirror])


@pytest.mark.parametrize("mirror_score", [-math.inf, 4.0, 5.0, 5.009])
def test_a_pose_that_is_enough_is_solved_where_the_mirror_image_fits_no_better(
    bench, mirror_score
):
    verdict = doubted(bench, 5.0, mirror_score)
    assert (verdict.ended, verdict.reason) == (Ended.SOLVED, "")
    assert bench.done == ["mirror follows", "mirror goes on", "one labels"]


@pytest.mark.parametrize("mirror_score", [5.02, 7.0, 30.0])
def test_a_pose_whose_mirror_image_fits_better_is_ambiguous(bench, mirror_score):
    verdict = doubted(bench, 5.0, mirror_score)
    assert verdict.ended == Ended.AMBIGUOUS
    assert verdict.reason == (
        "the mirror image of the sky fits better: set parity to mirrored"
    )
    assert "one labels" not in bench.done


@pytest.mark.parametrize(("rival", "ended"), [(1.9, Ended.SOLVED), (2.1, Ended.AMBIGUOUS)])
def test_another_pose_that_is_weaker_by_what_is_enough_is_no_rival(bench, rival, ended):
    verdict = doubted(bench, 5.0, -math.inf, rival=rival)
    assert verdict.ended == ended
    assert verdict.reason == ("" if ended == Ended.SOLVED else (
        "two attitudes fit about as well: a frame with more stars tells them apart"
    ))


def test_a_pose_that_is_not_enough_is_not_doubted(bench):
    one = bench.searcher("one", (Ended.EXHAUSTED, 2.9)).begun()
    mirror = bench.searcher("mirror", EXHAUSTED, parity="mirrored")
    assert run(bench, [one], [mirror]).ended == Ended.EXHAUSTED
    assert bench.done == []


def test_a_pose_that_is_certain_is_not_doubted(bench):
    """Of a frame of many stars the search wants more than that and goes on to its end."""
    one = bench.searcher("one", (Ended.EXHAUSTED, 8.1)).begun()
    mirror = bench.searcher("mirror", EXHAUSTED, parity="mirrored")
    assert run(bench, [one], [mirror]).ended == Ended.SOLVED
    assert bench.done == ["one labels"]


@pytest.mark.parametrize(("rival", "ended"), [(5.0, Ended.SOLVED), (5.2, Ended.AMBIGUOUS)])
def test_a_pose_that_is_certain_has_to_lead_too(bench, rival, ended):
    """Of a frame that agrees with no pose as a whole two parts may each carry one."""
    verdict = doubted(bench, 8.1, -math.inf, rival=rival)
    assert verdict.ended == ended


@pytest.mark.parametrize(("explains", "ended"), [(True, Ended.SOLVED), (False, Ended.MORE)])
def test_a_part_of_the_image_carries_no_pose_when_the_time_is_up(bench, explains, ended):
    one = bench.searcher("one", (Ended.MORE, 15.0)).begun()
    one.explains_its_view = explains
    verdict = run(bench, [one], deadline_ms=3.0)
    assert verdict.ended == ended


def test_a_pose_that_has_outlasted_the_search_may_explain_little(bench):
    one = bench.searcher("one", (Ended.EXHAUSTED, 15.0)).begun()
    one.explains_its_view = False
    assert run(bench, [one]).ended == Ended.SOLVED


@pytest.mark.parametrize("score", [8.1, 5.0], ids=["certain", "enough"])
def test_a_pose_that_its_own_stars_contradict_is_none(bench, score):
    one = bench.searcher("one", (Ended.EXHAUSTED, score)).begun()
    one.labelled_as = Ended.CONTRADICTED
    verdict = run(bench, [one], [bench.searcher("mirror", EXHAUSTED, parity="mirrored")])
    assert verdict.ended == Ended.EXHAUSTED
    assert verdict.reason == (
        "the stars disagree with the camera: correct its field of view and lens, or give the "
        "field of view a tolerance (fov_tolerance_percent)"
    )


def test_a_pose_that_the_search_itself_found_contradicted_is_not_labelled_again(bench):
    one = bench.searcher("one", (Ended.CONTRADICTED, 20.0)).begun()
    one.camera.tolerance_percent = 5.0
    verdict = run(bench, [one])
    assert verdict.ended == Ended.EXHAUSTED
    assert verdict.reason == (
        "the stars disagree with the camera: correct its lens, or calibrate it"
    )
    assert bench.done == []


def freed(bench, ended, score, *, scale=1.0):
    """The searcher of the same camera with another focal length."""
    other = bench.searcher("freed", (ended, score))
    other.scale, other.contradicts_the_told_scale = scale, scale != 1.0
    return other


def test_a_pose_of_another_focal_length_ends_the_search(bench):
    one = bench.searcher("one", MORE).begun()
    other = freed(bench, Ended.SOLVED, 20.0, scale=0.95)
    verdict = run(bench, [one], freed=[other], fallback=lambda field: [])
    assert (verdict.ended, verdict.best) == (Ended.SOLVED, other)
    assert verdict.n_hypotheses == 200
    assert bench.done == ["freed follows"]


@pytest.mark.parametrize("ended", [Ended.SOLVED, Ended.MORE, Ended.EXHAUSTED, Ended.CONTRADICTED])
def test_one_that_agrees_with_the_told_focal_length_leaves_the_frame_to_the_search(bench, ended):
    one = bench.searcher("one", MORE, SOLVED).begun()
    verdict = run(bench, [one], freed=[freed(bench, ended, 20.0)])
    assert (verdict.ended, verdict.best) == (Ended.SOLVED, one)
    assert bench.done == ["freed follows", "one goes on"]


def test_other_focal_lengths_have_no_turn_once_the_time_is_up(bench):
    one = bench.searcher("one", EXHAUSTED).begun()
    bench.step("a look at the clock")
    assert run(bench, [one], freed=[freed(bench, *SOLVED)], deadline_ms=0.5).ended == Ended.MORE
    assert bench.done == ["a look at the clock"]


@pytest.mark.parametrize("primary", [True, False])
@pytest.mark.parametrize(("rival", "ended"), [(12.9, Ended.SOLVED), (13.1, Ended.EXHAUSTED)])
def test_stars_far_from_their_places_give_way_to_another_focal_length(
    bench, rival, ended, primary
):
    one = bench.searcher("one", (Ended.FAR, 10.0)).begun()
    one.labelled_as = Ended.FAR
    other = freed(bench, Ended.MORE, rival, scale=0.9)  # labelled as SOLVED
    verdict = run(
        bench, [one], freed=[other], primary=primary, fallback=None if primary else lambda _: []
    )
    assert (verdict.ended, verdict.best) == (ended, one)
    # The frame bears the labels of the told camera, not of its rival.
    assert ended == Ended.EXHAUSTED or bench.done[-1] == "one labels"
    assert verdict.reason == ("" if ended == Ended.SOLVED else (
        "the stars contradict the field of view of 12 deg, about 13.3 deg fits better: correct "
        "fov_deg, or give it a tolerance (fov_tolerance_percent)"
    ))


@pytest.mark.parametrize(("rotation", "ended"), [
    (HERE, Ended.SOLVED), (THERE, Ended.AMBIGUOUS),
], ids=["the same", "another"])
def test_a_stronger_pose_of_the_told_focal_length_is_no_other_camera(bench, rotation, ended):
    """The fallback judges with narrow gates: of noisy frames another search finds more stars."""
    one = bench.searcher("one", (Ended.FAR, 10.0)).begun()
    one.labelled_as = Ended.FAR
    other = freed(bench, Ended.MORE, 20.0)
    other.rotation = rotation
    verdict = run(bench, [one], freed=[other])
    assert (verdict.ended, verdict.best) == (ended, one)
    if ended == Ended.SOLVED:
        assert bench.done[-2:] == ["freed labels", "one labels"]


def test_the_fallback_alone_is_not_helped_by_the_primary(bench):
    one = bench.searcher("one", EXHAUSTED).begun()
    other = freed(bench, Ended.SOLVED, 20.0, scale=0.95)
    verdict = run(bench, [one], freed=[other], primary=False, fallback=lambda field: [])
    assert verdict.ended == Ended.EXHAUSTED
    assert "freed follows" not in bench.done


def test_stars_far_from_their_places_need_a_second_look(bench):
    one = bench.searcher("one", (Ended.FAR, 10.0)).begun()
    one.labelled_as = Ended.FAR
    bench.step("a look at the clock")
    verdict = run(bench, [one], freed=[freed(bench, *MORE)], deadline_ms=0.5)
    assert verdict.ended == Ended.MORE
    assert verdict.reason == (
        "deadline 0.5 ms passed, the best of 100 hypotheses has log10 false alarms -10.0"
    )


def test_the_time_that_is_left_is_used_where_a_part_of_the_image_is_all_that_is_explained(bench):
    """The primary makes way at half of the deadline; its pose is none to be content with."""
    one = bench.searcher("one", *[(Ended.MORE, 15.0)] * 11, (Ended.EXHAUSTED, 15.0)).begun()
    one.explains_its_view = False
    verdict = run(bench, [one], deadline_ms=12.0, fallback=lambda field: [])
    assert verdict.ended == Ended.SOLVED
    assert bench.done == ["one goes on"] * 11 + ["one labels"]


def test_a_mirror_image_that_is_not_searched_to_the_end_is_a_timeout(bench):
    one = bench.searcher("one", (Ended.EXHAUSTED, 5.0)).begun()
    mirror = bench.searcher("mirror", MORE, parity="mirrored")
    verdict = run(bench, [one], [mirror], deadline_ms=4.0)
    assert verdict.ended == Ended.MORE
    assert verdict.reason == (
        "deadline 4 ms passed, the best of 100 hypotheses has log10 false alarms -5.0"
    )
    assert "one labels" not in bench.done


@pytest.mark.parametrize(("lead", "ended"), [
    (0.0, Ended.AMBIGUOUS), (3.9, Ended.AMBIGUOUS), (4.1, Ended.SOLVED),
])
def test_where_the_parity_is_not_told_one_of_them_needs_a_lead(bench, lead, ended):
    one = bench.searcher("one", (Ended.EXHAUSTED, 7.5 - lead)).begun()
    other = bench.searcher("other", (Ended.EXHAUSTED, 7.5), parity="mirrored")
    verdict = run(bench, [one, other])
    assert verdict.ended == ended
    assert verdict.best is (one if lead == 0 else other)
    if ended == Ended.AMBIGUOUS:
        assert verdict.reason == (
            "the sky and its mirror image fit about as well: set parity to normal or mirrored"
        )
    else:
        assert bench.done[-1] == "other labels"


# Several cameras


@pytest.mark.parametrize(("rotation", "ended"), [
    (HERE, Ended.SOLVED), (THERE, Ended.AMBIGUOUS),
])
def test_another_camera_that_finds_the_same_attitude_is_no_rival(bench, rotation, ended):
    """Two steps of a ladder overlap: the same stars fit at the end of one and of the next."""
    searchers = [
        bench.searcher("wide", (Ended.EXHAUSTED, 5.0)).begun(),
        bench.searcher("narrow", (Ended.EXHAUSTED, 4.9), rotation=rotation),
    ]
    mirrors = [
        bench.searcher(f"mirror {at}", EXHAUSTED, parity="mirrored") for at in range(2)
    ]
    verdict = run(bench, searchers, mirrors)
    assert verdict.ended == ended
    assert verdict.best is searchers[0]


def test_the_mirror_image_is_that_of_the_camera_with_the_best_pose(bench):
    searchers = [
        bench.searcher("wide", EXHAUSTED).begun(),
        bench.searcher("narrow", (Ended.EXHAUSTED, 5.0)),
    ]
    mirrors = [
        bench.searcher("mirror of wide", EXHAUSTED, parity="mirrored"),
        bench.searcher("mirror of narrow", (Ended.EXHAUSTED, 6.0), parity="mirrored"),
    ]
    assert run(bench, searchers, mirrors).ended == Ended.AMBIGUOUS
    assert bench.done == ["narrow follows", "mirror of narrow follows"]


@pytest.mark.parametrize("n", [1, 2, 5])
def test_hypotheses_of_all_searchers_are_counted(bench, n):
    searchers = [
        bench.searcher(str(at), EXHAUSTED, parity=parity)
        for at, parity in zip(range(n), itertools.cycle(("normal", "mirrored")))
    ]
    searchers[0].begun()
    assert run(bench, searchers).n_hypotheses == 100 * n


def test_hypotheses_of_the_frame_before_are_not_counted(bench):
    """The second has solved the frame, so that the third, of 100 hypotheses, has no turn."""
    searchers = [
        bench.searcher("first", MORE).begun(),
        bench.searcher("second", SOLVED, parity="mirrored"), bench.searcher("third", EXHAUSTED),
    ]
    verdict = run(bench, searchers)
    assert verdict.best is searchers[1]
    assert verdict.n_hypotheses == 200
