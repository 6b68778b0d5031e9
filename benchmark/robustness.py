"""How often frames of random attitude are solved, rightly and wrongly, under growing trouble.

`python benchmark/robustness.py [--frames N] [--seed S]` prints the table of the README.
No deadline, no brightness; CPU time, one BLAS thread.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.catalog import StarCatalog
from star_tracker.database import FeatureDatabase
from star_tracker.tracker import SolveSettings, StarTracker, Status
from benchmark.workload import CAMERAS, CONDITIONS, CORRECT_DEG, boresight_error_deg, frames


def main() -> int:
    """Print a Markdown table with a row for each camera and condition."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=300, help="frames a condition")
    parser.add_argument("--seed", type=int, default=2019)
    options = parser.parse_args()
    database = FeatureDatabase.build(StarCatalog.paper())
    print("| camera | condition | correct % | wrong % | median ms | p95 ms |")
    print("|---|---|---|---|---|---|")
    for name, camera in CAMERAS.items():
        tracker = StarTracker(database, camera, SolveSettings(deadline_ms=float("inf")))
        for condition in CONDITIONS:
            errors, times = [], []
            for frame in frames(
                database.catalog, camera, condition, options.frames, options.seed
            ):
                started = time.process_time()
                solution = tracker.solve(frame.xy_px)
                times.append(1e3 * (time.process_time() - started))
                if solution.status is Status.SOLVED:
                    errors.append(boresight_error_deg(solution, frame))
            correct = np.count_nonzero(np.array(errors) <= CORRECT_DEG)
            share = 100 / options.frames
            median, p95 = np.percentile(times, [50, 95])
            print(
                f"| {name} | {condition.name} | {correct * share:.1f} | "
                f"{(len(errors) - correct) * share:.1f} | {median:.1f} | {p95:.1f} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
