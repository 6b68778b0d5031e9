"""Seeded frames of growing trouble, and how a tracker's solutions of them are scored."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from star_tracker.camera import Camera
from star_tracker.catalog import StarCatalog
from star_tracker.solution import Solution
from star_tracker.spherical import Floats, separation
from star_tracker.star_maps import StarMap, SyntheticField, random_rotation, synthetic_field
from star_tracker.tracker import StarTracker

CAMERAS = {
    "12 deg": Camera.from_fov(12, 512, 512),
    "20 deg": Camera.from_fov(20, 1024, 1024),
}
#: A solution whose boresight is farther than this from the true one is wrong.
CORRECT_DEG = 0.1
#: With much noise a right solution of few stars can be farther off; one that is farther than so
#: many standard deviations of the centroid noise is wrong.
_CORRECT_NOISES = 4.0


@dataclass(frozen=True)
class Condition:
    """Noise per axis, px; fraction of stars missing; false stars per true star."""

    name: str
    noise_px: float
    missing: float = 0.0
    false_stars: float = 0.0

    @property
    def short_name(self) -> str:
        """What stands before the colon of the name, for narrow tables."""
        return self.name.split(":")[0]

    def correct_deg(self, camera: Camera) -> float:
        """Return the boresight error up to which a solution is correct."""
        noise_deg = float(np.degrees(self.noise_px / camera.focal_length_px))
        return max(CORRECT_DEG, _CORRECT_NOISES * noise_deg)


CONDITIONS = (
    Condition("clean", 0.0),
    Condition("0.5 px", 0.5),
    Condition("1 px", 1.0),
    Condition("2 px", 2.0),
    Condition("3 px", 3.0),
    Condition("5 px", 5.0),
    Condition("m40: 40 % missing", 0.0, 0.4),
    Condition("m60: 60 % missing", 0.0, 0.6),
    Condition("f100: 100 % false", 0.0, 0.0, 1.0),
    Condition("f200: 200 % false", 0.0, 0.0, 2.0),
    Condition("comb: 0.5 px, 20 % missing, 50 % false", 0.5, 0.2, 0.5),
    Condition("hard: 1 px, 40 % missing, 100 % false", 1.0, 0.4, 1.0),
    Condition("sparse: 0.5 px, 60 % missing", 0.5, 0.6),
)


@dataclass(frozen=True)
class Score:
    """How a tracker did on `n` frames (or, for a star map, on the stars of one frame).

    Attributes:
        n: number of frames, or of the map's stars.
        n_correct: frames with a correct attitude, or stars with the right number.
        n_wrong: frames with a wrong attitude, or stars with a wrong number.
        cpu_ms: (m,) CPU times of the solves.
    """

    n: int
    n_correct: int
    n_wrong: int
    cpu_ms: Floats

    @property
    def correct_percent(self) -> float:
        """Share of correct frames or stars."""
        return 100.0 * self.n_correct / self.n

    @property
    def wrong_percent(self) -> float:
        """Share of wrong frames or stars: worse than those of which nothing is said."""
        return 100.0 * self.n_wrong / self.n

    @property
    def median_ms(self) -> float:
        """Median CPU time of a solve."""
        return float(np.median(self.cpu_ms))

    @property
    def p95_ms(self) -> float:
        """CPU time that 95 % of the solves keep within."""
        return float(np.percentile(self.cpu_ms, 95))


def frames(
    catalog: StarCatalog, camera: Camera, condition: Condition, n: int,
    seed: int | np.random.SeedSequence,
) -> Iterator[SyntheticField]:
    """Yield `n` frames at random attitudes; the same seed gives the same frames."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield synthetic_field(
            catalog, camera, random_rotation(rng), rng, noise_px=condition.noise_px,
            missing=condition.missing, false_stars=condition.false_stars,
        )


def boresight_angle_deg(found: Floats, true: Floats) -> float:
    """Return the angle between the boresights of two rotations (3, 3), camera to ICRS, degrees."""
    return float(np.degrees(separation(found[:, 2], true[:, 2])))


def boresight_error_deg(solution: Solution, frame: SyntheticField) -> float:
    """Return the angle between the true and the found boresight, degrees; NaN if unsolved."""
    if solution.attitude is None:
        return float("nan")
    return boresight_angle_deg(solution.attitude.rotation, frame.rotation)


def timed_solve(
    tracker: StarTracker, xy_px: Floats, intensity: Floats | None = None
) -> tuple[Solution, float]:
    """Solve one frame; return the solution and the CPU time that it took, ms."""
    started = time.process_time_ns()
    solution = tracker.solve(xy_px, intensity)
    return solution, (time.process_time_ns() - started) / 1e6


def score_map(tracker: StarTracker, star_map: StarMap, repeat: int) -> Score:
    """Solve a star map `repeat` times and count its labels."""
    tracker.solve(star_map.xy_px)  # fills caches
    solved = [timed_solve(tracker, star_map.xy_px) for _ in range(repeat)]
    index = solved[-1][0].identification.catalog_index
    numbers = np.where(index >= 0, tracker.database.catalog.number[index], 0)
    right = numbers == star_map.star_number
    return Score(
        len(right), int(right.sum()), int((~right & (numbers > 0)).sum()),
        np.array([cpu_ms for _, cpu_ms in solved]),
    )
