"""The seeded frames that the benchmarks share, and how a solution is scored."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from star_tracker.camera import Camera
from star_tracker.catalog import StarCatalog
from star_tracker.spherical import separation
from star_tracker.star_maps import SyntheticField, random_rotation, synthetic_field
from star_tracker.tracker import Solution

CAMERAS = {
    "12 deg": Camera.from_fov(12, 512, 512),
    "20 deg": Camera.from_fov(20, 1024, 1024),
}


@dataclass(frozen=True)
class Condition:
    """Noise per axis, px; fraction of stars missing; false stars per true star."""

    name: str
    noise_px: float
    missing: float = 0.0
    false_stars: float = 0.0


CONDITIONS = (
    Condition("clean", 0.0),
    Condition("0.5 px", 0.5),
    Condition("1 px", 1.0),
    Condition("3 px", 3.0),
    Condition("m40: 0.5 px, 40 % missing", 0.5, 0.4),
    Condition("m60: 0.5 px, 60 % missing", 0.5, 0.6),
    Condition("f100: 0.5 px, 100 % false", 0.5, 0.0, 1.0),
    Condition("f200: 0.5 px, 200 % false", 0.5, 0.0, 2.0),
    Condition("comb: 0.5 px, 20 % missing, 50 % false", 0.5, 0.2, 0.5),
    Condition("hard: 1 px, 40 % missing, 100 % false", 1.0, 0.4, 1.0),
)
#: A solution whose boresight is farther than this from the true one is wrong.
CORRECT_DEG = 0.1


def frames(
    catalog: StarCatalog, camera: Camera, condition: Condition, n: int, seed: int
) -> Iterator[SyntheticField]:
    """Yield `n` frames at random attitudes; the same seed gives the same frames."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield synthetic_field(
            catalog, camera, random_rotation(rng), rng, noise_px=condition.noise_px,
            missing=condition.missing, false_stars=condition.false_stars,
        )


def boresight_error_deg(solution: Solution, frame: SyntheticField) -> float:
    """Return the angle between the true and the found boresight, degrees; NaN if unsolved."""
    if solution.attitude is None:
        return float("nan")
    found = solution.attitude.rotation[:, 2]
    return float(np.degrees(separation(found, frame.rotation[:, 2])))
