"""Where does the time of a solve go? Its steps, with caches full and empty, and its floor.

`python benchmark/solve_profile.py [--camera "12 deg"] [--condition clean] [--told 0] [--k1 0]
[--frames 400]`: medians of wall-clock time, us; `--told` is by how much the field of view told is
wrong, percent, or `unknown`, and `--k1` the first radial coefficient of a lens that is not told.
`alone`: the same frame was solved just before, so that code and tables are in the fastest memory.
`in turn`: another identifier (tetra3rs, where it is installed, else a walk through 8 MB) has had a
frame since, as in the study and in a process that does other things too.

The steps are told from each other by calls that do a part of the work:

- receive: what came is checked (`frame_solution.received`);
- call: arguments handed over to compiled code and back (a frame without centroids);
- frame: directions and orders of the centroids (the verb BEGIN, less the call);
- judge and label: from the pose to the labelled frame (TRACK with the found pose, less BEGIN);
- search: votes and candidates, and what is judged for nothing (FOLLOW, less TRACK);
- solution: the answer (`frame_solution.labelled`); parts that nobody reads are not made.

`again` is the whole once more: what it reads of the tables is nearer now than it was the first
time, as it is for the steps and for `foreseen`, the whole if the search left out the levels
(`plan.py`) before the one that solves this frame soonest: no order of these levels can have a
median below it. `no search` is what is left without any: the steps but for the search. Which level
solves how many frames follows.
"""

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.compiled import machine_code
from star_tracker.frame_solution import labelled, received
from star_tracker.identification.labels import blank_labels
from star_tracker.identification.verbs import Verb, act
from star_tracker.identification.ended import Ended
from star_tracker.maps.simulation import CAMERAS, CONDITIONS
from star_tracker.optics.camera import MOST_TOLERANCE_PERCENT
from star_tracker.study.contestants import Told
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.peers import Tetra3
from star_tracker.study.scenes import Scene, Sky, simulated
from star_tracker.tracker import StarTracker

_NAMED = {one.name: one for one in CONDITIONS}
_NOTHING = np.empty((0, 2)), np.empty(0)
STEPS = ("receive", "call", "frame", "judge and label", "search", "solution")
ROWS = ("whole solve", *STEPS, "again", "foreseen", "no search", "tetra3rs .01")


def timed(function: Callable[..., Any], *given: Any) -> tuple[float, Any]:
    """Return how long a call took, us, and what it returned."""
    started = time.perf_counter_ns()
    result = function(*given)
    return (time.perf_counter_ns() - started) / 1e3, result


class Profile:
    """Times of the steps of one tracker, and of its peer.

    Args:
        told: sky and camera.
    """

    def __init__(self, told: Told) -> None:
        own = OwnMethod()
        self._tracker: StarTracker | AnyCameraTracker
        if told.fov_tolerance_percent > MOST_TOLERANCE_PERCENT:
            self._tracker = own.any_camera_tracker(told)
        else:
            self._tracker = own.tracker(told.sky.database(), told)
        self._one = self._tracker.searchers[0]  # for the paper's catalogue the ladder has one step
        self._levels = self._one.engine.levels
        #: How many frames each level has solved; those that none has, by `len(levels)`.
        self.solved_by: Counter[int] = Counter()
        self._act = machine_code(act, self._one.engine, 0, _NOTHING, blank_labels(0))
        try:
            self._peer = Tetra3(pattern_max_error=0.01).set_up(told)
        except ModuleNotFoundError:
            self._peer = None
        self._walk = np.zeros(1 << 20)

    @contextmanager
    def _from_level(self, level: int) -> Iterator[None]:
        """Have the search leave out the levels before one."""
        most_n = self._levels["most_n"].copy()
        self._levels["most_n"][:level] = -1
        yield
        self._levels["most_n"] = most_n

    def _foreseen(self, xy_px: np.ndarray, disturb: Callable[[], None]) -> tuple[float, float]:
        """Return the time of a solve, and the shortest one over all levels to begin with, us."""
        times = []
        for level in range(len(self._levels)):
            with self._from_level(level):
                disturb()
                time_us, solution = timed(self._tracker.solve, xy_px)
            if solution.attitude is not None:
                times.append(time_us)
        return times[0], min(times)

    def frame(self, scene: Scene, *, in_turn: bool) -> list[float] | None:
        """Return the times of the rows, us; None for a frame that is not solved."""
        xy, tracker, one = scene.xy_px, self._tracker, self._one

        def disturb() -> None:
            if not in_turn:
                tracker.solve(xy)
            elif self._peer is None:
                self._walk += 1.0
            else:
                self._peer.solve(self._peer.prepare(scene))

        disturb()
        whole, solution = timed(tracker.solve, xy)
        if solution.attitude is None:
            return None
        disturb()
        receive, task = timed(received, xy, None, None, tracker.settings)
        given = task.xy_px, task.intensity
        times = []
        for verb, what in (
            (Verb.BEGIN, _NOTHING), (Verb.BEGIN, given), (Verb.TRACK, given), (Verb.FOLLOW, given),
        ):
            one.results.rotation[:] = solution.attitude.rotation
            one.results.progress["predicted_scale"] = solution.scale
            disturb()
            times.append(timed(self._act, one.engine, verb.value, what, task.labels)[0])
        call, begin, track, follow = times
        disturb()
        one.follow(task)
        by_level = int(one.results.progress["level"][0])
        self.solved_by[by_level if one.ended == Ended.SOLVED else len(self._levels)] += 1
        answer = timed(labelled, task, one)[0]
        again, foreseen = self._foreseen(xy, disturb)
        peer = np.nan
        if self._peer is not None:
            given = self._peer.prepare(scene)
            if in_turn:
                tracker.solve(xy)
            else:
                self._peer.solve(given)
            peer = timed(self._peer.solve, given)[0]
        return [
            whole, receive, call, begin - call, track - begin, follow - track, answer, again,
            foreseen, receive + track + answer, peer,
        ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--camera", default="12 deg", choices=tuple(CAMERAS))
    parser.add_argument("--condition", default="clean", choices=tuple(_NAMED))
    parser.add_argument("--told", default="0", help="error of the field of view, percent; unknown")
    parser.add_argument("--k1", type=float, default=0.0, help="of the lens, which is not told")
    parser.add_argument("--frames", type=int, default=400)
    options = parser.parse_args()
    sky, camera = Sky(), CAMERAS[options.camera]
    condition = replace(
        _NAMED[options.condition], brightness_noise_mag=0.1,  # for the peer
        fov_error_percent=None if options.told == "unknown" else float(options.told),
        lens_k1=options.k1,
    )
    profile = Profile(Told.of(sky, camera, condition, 200.0))
    scenes = list(simulated(sky, camera, condition, options.frames, np.random.SeedSequence(77)))
    columns, solved_by = {}, profile.solved_by
    for name, in_turn in (("alone", False), ("in turn", True)):
        found = [profile.frame(scene, in_turn=in_turn) for scene in scenes]
        columns[name] = np.median([one for one in found if one is not None], axis=0)
    print(
        f"{options.camera}, {options.condition}, field of view told {options.told} % wrong, k1 "
        f"{options.k1:g}, median of {options.frames} frames, us"
    )
    print(f"{'':<18}{'alone':>9}{'in turn':>9}")
    for at, row in enumerate(ROWS):
        print(f"{row:<18}" + "".join(f"{one[at]:9.1f}" for one in columns.values()))
    shares = [100 * solved_by[level] / solved_by.total() for level in range(max(solved_by) + 1)]
    print("solved by the levels, %: " + ", ".join(f"{share:.1f}" for share in shares))


if __name__ == "__main__":
    main()
