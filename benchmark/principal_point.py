"""What it brings to fit the principal point, and what it does to the attitude meanwhile.

    python benchmark/principal_point.py [--frames 20] [--seeds 12]

Frames of stars all over the image, all of them identified, go into a `CameraEstimator` that begins
with the middle of the image, no lens and a focal length 0.5 % off. Once the principal point stays
there, once it is fitted. After the frames: the residuals; by how much the boresight is off the
lens' true axis, the mean of the frames (a constant turn) and the deviation of one about it. While
it learns: by how much the attitude of one and the same frame moves from a frame to the next, the
most, in standard deviations of that frame's own boresight.
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

from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.camera_estimator import CameraEstimator
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

_BENT = replace(
    Camera.from_fov(50.0, 1024, 768),
    distortion=Distortion("plumb_bob", (-0.25, 0.05, 0.0, 0.0, 0.0)),
)
_NARROW = Camera.from_fov(12.0, 512, 512)


@dataclass(frozen=True)
class Case:
    """A camera, how many stars a frame has, and their noise."""

    name: str
    camera: Camera
    stars: int
    noise_px: float


CASES = (
    Case("50 deg, k1 -0.25, 20 px off", replace(_BENT, cx_px=528.0, cy_px=372.0), 40, 0.2),
    Case("50 deg, k1 -0.25, not off", _BENT, 40, 0.2),
    Case("12 deg, 11 px off", replace(_NARROW, cx_px=264.0, cy_px=248.0), 15, 0.3),
    Case("12 deg, not off", _NARROW, 15, 0.3),
)
Sky = tuple[np.ndarray, np.ndarray, np.ndarray]


def skies(case: Case, n: int, rng: np.random.Generator) -> Iterator[Sky]:
    """Yield centroids (m, 2), their directions (m, 3) and the attitude (3, 3) of n frames."""
    camera = case.camera
    for _ in range(n):
        xy = rng.random((case.stars, 2)) * (camera.width_px, camera.height_px)
        rotation = random_rotation(rng)
        stars = camera.vectors(xy) @ rotation.T
        yield xy + rng.normal(0.0, case.noise_px, xy.shape), stars, rotation


def measure(case: Case, frames: list[Sky], fits: bool) -> list[float]:
    """Return residual px, turn deg, deviation deg, largest move, error and its deviation px."""
    true = case.camera
    told = Camera.from_fov(true.fov_deg, true.width_px, true.height_px).scaled(1.005)
    estimator = CameraEstimator(told, 0.02, told=told if fits else None)
    boresights = []
    for xy, stars, _ in frames:
        each = np.arange(len(xy))
        estimator.add_frame(xy, stars, (each, each))
        boresights.append(_attitude(estimator, frames[0])[:, 2])
    moves = np.linalg.norm(np.diff(boresights, axis=0), axis=1)
    own = case.noise_px / np.sqrt(case.stars) / true.focal_length_px
    found = estimator.estimate
    axes = np.array([r.T @ _attitude(estimator, (xy, s, r))[:, 2] for xy, s, r in frames])
    mean = axes.mean(axis=0)
    left = np.concatenate([
        found.camera.pixels(s @ _attitude(estimator, (xy, s, r))) - xy for xy, s, r in frames
    ])
    off_px = np.hypot(found.camera.cx_px - true.cx_px, found.camera.cy_px - true.cy_px)
    error_px = float(np.hypot(*found.standard_errors[-2:])) if fits else 0.0
    return [
        float(np.sqrt(np.mean(np.sum(left**2, axis=1)))),
        float(np.degrees(np.arctan2(np.hypot(*mean[:2]), mean[2]))),
        float(np.degrees(np.sqrt(np.mean((axes - mean)[:, :2] ** 2)))), float(moves.max() / own),
        float(off_px), error_px,
    ]


def _attitude(estimator: CameraEstimator, frame: Sky) -> np.ndarray:
    return wahba(estimator.estimate.camera.vectors(frame[0]), frame[1])


def main() -> None:
    """Print the table: means over the seeds, and the median of the largest moves."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=12)
    options = parser.parse_args()
    print("| camera | principal point | residual px | turn deg | deviation deg | moves, sigma | "
          "off px | its error px |\n|---|---|---|---|---|---|---|---|")
    for case in CASES:
        for fits in (False, True):
            values = np.array([
                measure(case, list(skies(case, options.frames, np.random.default_rng(s))), fits)
                for s in range(options.seeds)
            ])
            mean, moves = values.mean(axis=0), np.median(values[:, 3])
            word = "fitted" if fits else "stays"
            error = f"{mean[5]:.2g}" if fits else ""
            print(f"| {case.name} | {word} | {mean[0]:.3f} | {mean[1]:.4f} | {mean[2]:.4f} | "
                  f"{moves:.1f} | {mean[4]:.2f} | {error} |")


if __name__ == "__main__":
    main()
