"""Detection and identification on real images of the night sky whose truth is known.

`python benchmark/real_sky.py FOLDER [--repeat N]`. The folder holds images, `truth.csv` (file,
ra_deg, dec_deg, fov_width_deg) and, optional, `stars.csv` (file, x_px, y_px: stars that are known
to be in the image). Files whose name begins with `negative` show no sky and must not be solved.
The field of view is told, nothing else; no distortion, parity normal. Method match_group, as the

defaults. Times are CPU times of this process.
"""

import argparse
import csv
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.detection.centroids import Centroids
from star_tracker.detection.detect import detect_stars
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

#: Boresight errors up to this are right: the truth itself is good to 0.01 to 0.1 deg.
RIGHT_DEG = 0.1
#: A centroid this near to a known star is that star.
MATCH_PX = 1.5


@dataclass(frozen=True)
class Row:
    """What one image gave; `n_known` and `n_found` count the stars known to be in it."""

    name: str
    megapixels: float
    centroids: Centroids
    detect_ms: float
    solution: Solution
    error_deg: float
    n_known: int
    n_found: int

    @property
    def right(self) -> bool:
        """Whether the frame ended as it should."""
        solved = self.solution.status is Status.SOLVED
        if self.name.startswith("negative"):
            return not solved
        return solved and self.error_deg < RIGHT_DEG


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file, none where there is no such file."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def timed_detection(image: np.ndarray, repeat: int) -> tuple[Centroids, float]:
    """Return the stars of an image and the least CPU time of several runs, ms."""
    times = []
    for _ in range(repeat):
        started = time.process_time()
        centroids = detect_stars(image)
        times.append(1e3 * (time.process_time() - started))
    return centroids, min(times)


def run(folder: Path, name: str, truth: dict[str, str] | None, repeat: int) -> Row:
    """Detect and solve one image; without truth as if it were of the first camera."""
    image = np.asarray(Image.open(folder / name))
    centroids, detect_ms = timed_detection(image, repeat)
    fov = float(truth["fov_width_deg"]) if truth else 14.25
    camera = Camera.from_fov(fov, image.shape[1], image.shape[0])
    tracker = StarTracker(
        FeatureDatabase.for_camera(camera, with_patterns=False), camera,
        SolveSettings(method="match_group", deadline_ms=5000.0),
    )
    solution = tracker.solve(centroids.xy_px, centroids.flux)
    error = np.nan
    if truth and solution.attitude is not None:
        there = unit_vectors(*np.radians([float(truth["ra_deg"]), float(truth["dec_deg"])]))
        error = float(np.degrees(separation(solution.attitude.rotation[:, 2], there)))
    known = np.array([
        (float(row["x_px"]), float(row["y_px"])) for row in read_table(folder / "stars.csv")
        if row["file"] == name
    ]).reshape(-1, 2)
    n_found = 0
    if len(centroids) and len(known):
        n_found = int(np.sum(cKDTree(centroids.xy_px).query(known)[0] < MATCH_PX))
    return Row(
        name, image.shape[0] * image.shape[1] / 1e6, centroids, detect_ms, solution, error,
        len(known), n_found,
    )


def rows(folder: Path, repeat: int = 1) -> list[Row]:
    """Run all images of a folder: those with truth, then those that show no sky."""
    truth = {row["file"]: row for row in read_table(folder / "truth.csv")}
    names = [*truth, *sorted(path.name for path in folder.glob("negative*"))]
    return [run(folder, name, truth.get(name), repeat) for name in names]


def main() -> int:
    """Print the table; the exit code is 1 where an image did not end as it should."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeat", type=int, default=5, help="detections an image")
    options = parser.parse_args()
    detect_stars(np.zeros((64, 64), np.uint8))  # compiles
    line = "{:38} {:>5} {:>7} {:>6} {:>9} {:>7} {:>8} {:>6} {:>13} {:>9}".format
    print(line("image", "stars", "known", "psf px", "detect ms", "ms/MP", "solve ms", "used",
               "status", "error deg"))
    every = rows(options.folder, options.repeat)
    for row in every:
        known = f"{row.n_found}/{row.n_known}" if row.n_known else "-"
        used = int(np.sum(row.solution.identification.catalog_index >= 0))
        print(line(
            row.name[:38], len(row.centroids), known, f"{row.centroids.quality.psf_sigma_px:.2f}",
            f"{row.detect_ms:.1f}", f"{row.detect_ms / row.megapixels:.1f}",
            f"{row.solution.solve_ms:.1f}", used, row.solution.status.value,
            f"{row.error_deg:.3f}" if np.isfinite(row.error_deg) else "-",
        ) + ("" if row.right else "   <-"))
    n_right = sum(row.right for row in every)
    print(f"{n_right} of {len(every)} as they should be; detection "
          f"{np.median([row.detect_ms / row.megapixels for row in every]):.1f} ms a megapixel "
          "(median)")
    return int(n_right < len(every))


if __name__ == "__main__":
    sys.exit(main())
