"""How often frames of random attitude are solved, rightly and wrongly, under growing trouble.

`python benchmark/robustness.py [--frames N] [--method M]` prints the table of the README.
No deadline, no brightness; CPU time, one BLAS thread.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from star_tracker.catalog import StarCatalog
from star_tracker.database import FeatureDatabase
from star_tracker.evaluation import CAMERAS, CONDITIONS, score_condition
from star_tracker.solution import METHODS, SolveSettings
from star_tracker.tracker import StarTracker


def main() -> int:
    """Print a Markdown table with a row for each camera and condition."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=300, help="frames a condition")
    parser.add_argument("--seed", type=int, default=2019)
    parser.add_argument("--method", choices=("auto", *METHODS), default="auto")
    options = parser.parse_args()
    database = FeatureDatabase.build(StarCatalog.paper())
    settings = SolveSettings(method=options.method, deadline_ms=float("inf"))
    print("| camera | condition | correct % | wrong % | median ms | p95 ms |")
    print("|---|---|---|---|---|---|")
    for name, camera in CAMERAS.items():
        tracker = StarTracker(database, camera, settings)
        for condition in CONDITIONS:
            s = score_condition(tracker, condition, options.frames, options.seed)
            print(
                f"| {name} | {condition.name} | {s.correct_percent:.1f} | {s.wrong_percent:.1f} "
                f"| {s.median_ms:.1f} | {s.p95_ms:.1f} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
