"""The evidence behind `max_log10_false_alarms` and behind what parity `auto` asks for.

`python benchmark/false_alarms.py [--frames N] [--method M]` counts right and wrong solutions below
each threshold where they are hardest to tell apart, and prints the best score that noise and a
real sky seen in a mirror reach in a full search.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.catalog import StarCatalog
from star_tracker.database import FeatureDatabase
from star_tracker.evaluation import CAMERAS, Condition, boresight_error_deg, frames
from star_tracker.solution import METHODS, SolveSettings, Status
from star_tracker.star_maps import uniform_noise
from star_tracker.tracker import StarTracker

HARDEST = (
    Condition("3 px", 3.0),
    Condition("3 px, 30 % missing, 50 % false", 3.0, 0.3, 0.5),
    Condition("2 px, 30 % missing, 100 % false", 2.0, 0.3, 1.0),
    Condition("1 px, 40 % missing, 100 % false", 1.0, 0.4, 1.0),
    Condition("0.5 px, 60 % missing", 0.5, 0.6),
)
THRESHOLDS = (0, -1, -2, -3, -4)
#: Noise of 3 px can put a right solution of few stars more than 0.1 deg off: that is not wrong.
RIGHT_DEG = 0.5


def main() -> int:
    """Print the three tables; the first solution below 0 counts for each frame."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=300, help="frames a condition")
    parser.add_argument("--method", choices=METHODS, default="match_group")
    options = parser.parse_args()
    n, method = options.frames, options.method
    database = FeatureDatabase.build(StarCatalog.paper())
    camera = CAMERAS["12 deg"]
    anything = SolveSettings(method=method, deadline_ms=float("inf"), max_log10_false_alarms=0)
    nothing = SolveSettings(method=method, deadline_ms=float("inf"), max_log10_false_alarms=-100)
    print(f"12 deg, {n} frames a condition: right / wrong below a threshold of")
    print(f"{'':>34}" + "".join(f"{t:>12}" for t in THRESHOLDS))
    for condition in HARDEST:
        right, wrong = [], []
        tracker = StarTracker(database, camera, anything)
        for frame in frames(database.catalog, camera, condition, n, seed=11):
            solution = tracker.solve(frame.xy_px)
            if solution.status is Status.SOLVED:
                good = boresight_error_deg(solution, frame) < RIGHT_DEG
                (right if good else wrong).append(solution.log10_false_alarms)
        counts = [(np.less(right, t).sum(), np.less(wrong, t).sum()) for t in THRESHOLDS]
        print(f"{condition.name:>34}" + "".join(f"{f'{r} / {w}':>12}" for r, w in counts))
    rng = np.random.default_rng(1)
    for name, camera in CAMERAS.items():
        tracker = StarTracker(database, camera, nothing)
        scores = [
            tracker.solve(uniform_noise(camera, int(rng.integers(5, 40)), rng)).log10_false_alarms
            for _ in range(n)
        ]
        print(f"{name}: best scores of {n} frames of noise {np.round(np.sort(scores)[:3], 1)}")
        mirrored = StarTracker(database, camera.with_parity("mirrored"), nothing)
        scores = [
            mirrored.solve(frame.xy_px).log10_false_alarms
            for frame in frames(database.catalog, camera, Condition("mirror", 0.5), n, seed=5)
        ]
        print(f"{name}: best scores of {n} mirrored skies {np.round(np.sort(scores)[:3], 1)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
