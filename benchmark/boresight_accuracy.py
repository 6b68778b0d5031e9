"""The numbers of docs/boresight.md: three stars on the maps, focal length, attitude and its bound.

`python benchmark/boresight_accuracy.py [--frames N]`. Seeded; one BLAS thread.
"""

import argparse
import math
import os
import sys
from itertools import combinations
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, f

from star_tracker.commands import matched_map
from star_tracker.attitude.wahba import (wahba)
from star_tracker.calibration.lens import calibrate
from star_tracker.optics.camera import Camera
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.calibration.error_propagation import cramer_rao_covariance
from star_tracker.maps.simulation import CAMERAS, Condition
from star_tracker.solution import SolveSettings, Status
from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import random_rotation, synthetic_field
from star_tracker.calibration.three_star import (
    MAX_ERROR_FACTOR,
    boresight_linear,
    boresight_spherical,
    boresight_unknown_focal_length,
    error_factor,
    radii_px,
)
from star_tracker.tracker import StarTracker

ARCSEC_PER_RAD = np.degrees(1) * 3600
SEED = 2019


def maps() -> None:
    """Print what all triples of four maps give; their only error is the rounding to 0.01 px."""
    row = "{:>4} {:>8} {:>7} {:>10} {:>9} {:>7} {:>10} {:>11}".format
    print(row(
        "map", "triples", "K>1000", "agree rad", 'median "', 'max "', "f refused", "median df/f"
    ))
    for number in "1247":
        matched = matched_map.load(number)
        a, f_px = radii_px(matched.camera, matched.xy_px), matched.camera.focal_length_px
        truth = matched.pose.rotation[:, 2]
        index = np.array(list(combinations(range(len(a)), 3)))
        usable = index[error_factor(matched.star_vectors[index]) <= MAX_ERROR_FACTOR]
        agree, off, refused, f_errors = [], [], 0, []
        for t in usable:
            stars = matched.star_vectors[t]
            found = boresight_linear(stars, a[t], f_px)
            other = boresight_spherical(stars, a[t], f_px)
            agree.append(separation(found.direction, other.direction))
            off.append(separation(found.direction, truth) * ARCSEC_PER_RAD)
            try:
                free = boresight_unknown_focal_length(stars, a[t], 1.05 * f_px)
            except ValueError:
                refused += 1
            else:
                f_errors.append(abs(free.focal_length_px / f_px - 1))
        print(row(
            number, len(index), len(index) - len(usable), f"{max(agree):.1e}",
            f"{np.median(off):.2f}", f"{max(off):.1f}", f"{refused / len(usable):.1%}",
            f"{np.median(f_errors):.1e}",
        ))


def narrow_fields() -> None:
    """Print how many random triples are refused as the field shrinks."""
    rng = np.random.default_rng(SEED)
    parts = []
    for fov_deg in (20, 12, 5, 2, 1, 0.5):
        camera = Camera.from_fov(fov_deg, 512, 512)
        vectors = camera.vectors(rng.random((60_000, 2)) * 512).reshape(-1, 3, 3)
        refused = np.mean(error_factor(vectors) > MAX_ERROR_FACTOR)
        parts.append(f"{fov_deg:g} deg {refused:.1%}")
    print(f"random triples with K > {MAX_ERROR_FACTOR:g}: {', '.join(parts)}")


def focal_length(n_frames: int) -> None:
    """Print the error of f from all stars of random fields at 1 px, started 3 % off."""
    catalog = StarCatalog.paper()
    for name, camera in CAMERAS.items():
        rng, errors, scaled = np.random.default_rng(SEED), [], []
        start = Camera.from_fov(1.03 * camera.fov_deg, camera.width_px, camera.height_px)
        while len(errors) < n_frames:
            frame = synthetic_field(
                catalog, camera, random_rotation(rng), rng, Condition(noise_px=1.0)
            )
            if len(frame.xy_px) < 5:
                continue
            fit = calibrate(start, frame.xy_px, catalog.vectors[frame.catalog_index])
            error = fit.values[0] - camera.focal_length_px
            errors.append(error / camera.focal_length_px)
            scaled.append(f.cdf((error / fit.standard_errors[0]) ** 2, 1, fit.degrees_of_freedom))
        within = np.mean(np.array(scaled) < 0.95)
        print(
            f"{name}: focal length rms {np.sqrt(np.mean(np.square(errors))):.3%} at 1 px over "
            f"{n_frames} fields of 5 stars or more; {within:.1%} within their 95 %"
        )


def bound(n_frames: int) -> None:
    """Print the attitude's error over the Cramer-Rao bound."""
    rng = np.random.default_rng(SEED)
    for name, camera in CAMERAS.items():
        ratios = []
        for n in (5, 10, 20, 40):
            nees = []
            for _ in range(n_frames):
                rotation, xy = random_rotation(rng), rng.random((n, 2)) * camera.width_px
                vectors = camera.vectors(xy)
                noisy = camera.vectors(xy + rng.normal(0, 0.1, xy.shape))
                turn = Rotation.from_matrix(rotation.T @ wahba(noisy, vectors @ rotation.T))
                p = cramer_rao_covariance(vectors, 0.1 / camera.fx_px)
                nees.append(turn.as_rotvec() @ np.linalg.solve(p, turn.as_rotvec()))
            ratios.append(f"{n} stars {math.sqrt(np.mean(nees) / 3):.3f}")
        print(f"{name}: attitude error over the Cramer-Rao bound: {', '.join(ratios)}")


def published(n_frames: int) -> None:
    """Print the NEES of solved frames, carried over to chi-square (F for an estimated sigma)."""
    catalog = StarCatalog.paper()
    database = FeatureDatabase.build(catalog)
    for name, camera in CAMERAS.items():
        tracker = StarTracker(database, camera, SolveSettings(deadline_ms=math.inf))
        rng, quantile = np.random.default_rng(SEED), []
        while len(quantile) < n_frames:
            frame = synthetic_field(
                catalog, camera, random_rotation(rng), rng, Condition(noise_px=0.5)
            )
            solution = tracker.solve(frame.xy_px)
            if solution.status is not Status.SOLVED:
                continue
            attitude, k = solution.attitude, len(solution.identification.identified)
            error = Rotation.from_matrix(frame.rotation.T @ attitude.rotation).as_rotvec()
            nees = error @ np.linalg.solve(attitude.covariance_rad2, error)
            quantile.append(f.cdf(nees / 3, 3, 2 * k - 3))
        low, high = chi2.ppf([0.025, 0.975], 3 * n_frames) / (3 * n_frames)
        mean = np.sum(chi2.ppf(quantile, 3)) / (3 * n_frames)
        print(f"{name}: mean NEES / 3 {mean:.3f} (95 %: {low:.3f} to {high:.3f}) at 0.5 px")


def main() -> int:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=500, help="frames a measurement (500)")
    options = parser.parse_args()
    maps()
    narrow_fields()
    focal_length(options.frames)
    bound(options.frames)
    published(options.frames)
    return 0


if __name__ == "__main__":
    sys.exit(main())
