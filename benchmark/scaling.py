"""How time and memory grow with the catalogue and with the number of centroids.

`python benchmark/scaling.py [--frames N]`: catalogues of 4908 (the paper's), about 15,000 and
41,411 stars; a field of 12 deg over 2048 px that shows its brightest stars, filled up with false
ones to 15, 50, 150 and 300 centroids, 0.5 px. CPU time, one BLAS thread.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.optics.camera import Camera
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.solution import SolveSettings
from star_tracker.geometry.spherical import Floats, separation
from star_tracker.maps.simulation import (
    CORRECT_DEG, random_rotation, uniform_noise, visible_stars
)
from star_tracker.tracker import StarTracker

CAMERA = Camera.from_fov(12, 2048, 2048)
CENTROIDS = (15, 50, 150, 300)
#: Catalogue and the largest separation of its pairs, deg.
CATALOGS = (
    (StarCatalog.paper(), 12.0),
    (StarCatalog.hipparcos(limiting_magnitude=7.02, min_separation_deg=0.0), 12.0),
    (StarCatalog.hipparcos(limiting_magnitude=8.0, min_separation_deg=0.0), 6.0),
)


def field(catalog: StarCatalog, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return `n` centroids, the brightest stars of a random field first, and its rotation."""
    rotation = random_rotation(rng)
    index, pixels = visible_stars(catalog, CAMERA, rotation)
    brightest = pixels[np.argsort(catalog.v_mag[index])][:n]
    brightest = brightest + rng.normal(0.0, 0.5, brightest.shape)
    return np.concatenate([brightest, uniform_noise(CAMERA, n - len(brightest), rng)]), rotation


def main() -> int:
    """Print a Markdown table with a row for each catalogue and number of centroids."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=100, help="frames a row")
    options = parser.parse_args()
    StarTracker(FeatureDatabase.build(CATALOGS[0][0]), CAMERA)  # compiles
    head = "stars", "pairs to", "build s", "MB", "centroids", "right %", "wrong %", "median ms"
    print("| " + " | ".join((*head, "p95 ms")) + " |", "|" + "---|" * 9, sep="\n")
    for catalog, max_separation_deg in CATALOGS:
        started = time.process_time()
        database = FeatureDatabase.build(catalog, max_separation_deg=max_separation_deg)
        _ = database.triangles
        built = time.process_time() - started
        n_bytes = database.nbytes
        tracker = StarTracker(
            database, CAMERA, SolveSettings(method="match_group", deadline_ms=1000)
        )
        for n in CENTROIDS:
            rng = np.random.default_rng(n)
            errors, times = [], []
            for _ in range(options.frames):
                xy, rotation = field(catalog, n, rng)
                before = time.process_time_ns()
                solution = tracker.solve(xy)
                times.append((time.process_time_ns() - before) / 1e6)
                if solution.attitude is not None:
                    found = solution.attitude.rotation[:, 2]
                    errors.append(np.degrees(separation(found, rotation[:, 2])))
            right = 100 * np.mean(np.array(errors) <= CORRECT_DEG) * len(errors) / options.frames
            wrong = 100 * np.sum(np.array(errors) > CORRECT_DEG) / options.frames
            median, p95 = np.percentile(times, [50, 95])
            print(
                f"| {len(catalog)} | {max_separation_deg:g} deg | {built:.2f} "
                f"| {n_bytes / 1e6:.1f} | {n} | {right:.1f} | {wrong:.1f} "
                f"| {median:.3f} | {p95:.3f} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
