"""Solve time on the eight star maps and the fraction of stars identified.

`python benchmark/solve_time.py [--repeat N] [--method M]`. CPU time of this
process, one BLAS thread; every solve starts lost in space.
"""

import argparse
import os
import platform
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numba
import numpy as np
import scipy

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.study.scoring import score_map
from star_tracker.solution import METHODS, SolveSettings
from star_tracker.maps.star_map import paper_maps
from star_tracker.tracker import StarTracker


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=300, help="solves a map")
    parser.add_argument("--method", choices=("auto", *METHODS), default="auto")
    options = parser.parse_args()
    settings = SolveSettings(method=options.method, deadline_ms=float("inf"))
    started = time.perf_counter()
    database = FeatureDatabase.build(StarCatalog.paper())
    pairs_built = time.perf_counter()
    n_bytes = database.patterns.packed.nbytes
    built = time.perf_counter()
    print(
        f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}, "
        f"numba {numba.__version__}; "
        f"{len(database.catalog)} stars, pairs built in {pairs_built - started:.2f} s "
        f"({database.pairs.nbytes / 1e6:.2f} MB), patterns in {built - pairs_built:.2f} s "
        f"({n_bytes / 1e6:.2f} MB); method {options.method}"
    )
    row = "{:>6} {:>6} {:>6} {:>10} {:>8}".format
    print(row("map", "stars", "right", "median ms", "p95 ms"))
    scores = {
        star_map.name: score_map(
            StarTracker(database, star_map.camera, settings), star_map, options.repeat
        )
        for star_map in paper_maps()
    }
    for name, s in scores.items():
        print(row(name, s.n, s.n_correct, f"{s.median_ms:.3f}", f"{s.p95_ms:.3f}"))
    every = np.concatenate([s.cpu_ms for s in scores.values()])
    median, p95 = np.percentile(every, [50, 95])
    n, right = (sum(getattr(s, key) for s in scores.values()) for key in ("n", "n_correct"))
    print(row("all", n, right, f"{median:.3f}", f"{p95:.3f}"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
