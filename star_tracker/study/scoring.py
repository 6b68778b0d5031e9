"""How a tracker's solutions of simulated frames and star maps are scored."""

import time
from dataclasses import dataclass

import numpy as np

from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import SyntheticField, boresight_angle_deg
from star_tracker.maps.star_map import StarMap
from star_tracker.solution import Solution
from star_tracker.tracker import StarTracker


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
