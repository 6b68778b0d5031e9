"""What a stream gains by what its frames teach, and what a sudden change does to it.

`python benchmark/stream.py [--frames N]`: streams of the 12 deg camera, each frame of exactly so
many true stars at a random attitude, with so many false stars, first each alone (`StarTracker`),
then as a stream (`LearningTracker`). Printed are the solved share, wrong solutions (more than
0.1 deg, or four times the noise, off), the median of the standard deviation about the boresight's
two axes in units of that of the lone frames, and the share of errors above the 99 % bound (NEES).
Then streams that change after 50 frames: noise three times as large, ten times as many false
stars, another part of the sky. At last streams that see no sky after 50 good frames: noise,
clumps, lines, grids, other stars, the sky in a mirror (`trouble.py`).
"""

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.spatial.transform import Rotation

from trouble import KINDS, NO_SKY

from star_tracker.calibration.learning import LearningTracker, Sources
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import (
    CAMERAS, CORRECT_DEG, CORRECT_NOISES, Condition, random_rotation, synthetic_field,
    uniform_noise
)
from star_tracker.solution import Solution, SolveSettings
from star_tracker.tracker import StarTracker

#: The 99 % bound of chi-square with 3 degrees of freedom.
BOUND = 11.345
CAMERA = CAMERAS["12 deg"]
#: So long that other programs on the machine do not matter: a search takes 0.2 s of CPU at most.
DEADLINE_MS = 60_000.0
#: Frames before a change, and after it in one row of the table each.
BEFORE, ROWS = 50, ((0, 3), (3, 10), (10, 50))


@dataclass(frozen=True)
class Kind:
    """What frames show: true stars, None = all, false ones, and the noise, px."""

    stars: int | None
    false_stars: int
    noise_px: float

    def frame(self, catalog: StarCatalog, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return centroids (n, 2) and the true rotation."""
        least = self.stars or 6
        while True:
            view = synthetic_field(
                catalog, CAMERA, random_rotation(rng), rng, Condition(noise_px=self.noise_px)
            )
            if len(view.xy_px) >= least:
                seen = rng.permutation(view.xy_px)[: self.stars]
                false = uniform_noise(CAMERA, self.false_stars, rng)
                return np.concatenate([seen, false]), view.rotation


@dataclass(frozen=True)
class Verdict:
    """How a frame ended: its error and its standard deviation, rad, NaN where it is unsolved."""

    nees: float
    wrong: bool
    deviation: float


def verdict(solution: Solution, true: Floats, noise_px: float) -> Verdict:
    """Hold a solution against the truth."""
    if solution.attitude is None:
        return Verdict(float("nan"), False, float("nan"))
    covariance = solution.attitude.covariance_rad2
    deviation = float(np.sqrt(covariance[0, 0] + covariance[1, 1]))
    error = Rotation.from_matrix(solution.attitude.rotation.T @ true).as_rotvec()
    noise_deg = np.degrees(noise_px / CAMERA.focal_length_px)
    wrong = np.degrees(np.hypot(*error[:2])) > max(CORRECT_DEG, CORRECT_NOISES * noise_deg)
    return Verdict(float(error @ np.linalg.solve(covariance, error)), bool(wrong), deviation)


def text(found: list[Verdict], alone: list[Verdict] | None = None) -> str:
    """Return the cells of a row."""
    nees = np.array([v.nees for v in found])
    solved = np.isfinite(nees)
    above = 100 * np.mean(nees[solved] > BOUND) if solved.any() else float("nan")
    row = f"{100 * np.mean(solved):.1f} | {sum(v.wrong for v in found)} | {above:.2f}"
    if alone is None:
        return row
    ratios = [a.deviation / b.deviation for a, b in zip(found, alone, strict=True)]
    return f"{row} | {np.nanmedian(ratios):.2f}" if solved.any() else f"{row} | "


class Bench:
    """What solves the frames."""

    def __init__(self) -> None:
        self.database = FeatureDatabase.build(StarCatalog.paper())
        self.settings = SolveSettings(method="match_group", deadline_ms=DEADLINE_MS)
        self.alone = StarTracker(self.database, CAMERA, self.settings)

    def stream(self) -> LearningTracker:
        """Return a tracker that knows nothing yet."""
        return LearningTracker(
            Sources(lambda _: self.database, list), replace(CAMERA), self.settings
        )

    def taught(self, kind: Kind, rng: np.random.Generator) -> LearningTracker:
        """Return a tracker that has seen so many frames of a kind."""
        tracker = self.stream()
        for _ in range(BEFORE):
            tracker.solve(kind.frame(self.database.catalog, rng)[0])
        return tracker


def gains(bench: Bench, n: int) -> Iterator[str]:
    """Yield the rows of streams that do not change."""
    yield "| stars | false | noise px | alone: solved % | wrong | above 99 % | stream | wrong " \
        "| above 99 % | deviation |\n|---|---|---|---|---|---|---|---|---|---|"
    for stars in (4, 5, 6, 8):
        for false_stars in (0, 2, 5):
            for noise_px in (0.1, 0.3, 1.0):
                kind = Kind(stars, false_stars, noise_px)
                rng = np.random.default_rng([stars, false_stars, int(10 * noise_px)])
                stream, alone, learnt = bench.stream(), [], []
                for _ in range(n):
                    xy, true = kind.frame(bench.database.catalog, rng)
                    alone.append(verdict(bench.alone.solve(xy), true, noise_px))
                    learnt.append(verdict(stream.solve(xy), true, noise_px))
                yield f"| {stars} | {false_stars} | {noise_px} | {text(alone)} | " \
                    f"{text(learnt, alone)} |"


CHANGES = {
    "noise x 3": (Kind(None, 2, 0.3), Kind(None, 2, 0.9)),
    "noise x 3, 5 stars": (Kind(5, 0, 0.3), Kind(5, 0, 0.9)),
    "noise / 3, 5 stars": (Kind(5, 0, 0.9), Kind(5, 0, 0.3)),
    "false stars x 10": (Kind(None, 3, 0.3), Kind(None, 30, 0.3)),
    "false stars x 10, 6 stars": (Kind(6, 2, 0.3), Kind(6, 20, 0.3)),
    "all stars, then 5": (Kind(None, 0, 0.3), Kind(5, 0, 0.3)),
}


def changes(bench: Bench, n: int) -> Iterator[str]:
    """Yield the rows of streams that change, by how many frames ago that was."""
    yield "| change | frames after it | alone: solved % | wrong | above 99 % | stream | wrong | " \
        "above 99 % | deviation |\n|---|---|---|---|---|---|---|---|---|"
    for at, (name, (before, after)) in enumerate(CHANGES.items()):
        rng = np.random.default_rng([7, at])
        alone, learnt = {row: [] for row in ROWS}, {row: [] for row in ROWS}
        for _ in range(max(n // 20, 1)):
            stream = bench.taught(before, rng)
            for row in ROWS:
                for _ in range(*row):
                    xy, true = after.frame(bench.database.catalog, rng)
                    alone[row].append(verdict(bench.alone.solve(xy), true, after.noise_px))
                    learnt[row].append(verdict(stream.solve(xy), true, after.noise_px))
        for row in ROWS:
            yield f"| {name} | {row[0]} to {row[1]} | {text(alone[row])} | " \
                f"{text(learnt[row], alone[row])} |"


def nothing(bench: Bench, n: int) -> str:
    """Return how many frames that show no sky were solved after good ones."""
    wrong, total, kinds = 0, 0, sorted(NO_SKY)
    for seed in range(max(n // 40, 1)):
        rng = np.random.default_rng([11, seed])
        good = Kind(None, int(rng.integers(0, 10)), float(rng.uniform(0.1, 1.0)))
        stream = bench.taught(good, rng)
        for _ in range(40):
            scene = KINDS[kinds[total % len(kinds)]](CAMERA, bench.database.catalog, rng)
            wrong += stream.solve(scene.xy_px, deadline_ms=1000.0).attitude is not None
            total += 1
    return f"{wrong} of {total} frames without a sky after {BEFORE} good frames are solved"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=400, help="for each row")
    parser.add_argument("--only", choices=("gains", "changes", "noise"))
    options = parser.parse_args()
    bench = Bench()
    if options.only in (None, "gains"):
        for row in gains(bench, options.frames):
            print(row, flush=True)
    if options.only in (None, "changes"):
        for row in changes(bench, options.frames):
            print(row, flush=True)
    if options.only in (None, "noise"):
        print(nothing(bench, options.frames))
    return 0


if __name__ == "__main__":
    sys.exit(main())
