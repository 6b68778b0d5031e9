"""Can a filter believe the covariance? Errors in units of it, by how many stars carry a frame.

`python benchmark/covariance.py [--frames N]`: frames of exactly so many stars of the 12 deg and
the 20 deg camera at random attitudes, half of them with noise of 0.3 px and half with 1 px, solved
lost in space with the focal length known, told within 5 %, and not told; with the noise told and
not told. Printed is the share of solved frames whose normalised error (NEES) is above the 99 %
bound of chi-square with 3 degrees of freedom, which should be 1 % (Bar-Shalom et al. 2001, 5.4),
and the mean, which should be 3 where the noise is told. Frames whose identification is wrong
would be among those above.
"""

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.spatial.transform import Rotation

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import ladder
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import CAMERAS, Condition, random_rotation, synthetic_field
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

STARS = (4, 5, 6, 8, 10, 20)
NOISES_PX = (0.3, 1.0)
SCALES = ("known", "told within 5 %", "not told")
#: The 99 % bound of chi-square with 3 degrees of freedom.
BOUND = 11.345


def fields(
    catalog: StarCatalog, camera: Camera, n_stars: int, noise_px: float, n: int
) -> Iterator[tuple[Floats, Floats]]:
    """Yield centroids and true rotations of `n` frames of exactly so many stars."""
    rng = np.random.default_rng(1000 * n_stars + int(10 * noise_px))
    while n:
        frame = synthetic_field(
            catalog, camera, random_rotation(rng), rng, Condition(noise_px=noise_px)
        )
        if len(frame.xy_px) >= n_stars:
            n -= 1
            yield rng.permutation(frame.xy_px)[:n_stars], frame.rotation


def tracker(
    database: FeatureDatabase, camera: Camera, scale: str, sigma_px: float
) -> StarTracker | AnyCameraTracker:
    """Return what solves the frames."""
    settings = SolveSettings(method="match_group", centroid_sigma_px=sigma_px)
    if scale == "not told":
        steps = ladder((4.0, 70.0), (camera.width_px, camera.height_px), catalog="paper")
        return AnyCameraTracker(steps, settings, parity=camera.parity)
    if scale == "known":
        return StarTracker(database, camera, settings)
    told = replace(camera.scaled(1.03), tolerance_percent=5.0)
    return StarTracker(database, told, settings)


def nees(solver: StarTracker | AnyCameraTracker, xy_px: Floats, true: Floats) -> float:
    """Return the normalised squared error of a frame, NaN where it is not solved."""
    solution = solver.solve(xy_px)
    if solution.status is not Status.SOLVED or solution.attitude is None:
        return float("nan")
    error = Rotation.from_matrix(solution.attitude.rotation.T @ true).as_rotvec()
    return float(error @ np.linalg.solve(solution.attitude.covariance_rad2, error))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=1000, help="for each cell and noise")
    options = parser.parse_args()
    database = FeatureDatabase.build(StarCatalog.paper())
    print("| camera | focal length | noise | stars | solved | above the 99 % bound | mean NEES |")
    print("|---|---|---|---|---|---|---|")
    for name, camera in CAMERAS.items():
        for scale in SCALES:
            for told in (True, False):
                solvers = {
                    noise: tracker(database, camera, scale, noise if told else 0.0)
                    for noise in NOISES_PX
                }
                for n_stars in STARS:
                    found = np.array([
                        nees(solvers[noise], xy, true) for noise in NOISES_PX
                        for xy, true in fields(
                            database.catalog, camera, n_stars, noise, options.frames
                        )
                    ])
                    solved = found[np.isfinite(found)]
                    above = f"{100 * np.mean(solved > BOUND):.2f} %" if len(solved) else ""
                    mean = f"{np.mean(solved):.2f}" if len(solved) else ""
                    print(
                        f"| {name} | {scale} | {'told' if told else 'not told'} | {n_stars} | "
                        f"{len(solved)} of {len(found)} | {above} | {mean} |", flush=True,
                    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
