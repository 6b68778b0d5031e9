"""What suits each field of view: depth, stars a field, size, time to build and to load.

    python benchmark/depth.py [--catalog gaia] [--fields N]

One row for each field of view and one for each step of the ladder from 4 to 70 deg, as in
docs/catalogues.md. Images have 1024 x 768 px. Times are CPU seconds; patterns are not included.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import ladder
from star_tracker.maps.simulation import random_rotation, visible_stars
from star_tracker.optics.camera import Camera

SIZE_PX = (1024, 768)
FIELDS_DEG = {
    "hipparcos": (4, 6, 8, 12, 20, 30, 45, 70), "gaia": (1.5, 2, 3, 4, 5, 6),
}
SEED = 4


def timed(make: Callable[[], FeatureDatabase]) -> tuple[FeatureDatabase, str]:
    """Return a database, and the CPU seconds that it and its triangles took."""
    started = time.process_time()
    database = make()
    made = time.process_time()
    _ = database.triangles
    return database, f"{made - started:.2f} + {time.process_time() - made:.2f}"


def row(camera: Camera, make: Callable[[], FeatureDatabase], n_fields: int) -> str:
    """Return a row of the table; `make` builds at its first call and loads at its second."""
    (database, build_s), (_, load_s) = timed(make), timed(make)
    rng = np.random.default_rng(SEED)
    counts = [
        len(visible_stars(database.catalog, camera, random_rotation(rng))[0])
        for _ in range(n_fields)
    ]
    low, median, high = np.percentile(counts, (5, 50, 95))
    depth = database.catalog.description.split(", ")[1].split(" ")[-1]
    return (
        f"| {depth} | {len(database.catalog)} | {low:.0f} / {median:.0f} / {high:.0f} "
        f"| {np.degrees(database.pairs.max_separation_rad):.1f} "
        f"| {database.pairs.nbytes / 1e6:.0f} | {database.nbytes / 1e6:.0f} "
        f"| {build_s} | {load_s.split(' ')[0]} |"
    )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--catalog", choices=FIELDS_DEG, default="hipparcos")
    parser.add_argument("--fields", type=int, default=2000, help="random fields (%(default)s)")
    options = parser.parse_args()
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()
    head = (
        "depth | stars | in a field: p5 / median / p95 | pairs to, deg | pairs, MB | all, MB "
        "| build + triangles, s | load, s |"
    )
    print(f"| field, deg | {head}\n|{'---|' * 9}")
    for fov_deg in FIELDS_DEG[options.catalog]:
        camera = Camera.from_fov(fov_deg, *SIZE_PX)

        def of_camera(camera: Camera = camera) -> FeatureDatabase:
            return FeatureDatabase.for_camera(
                camera, catalog=options.catalog, with_patterns=False
            )

        print(f"| {fov_deg:g} {row(camera, of_camera, options.fields)}", flush=True)
    if options.catalog == "gaia":
        return
    print(f"\n| fields, deg | {head}\n|{'---|' * 9}")
    for place, step in enumerate(ladder((4.0, 70.0), SIZE_PX)):

        def of_step(place: int = place) -> FeatureDatabase:
            return ladder((4.0, 70.0), SIZE_PX)[place].database

        span = f"{step.fov_min_deg:.1f} to {step.fov_max_deg:.1f}"
        print(f"| {span} {row(step.camera, of_step, options.fields)}", flush=True)


if __name__ == "__main__":
    main()
