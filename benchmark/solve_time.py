"""Solve time on the eight star maps and the fraction of stars identified.

`make benchmark`, or `python benchmark/solve_time.py [--repeat N]`. CPU time of this process, one
BLAS thread; every solve starts lost in space.
"""

import argparse
import os
import platform
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import scipy

from star_tracker.catalog import StarCatalog
from star_tracker.database import FeatureDatabase
from star_tracker.star_maps import StarMap, paper_maps
from star_tracker.tracker import Status, StarTracker


def measure(database: FeatureDatabase, star_map: StarMap, repeat: int) -> tuple[np.ndarray, int]:
    """Return the CPU times (repeat,) of solving a map, ms, and how many labels are right."""
    tracker = StarTracker(database, star_map.camera)
    times = np.empty(repeat)
    for i in range(-5, repeat):  # the first rounds fill caches and are overwritten
        started = time.process_time_ns()
        solution = tracker.solve(star_map.xy_px)
        times[i] = (time.process_time_ns() - started) / 1e6
    index = solution.identification.catalog_index
    numbers = np.where(index >= 0, database.catalog.number[index], 0)
    right = int((numbers == star_map.star_number).sum())
    return times, right if solution.status is Status.SOLVED else 0


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=300, help="solves a map")
    repeat = parser.parse_args().repeat
    started = time.perf_counter()
    database = FeatureDatabase.build(StarCatalog.paper())
    built = time.perf_counter() - started
    print(
        f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}; "
        f"database of {len(database.catalog)} stars built in {built:.2f} s"
    )
    print(f"{'map':>6} {'stars':>6} {'right':>6} {'median ms':>10} {'p95 ms':>8}")
    every, total, right = [], 0, 0
    for star_map in paper_maps():
        times, n_right = measure(database, star_map, repeat)
        every.append(times)
        total, right = total + len(star_map.labels), right + n_right
        median, p95 = np.percentile(times, [50, 95])
        print(
            f"{star_map.name:>6} {len(star_map.labels):>6} {n_right:>6} "
            f"{median:>10.2f} {p95:>8.2f}"
        )
    median, p95 = np.percentile(np.concatenate(every), [50, 95])
    print(f"{'all':>6} {total:>6} {right:>6} {median:>10.2f} {p95:>8.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
