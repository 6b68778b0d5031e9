"""How often a frame is solved where the field of view is known, told wrongly, or not told.

`python benchmark/any_camera.py [--frames N]`: the conditions of the benchmark at both cameras,
without brightness, for a field of view that is told exactly, 5 % wrong (within 6 %) and not at
all (4 to 70 deg). For each the share of the frames that carry enough evidence at their true
attitude and focal length (`bound`), then solved % / median ms / 95th percentile ms of CPU time,
and how many are wrong; and the share that is solved in a stream of these frames, whose camera is
learnt.
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.calibration.learning import LearningTracker, Sources
from star_tracker.catalogue.ladder import ladder
from star_tracker.compiled import compiled
from star_tracker.geometry.rotation import copy_rotation
from star_tracker.geometry.spherical import Floats
from star_tracker.identification import verbs
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.ended import MIN_STARS, MIN_STARS_OF_A_SCALE
from star_tracker.identification.search import judge_and_keep
from star_tracker.maps.simulation import (
    CAMERAS,
    CONDITIONS,
    Condition,
    SyntheticField,
    boresight_angle_deg,
    frames,
)
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings
from star_tracker.study.contestants import Told
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.scenes import Sky
from star_tracker.tracker import StarTracker

SKY, SEED, DEADLINE_MS = Sky(), 61, 2000.0
#: The true pose is judged with the tolerances of the search.
TOLERANCES_PX = np.array(MatchGroupSettings().pair_tolerance_px)
#: How much larger than the true field of view the one told is, percent; None = none is told.
TOLD = {"known": 0.0, "5 %": 5.0, "nothing": None}


def share(right: list[bool]) -> str:
    """Return percent, to three digits."""
    return f"{100 * sum(right) / len(right):.3g}"


def is_right(seen: SyntheticField, solution: Solution, limit_deg: float) -> bool:
    """Return whether a frame is solved rightly."""
    attitude = solution.attitude
    if attitude is None:
        return False
    return boresight_angle_deg(attitude.rotation, seen.rotation) <= limit_deg


@compiled
def evidence_at(engine: Any, xy_px: Floats, rotation: Floats, scale: float) -> tuple[float, int]:
    """Return the evidence of a pose in decades, and how many stars carry it.

    Nothing where the scale is not one of those that the engine searches.
    """
    verbs.begin(engine, xy_px, np.empty(0))
    pose, prior = engine.room.pose, engine.sky.scale_prior
    free, best, k = prior.log_range > 0.0, 0.0, 0
    if free and not prior.low <= np.log(scale) <= prior.high:
        return best, k
    for tolerance_px in TOLERANCES_PX:
        copy_rotation(rotation, pose.rotation)
        pose.scale, pose.free = scale, free
        score = judge_and_keep(engine, pose, tolerance_px)
        if score > best:
            best, k = score, engine.matches.n_best
    return best, k


def bound(camera: Camera, condition: Condition, fields: list[SyntheticField]) -> str:
    """Return the share of frames with evidence enough, their true pose and scale judged alone."""
    told, own = Told.of(SKY, camera, condition, DEADLINE_MS), OwnMethod("match_group")
    tracker: StarTracker | AnyCameraTracker
    if condition.fov_error_percent is None:
        tracker, least = own.any_camera_tracker(told), MIN_STARS_OF_A_SCALE
    else:
        tracker, least = own.tracker(SKY.database(), told), MIN_STARS
    enough = -tracker.settings.max_log10_false_alarms

    def has_enough(one: SyntheticField) -> bool:
        found = [
            evidence_at(
                searcher.engine, one.xy_px, one.rotation,
                camera.focal_length_px / searcher.camera.focal_length_px,
            ) for searcher in tracker.searchers
        ]
        return any(score > enough and k >= least for score, k in found)

    return share([has_enough(one) for one in fields])


def alone(camera: Camera, condition: Condition, fields: list[SyntheticField]) -> str:
    """Return a cell: share, times, and how many are wrong where any is."""
    entrant = OwnMethod("match_group").set_up(Told.of(SKY, camera, condition, DEADLINE_MS))
    limit_deg, right, wrong, times = condition.correct_deg(camera), [], 0, []
    for one in fields:
        started = time.process_time()
        solution = entrant.solve((one.xy_px, None))
        times.append(1e3 * (time.process_time() - started))
        right.append(is_right(one, solution, limit_deg))
        wrong += solution.attitude is not None and not right[-1]
    median, late = np.quantile(times, (0.5, 0.95))
    cell = f"{share(right)} / {median:.3g} / {late:.3g}"
    return f"{cell}, {wrong} wrong" if wrong else cell


def stream(camera: Camera, condition: Condition, fields: list[SyntheticField]) -> str:
    """Return the share that is solved one after the other, the camera learnt meanwhile."""
    told = Told.of(SKY, camera, condition, DEADLINE_MS)
    size_px = (camera.width_px, camera.height_px)
    sources = Sources(
        lambda _: SKY.database(), lambda: ladder(told.fov_range_deg, size_px, catalog="paper")
    )
    known = condition.fov_error_percent is not None
    start = replace(told.camera, tolerance_percent=told.fov_tolerance_percent) if known else None
    settings = SolveSettings(method="match_group", deadline_ms=DEADLINE_MS)
    tracker = LearningTracker(sources, start, settings, parity=camera.parity)
    limit_deg = condition.correct_deg(camera)
    return share([is_right(one, tracker.solve(one.xy_px), limit_deg) for one in fields])


def row(camera: Camera, condition: Condition, n: int) -> str:
    """Return the cells of a condition."""
    seed = np.random.SeedSequence([SEED, sum(map(ord, condition.name))])
    fields = list(frames(SKY.catalog(), camera, condition, n, seed))
    told = [replace(condition, fov_error_percent=error) for error in TOLD.values()]
    return " | ".join([
        *(bound(camera, one, fields) for one in told),
        *(alone(camera, one, fields) for one in told),
        *(stream(camera, one, fields) for one in told),
    ])


def main() -> None:
    """Print a table for each camera."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--conditions", default="", help="by commas; default: all")
    args = parser.parse_args()
    names = args.conditions.split(",") if args.conditions else [one.name for one in CONDITIONS]
    for name, camera in CAMERAS.items():
        heads = [f"{what}{told}" for what in ("bound, ", "", "stream, ") for told in TOLD]
        print(f"| {name} | {' | '.join(heads)} |\n|{'---|' * (len(heads) + 1)}")
        for condition in CONDITIONS:
            if condition.name in names:
                print(f"| {condition.name} | {row(camera, condition, args.frames)} |", flush=True)


if __name__ == "__main__":
    main()
