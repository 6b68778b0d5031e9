"""Where does the time of a solve go? Its steps, with full caches and with empty ones.

`python benchmark/solve_profile.py [--camera "12 deg"] [--condition clean] [--frames 400]`: medians
of wall-clock time, us. `alone`: the same frame was solved just before, so that code and tables are
in the fastest memory. `in turn`: another identifier (tetra3rs, where it is installed, else a walk
through 8 MB) has had a frame since, as in the study and in a process that does other things too.

The steps are told from each other by calls that do a part of the work:

- receive: what came is checked (`frame_solution.received`);
- call: arguments handed over to compiled code and back (a frame without centroids);
- frame: directions and orders of the centroids (the verb BEGIN, less the call);
- judge and label: from the pose to the labelled frame (TRACK with the found pose, less BEGIN);
- search: votes and candidates, and what is judged for nothing (FOLLOW, less TRACK);
- solution: the answer (`frame_solution.labelled`); parts that nobody reads are not made.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.compiled import machine_code
from star_tracker.frame_solution import labelled, received
from star_tracker.identification.labels import blank_labels
from star_tracker.identification.verbs import Verb, act
from star_tracker.maps.simulation import CAMERAS, CONDITIONS
from star_tracker.study.contestants import Told
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.peers import Tetra3
from star_tracker.study.scenes import Scene, Sky, simulated

_NAMED = {one.name: one for one in CONDITIONS}
_NOTHING = np.empty((0, 2)), np.empty(0)
STEPS = ("receive", "call", "frame", "judge and label", "search", "solution")


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
        self._tracker = OwnMethod().tracker(told.sky.database(), told)
        self._one = self._tracker.searchers[0]
        self._act = machine_code(act, self._one.engine, 0, _NOTHING, blank_labels(0))
        try:
            self._peer = Tetra3(pattern_max_error=0.01).set_up(told)
        except ModuleNotFoundError:
            self._peer = None
        self._walk = np.zeros(1 << 20)

    def frame(self, scene: Scene, *, in_turn: bool) -> list[float] | None:
        """Return the times of whole, steps and peer, us; None for a frame that is not solved."""
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
            disturb()
            times.append(timed(self._act, one.engine, verb.value, what, task.labels)[0])
        call, begin, track, follow = times
        disturb()
        one.follow(task)
        answer = timed(labelled, task, one)[0]
        peer = np.nan
        if self._peer is not None:
            given = self._peer.prepare(scene)
            if in_turn:
                tracker.solve(xy)
            else:
                self._peer.solve(given)
            peer = timed(self._peer.solve, given)[0]
        return [
            whole, receive, call, begin - call, track - begin, follow - track, answer, peer
        ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--camera", default="12 deg", choices=tuple(CAMERAS))
    parser.add_argument("--condition", default="clean", choices=tuple(_NAMED))
    parser.add_argument("--frames", type=int, default=400)
    options = parser.parse_args()
    sky, camera = Sky(), CAMERAS[options.camera]
    condition = replace(_NAMED[options.condition], brightness_noise_mag=0.1)  # for the peer
    profile = Profile(Told.of(sky, camera, condition, 200.0))
    scenes = list(simulated(sky, camera, condition, options.frames, np.random.SeedSequence(77)))
    columns = {}
    for name, in_turn in (("alone", False), ("in turn", True)):
        found = [profile.frame(scene, in_turn=in_turn) for scene in scenes]
        columns[name] = np.median([one for one in found if one is not None], axis=0)
    print(f"{options.camera}, {options.condition}, median of {options.frames} frames, us")
    print(f"{'':<18}{'alone':>9}{'in turn':>9}")
    for at, row in enumerate(("whole solve", *STEPS, "tetra3rs .01")):
        print(f"{row:<18}" + "".join(f"{one[at]:9.1f}" for one in columns.values()))


if __name__ == "__main__":
    main()
