"""After the first stretch of a search: the other parity, another focal length, patience, doubt."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from star_tracker.identification.ended import MIN_STARS_OF_A_SCALE, Ended
from star_tracker.identification.fallback import StarField, Steps
from star_tracker.identification.labels import StarState
from star_tracker.identification.search import SAME_POSE_RAD, Limits
from star_tracker.identification.searcher import Searcher, Task

#: Where the parity is known the other one has to fit better by more than rounding to raise doubt.
#: Where it is not, a solution that is not certain needs this lead over the other parity's.
_MIRROR_LEAD = 0.01
_PARITY_LEAD = 4.0
#: With both matchers, the share of the deadline after which the primary makes way.
_PRIMARY_SHARE = 0.5
#: Ends of a searcher whose best pose has been labelled with success or without, and those of one
#: that was labelled as far as it goes without its rivals.
_LABELLED = Ended.SOLVED, Ended.CONTRADICTED
_SETTLED = Ended.CERTAIN, Ended.FAR, Ended.CONTRADICTED
_TWO_ATTITUDES = "two attitudes fit about as well: a frame with more stars tells them apart"

Candidates = Callable[[StarField], Steps]


@dataclass(frozen=True)
class Verdict:
    """How a frame ended.

    Attributes:
        ended: SOLVED, EXHAUSTED, AMBIGUOUS, or MORE where the time was up.
        best: the searcher with the best pose.
        n_hypotheses: how many hypotheses were compared.
        reason: a sentence, empty where solved.
    """

    ended: Ended
    best: Searcher
    n_hypotheses: int
    reason: str = ""


class Escalation:
    """Goes on with a frame that its first searcher has begun and not solved.

    Args:
        asked: the searchers that may solve it, that which has begun first.
        mirrors: for each of them one that looks at the mirror image of the sky to raise doubt;
            empty where both parities are asked for.
        freed: for each of them one whose focal length may be off, which has a short turn: it
            solves frames that contradict the told one, and raises doubt where the stars lie far
            from their places. Empty where the focal length is not told as exact.
        limits: when a search ends.
        fallback: candidates of the second matcher for a field, or None.
        primary: whether the primary matcher searches; else the fallback does alone.
    """

    def __init__(
        self, asked: Sequence[Searcher], mirrors: Sequence[Searcher], limits: Limits, *,
        freed: Sequence[Searcher] = (), fallback: Candidates | None = None, primary: bool = True,
    ) -> None:
        self._asked, self._mirrors, self._freed, self._limits = asked, mirrors, freed, limits
        self._fallback, self._primary = fallback, primary
        self._n_begun, self._n_freed = 1, 0  # searchers that have had a turn with the frame

    def run(self, task: Task) -> Verdict:
        """Solve a frame, or say why not."""
        self._n_begun, self._n_freed = 1, 0
        n_hypotheses = self._search_on(task)
        begun, freed = self._asked[: self._n_begun], self._freed[: self._n_freed]
        n_hypotheses += sum(one.n_hypotheses for one in (*begun, *freed))
        for one in (*begun, *freed):
            if one.ended == Ended.SOLVED and (one in begun or one.contradicts_the_told_scale):
                return Verdict(Ended.SOLVED, one, n_hypotheses)
        best = max(begun, key=lambda one: one.score)
        found = f"the best of {n_hypotheses} hypotheses has log10 false alarms {-best.score:.1f}"
        in_time = len(begun) == len(self._asked) and all(
            one.ended != Ended.MORE for one in begun
        ) and (len(freed) == len(self._freed) or not self._primary)
        ended, reason = self._weighed(best, task, in_time=in_time)
        if ended == Ended.SOLVED:
            ended, reason = self._labelled(best, task)
        if ended == Ended.EXHAUSTED:
            reason = reason or found
        elif ended == Ended.MORE:
            reason = f"deadline {task.deadline_ms:g} ms passed, {found}"
        return Verdict(ended, best, n_hypotheses, reason)

    def _weighed(self, best: Searcher, task: Task, *, in_time: bool) -> tuple[Ended, str]:
        """Return how the best pose of no searcher that has solved the frame compares with others.

        SOLVED where it beats them all; a sentence where its rivals say why not.
        """
        # Found by the fallback, or certain but for the other centroids when the time was up. What
        # is certain and yet not solved fits in a mirror as well, or was labelled already.
        if best.ended not in _SETTLED and self._is_certain(best, in_time=in_time):
            best.label(task)
        if best.ended in (*_LABELLED, Ended.FAR):
            return Ended.SOLVED, ""
        if not in_time:
            return Ended.MORE, ""
        if best.score > self._limits.enough:
            return self._doubt(best, task)
        return Ended.EXHAUSTED, ""

    def _labelled(self, best: Searcher, task: Task) -> tuple[Ended, str]:
        """Label a frame with the pose that has beaten all others, if its stars stay with it."""
        if best.ended not in _LABELLED:
            best.label(task)
        if best.ended == Ended.FAR:
            return self._doubt_focal_length(best, task)
        if best.ended == Ended.CONTRADICTED:
            return Ended.EXHAUSTED, _disagreement(best)
        if not best.scale_is_told and _n_identified(task) < MIN_STARS_OF_A_SCALE:
            return Ended.EXHAUSTED, (
                f"{_n_identified(task)} stars agree, {MIN_STARS_OF_A_SCALE} are needed where "
                "the field of view is not known"
            )
        return Ended.SOLVED, ""

    def _is_certain(self, one: Searcher, *, in_time: bool) -> bool:
        """Return whether a pose may be labelled that the search has not labelled itself."""
        return (
            one.score > max(self._limits.certain, one.rival_score + self._limits.enough)
            and (in_time or one.explains_its_view)
        )

    def _search_on(self, task: Task) -> int:
        """Let the primary go on, the fallback have its turn, and the primary what time is left.

        Ends where something is solved. Returns the hypotheses that the fallback has compared.
        """
        for other in self._asked[1:]:
            if time.perf_counter() > task.deadline_s:
                return 0
            self._n_begun += 1
            other.follow(task, task.deadline_s)
            if other.ended == Ended.SOLVED:
                return 0
        if self._primary and self._try_other_focal_lengths(task):
            return 0
        if self._fallback is None:
            self._exhaust(self._asked, task, task.deadline_s)
            return 0
        if self._primary:
            share_s = _PRIMARY_SHARE * task.deadline_ms / 1e3
            self._exhaust(self._asked, task, task.started_s + share_s)
        n_fallback = 0
        if max(one.score for one in self._asked) <= self._limits.enough:
            n_fallback = self._fall_back(self._fallback, task)
        solved = any(self._is_certain(one, in_time=False) for one in self._asked)
        if not solved and time.perf_counter() < task.deadline_s:
            self._exhaust(self._asked, task, task.deadline_s)
        return n_fallback

    def _try_other_focal_lengths(self, task: Task) -> bool:
        """Search shortly with the focal length free; return whether that ends the whole search.

        It does where a pose contradicts the told one, or where the time is up. Where the camera is
        another one most frames have such a pose at once.
        """
        for other in self._freed:
            if time.perf_counter() > task.deadline_s:
                return True
            self._n_freed += 1
            other.follow(task, task.deadline_s)
            if other.ended == Ended.SOLVED and other.contradicts_the_told_scale:
                return True
        return False

    def _exhaust(self, searchers: Sequence[Searcher], task: Task, deadline_s: float) -> None:
        """Go on in turn until a search has solved the frame, all have ended or time is up.

        Those that time has stopped have still ended with MORE.
        """
        for one in searchers:
            one.stop_at(deadline_s)
        while any(one.ended == Ended.MORE for one in searchers):
            for one in searchers:
                if time.perf_counter() > deadline_s:
                    return
                if one.ended == Ended.MORE:
                    one.go_on(task)
                if one.ended == Ended.SOLVED:
                    return

    def _doubt(self, best: Searcher, task: Task) -> tuple[Ended, str]:
        """Hold a pose that is good enough, but not certain, against its rivals."""
        if self._mirrors:
            other = self._mirrors[self._asked.index(best)]
            other.follow(task, task.deadline_s)
            self._exhaust([other], task, task.deadline_s)
            if other.ended == Ended.MORE:
                return Ended.MORE, ""
        else:
            mirrored = [one for one in self._asked if one.camera.parity != best.camera.parity]
            other = max(mirrored, key=lambda one: one.score)
            if other.score > best.score - _PARITY_LEAD:
                return Ended.AMBIGUOUS, (
                    "the sky and its mirror image fit about as well: "
                    "set parity to normal or mirrored"
                )
        if other.score > best.score + _MIRROR_LEAD:
            return Ended.AMBIGUOUS, (
                f"the mirror image of the sky fits better: set parity to {other.camera.parity}"
            )
        rival_score = max(
            one.score if _elsewhere(one, best) else one.rival_score
            for one in self._asked if one.camera.parity == best.camera.parity
        )
        if rival_score > best.score - self._limits.enough:
            return Ended.AMBIGUOUS, _TWO_ATTITUDES
        return Ended.SOLVED, ""

    def _doubt_focal_length(self, best: Searcher, task: Task) -> tuple[Ended, str]:
        """Hold a pose whose stars lie far from their places against those of other focal lengths.

        It is labelled, and stays so where it has no such rival.
        """
        if not self._primary:  # they have not had their turn
            self._try_other_focal_lengths(task)
        if self._n_freed < len(self._freed):
            return Ended.MORE, ""
        rival = max(self._freed, key=lambda one: one.score)
        if rival.score > best.score + self._limits.enough:
            rival.label(task)
            if rival.ended == Ended.SOLVED and rival.contradicts_the_told_scale:
                return Ended.EXHAUSTED, _disagreement(rival)
            if _elsewhere(rival, best):
                return Ended.AMBIGUOUS, _TWO_ATTITUDES
        best.label(task)  # the frame may bear another one's labels
        return Ended.SOLVED, ""

    def _fall_back(self, candidates: Candidates, task: Task) -> int:
        """Judge the candidates of the fallback; return how many hypotheses were compared."""
        n_compared = [0] * len(self._asked)
        sources = [candidates(one.field()) for one in self._asked]
        for steps in zip_longest(*sources):
            for at, step in enumerate(steps):
                if step is None:
                    continue
                one, (n_compared[at], candidate) = self._asked[at], step
                if candidate is not None and one.judge(task, candidate):
                    return sum(n_compared)
                if time.perf_counter() > task.deadline_s:
                    one.ended = Ended.MORE
                    return sum(n_compared)
        return sum(n_compared)


def _disagreement(best: Searcher) -> str:
    """Say what may be wrong with a camera whose stars do not stay with the pose that they gave."""
    told = best.camera
    if best.scale_is_told and told.tolerance_percent == 0:
        if best.scale != 1.0:
            return (
                f"the stars contradict the field of view of {told.fov_deg:.4g} deg, about "
                f"{told.scaled(best.scale).fov_deg:.3g} deg fits better: correct fov_deg, or give "
                "it a tolerance (fov_tolerance_percent)"
            )
        return (
            "the stars disagree with the camera: correct its field of view and lens, or give the "
            "field of view a tolerance (fov_tolerance_percent)"
        )
    return "the stars disagree with the camera: correct its lens, or calibrate it"


def _n_identified(task: Task) -> int:
    return int(np.sum(task.labels["state"] == StarState.IDENTIFIED))


def _elsewhere(one: Searcher, best: Searcher) -> bool:
    """Return whether the best pose of a searcher is another one than that of the best."""
    trace = float(np.sum(one.rotation * best.rotation))
    return trace < 1 + 2 * math.cos(SAME_POSE_RAD)
