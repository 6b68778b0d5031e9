"""`star_tracker compile`: compile the solver ahead, so that no node does at its start.

For a Dockerfile, a flight image or systemd's ExecStartPre. The code is kept below NUMBA_CACHE_DIR,
or else in the user's cache folder; a folder that has been filled serves from a read-only medium.
"""

import argparse
import json
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from star_tracker.calibration.camera_estimator import CameraEstimator
from star_tracker.calibration.noise import StreamNoise
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.commands.options import add_json_argument
from star_tracker.compiled import CacheState, cache_state, mark_warm
from star_tracker.maps.star_map import paper_maps
from star_tracker.tracker import StarTracker

#: Between two lines of progress, s.
_PERIOD_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_json_argument(parser)


def execute(options: argparse.Namespace) -> None:
    """Compile. Raises ValueError where the code cannot be kept."""
    before = cache_state()
    if not before.writable and not before.warm:
        where = before.folder or "a home folder, which this user has not"
        raise ValueError(
            f"compiled code cannot be kept in {where}: set NUMBA_CACHE_DIR to a folder that can "
            "be written"
        )
    seconds = compile_solver(before)
    if options.json:
        record = {
            "folder": str(before.folder), "was_compiled": before.warm, "seconds": round(seconds, 1)
        }
        print(json.dumps(record, indent=2))
    elif before.warm:
        print(f"the solver is compiled, in {before.folder}")
    else:
        print(f"the solver was compiled in {seconds:.0f} s, and is kept in {before.folder}")


def compile_solver(before: CacheState) -> float:
    """Compile all that a node runs, or load it from the cache; return how long it took, s.

    Args:
        before: the cache as it is. Where it is not warm, standard error tells of the progress.
    """
    started = time.monotonic()
    with _telling(started, quiet=before.warm):
        exercise_solver()
        exercise_detector()
        mark_warm()
    return time.monotonic() - started


def exercise_solver() -> None:
    """Run all compiled code of the solver once, in half a second where it comes from the cache.

    What is not run here would be compiled, or loaded, while a frame waits.
    """
    (star_map,) = paper_maps((1,))
    camera, sky = star_map.camera, StarCatalog.paper()
    # The stars around the map's will do, and no file of features is needed for so few.
    middle = sky.vectors[np.isin(sky.number, star_map.star_number)].mean(axis=0)
    around = sky.subset(np.flatnonzero(sky.vectors @ middle > np.cos(2 * camera.radius_rad)))
    found = StarTracker(FeatureDatabase.build(around), camera).solve(star_map.xy_px)
    taught = StreamNoise()
    for _ in range(4):
        taught.add(found)
    camera.pixels(camera.vectors(star_map.xy_px))
    learnt = CameraEstimator(camera, tolerance=0.01)
    each = np.arange(len(star_map.xy_px))
    learnt.add_frame(star_map.xy_px, camera.vectors(star_map.xy_px), (each, each))
    bent = learnt.estimate.camera
    bent.pixels(bent.vectors(star_map.xy_px))


def exercise_detector() -> None:
    """Run all compiled code of the detector once, as `exercise_solver` does the solver's."""
    # Only here: identify_node comes for the solver, and would load what it does not need.
    from star_tracker.detection.detect import detect_stars  # noqa: PLC0415

    rows, columns = np.mgrid[:256, :256]  # half of it, a colour's, has rows that are long enough
    light = np.random.default_rng(0).normal(100.0, 5.0, (256, 256))
    # A lone star, one that is saturated, and two that share their pixels.
    for x, y, peak in ((16, 15, 400), (45, 18, 9000), (30, 45, 600), (33, 46, 500)):
        light += peak * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 3.4)
    image = np.clip(light, 0, 4095).astype(np.uint16)
    for bayer in ("", "rggb"):
        detect_stars(image, bayer=bayer)


@contextmanager
def _telling(started: float, quiet: bool) -> Iterator[None]:
    """Print how long the work has taken so far, at once and every ten seconds."""
    ended = threading.Event()

    def tell() -> None:
        while True:
            seconds = time.monotonic() - started
            print(f"compiling the solver, {seconds:.0f} s", file=sys.stderr, flush=True)
            if ended.wait(_PERIOD_S):
                return

    teller = threading.Thread(target=tell, daemon=True)
    if not quiet:
        teller.start()
    try:
        yield
    finally:
        ended.set()
        if not quiet:
            teller.join()
