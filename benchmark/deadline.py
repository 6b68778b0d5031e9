"""How late is an answer? The time beyond the deadline, of frames of all conditions and worse.

`python benchmark/deadline.py [--frames N]`: frames of all conditions of the study, with six and 15
times as many false stars as true ones, and of noise, tight clumps and grids of 4 to 1000 points,
for both cameras, told exactly, told within 5 % and of any field of view, and with the fallback
alone, with deadlines of 5, 20 and 200 ms. Printed are, for each kind of search and deadline, how
many frames reached it, and the 50 %, 99 % and largest overrun: the CPU time that the frame took
after its deadline had passed, so that other programs on the machine do not count.
"""

import argparse
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import ladder
from star_tracker.commands.compile import exercise_solver
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import CAMERAS, CONDITIONS, Condition, frames, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

DEADLINES_MS = (5.0, 20.0, 200.0)
POINTS = (4, 8, 20, 50, 100, 300, 1000)
KINDS = ("exact", "told 5 %", "any", "exact, auto", "fallback")
MORE_FALSE = (Condition("f600", false_stars=6.0), Condition("f1500", false_stars=15.0))
#: The clock is read at the deadline by another thread. Where that is later than this, the frame is
#: solved again, so often at the most; what it is late is counted as overrun.
_SOON_S, _TRIES = 5e-4, 8


def scenes(catalog: StarCatalog, camera: Camera, n: int) -> Iterator[tuple[str, Floats]]:
    """Yield names and centroids."""
    for at, condition in enumerate((*CONDITIONS, *MORE_FALSE)):
        for frame in frames(catalog, camera, condition, n, np.random.SeedSequence([3, at])):
            yield condition.name, frame.xy_px
    w, h = camera.width_px, camera.height_px
    for points in POINTS:
        rng = np.random.default_rng(points)
        yield f"noise {points}", uniform_noise(camera, points, rng)
        yield f"clump {points}", rng.normal(0, 0.04 * w, (points, 2)) + np.array((w / 2, h / 2))
        side = int(np.ceil(points**0.5))
        x, y = np.meshgrid(np.linspace(0.02, 0.98, side), np.linspace(0.02, 0.98, side))
        yield f"grid {points}", (np.column_stack([x.ravel(), y.ravel()]) * (w, h))[:points]


def tracker(
    kind: str, database: FeatureDatabase, camera: Camera
) -> StarTracker | AnyCameraTracker:
    """Return what solves the frames."""
    if kind == "any":
        steps = ladder((4.0, 70.0), (camera.width_px, camera.height_px), catalog="paper")
        return AnyCameraTracker(steps)
    if kind == "fallback":
        return StarTracker(database, camera, SolveSettings(method="radial_cyclic"))
    if kind == "told 5 %":
        camera = replace(camera, tolerance_percent=5.0)
    return StarTracker(database, camera.with_parity("auto") if "auto" in kind else camera)


class Watch:
    """Reads the CPU clock of the thread that solves when a deadline passes.

    What other programs take of the processor is no work of ours: the overrun is the CPU time from
    the deadline to the answer.
    """

    def __init__(self) -> None:
        self._clock = time.pthread_getcpuclockid(threading.get_ident())
        self._asked: queue.Queue[float] = queue.Queue()
        self._read: queue.Queue[tuple[float, float]] = queue.Queue()
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        while True:
            at_s = self._asked.get()
            time.sleep(max(at_s - time.perf_counter(), 0.0))
            cpu_s = time.clock_gettime(self._clock)
            self._read.put((cpu_s, time.perf_counter() - at_s))

    def overrun_ms(
        self, solver: StarTracker | AnyCameraTracker, xy_px: Floats, deadline_ms: float
    ) -> float | None:
        """Return the overrun of a frame, NaN where it was in time, None where that was missed."""
        started = time.perf_counter()
        self._asked.put(started + deadline_ms / 1e3)
        solver.solve(xy_px, deadline_ms=deadline_ms)
        ended, cpu_s = time.perf_counter(), time.clock_gettime(self._clock)
        at_deadline_s, late_s = self._read.get()
        if ended < started + deadline_ms / 1e3:
            return float("nan")
        return 1e3 * (cpu_s - at_deadline_s + late_s) if late_s < _SOON_S else None


def main() -> int:
    """Print the table, and the latest frame of each row."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=10, help="of each condition")
    parser.add_argument("--kinds", default="; ".join(KINDS), help="of searches, by semicolons")
    options = parser.parse_args()
    exercise_solver()
    database = FeatureDatabase.build(StarCatalog.paper())
    sys.setswitchinterval(1e-5)
    watch = Watch()
    print("| search | deadline ms | frames that reached it | 50 % | 99 % | latest, ms | which |")
    print("|---|---|---|---|---|---|---|")
    for kind in options.kinds.split("; "):
        found: dict[float, list[tuple[float, str]]] = {each: [] for each in DEADLINES_MS}
        for name, camera in CAMERAS.items():
            solver = tracker(kind, database, camera)
            noise = uniform_noise(camera, 30, np.random.default_rng(0))
            solver.solve(noise)  # loads what it needs
            for scene, xy_px in scenes(database.catalog, camera, options.frames):
                for deadline_ms, late in found.items():
                    over = (watch.overrun_ms(solver, xy_px, deadline_ms) for _ in range(_TRIES))
                    took_ms = next((one for one in over if one is not None), None)
                    if took_ms is None:
                        continue
                    if np.isnan(took_ms):
                        break  # in time: a longer deadline changes nothing
                    late.append((took_ms, f"{name} {scene}"))
        for deadline_ms, late in found.items():
            late.sort()
            row = f"| {kind} | {deadline_ms:g} | {len(late)} |"
            if late:
                at = [late[int(q * (len(late) - 1))][0] for q in (0.5, 0.99, 1.0)]
                row += " |".join(f" {value:.2f}" for value in at) + f" | {late[-1][1]} |"
            print(row, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
