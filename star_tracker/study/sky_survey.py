"""How well fields all over the sky are solved; `figures.sky_map` draws it."""

import numpy as np

from star_tracker.figures.sky_map import Survey
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import Floats, ra_dec
from star_tracker.identification.ended import MIN_STARS
from star_tracker.maps.simulation import (
    Condition,
    boresight_angle_deg,
    synthetic_field,
    visible_stars,
)
from star_tracker.tracker import StarTracker

_GOLDEN_ANGLE_RAD = float(np.pi * (3 - np.sqrt(5)))


def fibonacci_lattice(n: int) -> Floats:
    """Return unit vectors (n, 3) spread evenly over the sphere.

    Equal steps of height, each a golden angle farther in right ascension (Gonzalez 2010,
    doi:10.1007/s11004-009-9257-x). Raises ValueError for no points.
    """
    if n < 1:
        raise ValueError("a lattice has at least one point")
    i = np.arange(n)
    z = 1 - (2 * i + 1) / n
    radius, ra = np.sqrt(1 - z * z), _GOLDEN_ANGLE_RAD * i
    return np.column_stack([radius * np.cos(ra), radius * np.sin(ra), z])


def survey(
    tracker: StarTracker, condition: Condition, n_fields: int, n_frames: int, seed: int
) -> Survey:
    """Solve seeded frames of a condition at random rolls, in fields all over the sky."""
    rng = np.random.default_rng(seed)
    catalog, camera = tracker.database.catalog, tracker.camera
    boresights = fibonacci_lattice(n_fields)
    guide_stars = np.zeros(n_fields)
    possible, right, wrong = np.zeros((3, n_fields), np.int64)
    limit_deg = condition.correct_deg(camera)
    for at, (ra, dec) in enumerate(zip(*ra_dec(boresights), strict=True)):
        for roll in rng.uniform(0, 2 * np.pi, n_frames):
            rotation = rotation_from_boresight(ra, dec, roll)
            guide_stars[at] += len(visible_stars(catalog, camera, rotation)[0]) / n_frames
            frame = synthetic_field(catalog, camera, rotation, rng, condition)
            possible[at] += np.sum(frame.catalog_index >= 0) >= MIN_STARS
            solution = tracker.solve(frame.xy_px)
            if solution.attitude is not None:
                error_deg = boresight_angle_deg(solution.attitude.rotation, rotation)
                is_right = error_deg <= limit_deg
                right[at] += is_right
                wrong[at] += not is_right
    return Survey(boresights, n_frames, guide_stars, possible, right, wrong)
