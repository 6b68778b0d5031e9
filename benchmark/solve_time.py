"""Solve time on the eight star maps and the fraction of stars identified.

`python benchmark/solve_time.py [--repeat N] [--method M]`. CPU time of this
process, one BLAS thread; every solve starts lost in space.
"""

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numba
import numpy as np
import scipy

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.study.chunks import IDENTIFIED, MapChunk
from star_tracker.study.own_methods import OwnMethod
from star_tracker.identification.searcher import METHODS
from star_tracker.maps.star_map import PAPER_MAPS


def line(row: Callable[..., str], name: str, outcomes: list[str], cpu_ms: list[float]) -> str:
    """Return a line of the table."""
    median, p95 = np.percentile(cpu_ms, [50, 95])
    right = outcomes.count(IDENTIFIED)
    return row(name, len(outcomes), right, f"{median:.3f}", f"{p95:.3f}")


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=300, help="solves a map")
    parser.add_argument("--method", choices=("auto", *METHODS), default="auto")
    options = parser.parse_args()
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
    contestant = OwnMethod(method=options.method)
    outcomes, times = [], []
    for number in PAPER_MAPS:
        chunk = MapChunk((contestant,), number, float("inf"), options.repeat)
        (found,) = chunk.solve()
        print(line(row, f"map {number}", found.outcomes, found.cpu_ms))
        outcomes += found.outcomes
        times += found.cpu_ms
    print(line(row, "all", outcomes, times))
    return 0


if __name__ == "__main__":
    sys.exit(main())
