"""From rendered images to attitudes: how many are solved, and are they as good as they say.

`python benchmark/end_to_end.py [--images N]`: cameras of 12, 20 and 50 deg at random attitudes;
each image with noise of its own: exposure, width of a star, sky, a gradient, row banding, hot
pixels, up to two planets and 8 or 12 bits. Detected with the defaults and solved lost in space,
with the camera known and with nothing told (one image does not help another). Of images that show
six stars or more above a signal to noise of 6 it prints the share that is solved, wrong solutions
(off by more than 0.1 deg and by more than the covariance allows in one of 10,000), and the shares
of normalised errors above the 95 and 99 % bounds of chi-square with 3 degrees of freedom. Below
the table each image that is not solved though it shows enough, or is wrong, has a line.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.spatial.transform import Rotation

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import ladder
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import Planet, RenderedImage, RenderSettings
from star_tracker.maps.simulation import boresight_angle_deg, random_rotation
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

CAMERAS = (
    Camera.from_fov(12, 1024, 1024), Camera.from_fov(20, 1024, 1024),
    Camera.from_fov(50, 1280, 960),
)
SIZES = sorted({(one.width_px, one.height_px) for one in CAMERAS})
BOUNDS = {95: 7.815, 99: 11.345, 99.99: 21.1}
CORRECT_DEG, ENOUGH_STARS, ENOUGH_SNR = 0.1, 6, 6.0


@dataclass(frozen=True)
class Outcome:
    """How an image ended: NEES and boresight error are NaN where it is not solved.

    `ended` tells of the detection and the solution, for who looks into it.
    """

    image: int
    camera: str
    told: str
    enough: bool
    nees: float
    off_deg: float
    ended: str

    @property
    def solved(self) -> bool:
        """Whether there is an attitude."""
        return bool(np.isfinite(self.nees))

    @property
    def wrong(self) -> bool:
        """Whether it is off by more than it says."""
        return self.off_deg > CORRECT_DEG and self.nees > BOUNDS[99.99]


def settings_of(rng: np.random.Generator, rotation: np.ndarray) -> RenderSettings:
    """Return what an image is made with."""
    boresight = rotation[:, 2]
    ra, dec = np.degrees([np.arctan2(boresight[1], boresight[0]), np.arcsin(boresight[2])])
    return RenderSettings(
        exposure_s=float(rng.choice([0.1, 0.2, 0.4])), psf_sigma_px=float(rng.uniform(0.7, 1.5)),
        sky_e_per_s=float(rng.uniform(50, 1000)),
        sky_gradient=tuple(rng.uniform(-1, 1, 2).tolist()),
        row_banding_e=float(rng.uniform(0, 3)), hot_pixels=float(rng.choice([0.0, 1e-5, 1e-4])),
        bits=int(rng.choice([8, 12])), gain_e_per_dn=float(rng.choice([5.0, 20.0])),
        planets=tuple(
            Planet(
                float(ra + rng.uniform(-4, 4)), float(np.clip(dec + rng.uniform(-4, 4), -89, 89)),
                float(rng.uniform(-3, 2)),
            )
            for _ in range(int(rng.integers(0, 3)))
        ),
        seed=int(rng.integers(2**31)),
    )


def shows_enough(image: RenderedImage, made: RenderSettings) -> bool:
    """Return whether there are stars enough above the signal to noise that is asked for."""
    area = 4 * np.pi * made.psf_sigma_px**2
    rounding = made.gain_e_per_dn**2 / 12
    pixel = made.sky_e_per_s * made.exposure_s + made.read_noise_e**2 + rounding
    snr = image.electrons / np.sqrt(image.electrons + area * pixel)
    return int(np.sum((snr >= ENOUGH_SNR) & (image.catalog_index >= 0))) >= ENOUGH_STARS


def outcomes(n: int, deadline_ms: float) -> list[Outcome]:
    """Render, detect and solve."""
    sky = StarCatalog.named("hipparcos", limiting_magnitude=8.0)
    settings = SolveSettings(method="match_group", deadline_ms=deadline_ms)
    known = [StarTracker(FeatureDatabase.for_camera(one), one, settings) for one in CAMERAS]
    anyone = {size: AnyCameraTracker(ladder((4.0, 70.0), size), settings) for size in SIZES}
    rng, found = np.random.default_rng(2026), []
    for i in range(n):
        at = i % len(CAMERAS)
        camera, rotation = CAMERAS[at], random_rotation(rng)
        made = settings_of(rng, rotation)
        image = render(camera, rotation, sky, made)
        stars = detect_stars(image.image)
        size = camera.width_px, camera.height_px
        for told, tracker in (("known", known[at]), ("nothing", anyone[size])):
            solution = tracker.solve(stars.xy_px, stars.flux)
            nees = off = float("nan")
            if solution.status is Status.SOLVED and solution.attitude is not None:
                attitude = solution.attitude
                error = Rotation.from_matrix(attitude.rotation.T @ rotation).as_rotvec()
                nees = float(error @ np.linalg.solve(attitude.covariance_rad2, error))
                off = boresight_angle_deg(attitude.rotation, rotation)
            found.append(Outcome(
                i, f"{camera.fov_deg:.0f} deg", told, shows_enough(image, made), nees, off,
                f"{solution.status.name}, {len(stars)} stars detected, stars of "
                f"{stars.quality.psf_sigma_px:.2f} px rendered with {made.psf_sigma_px:.2f} px, "
                f"{solution.reason or 'no reason'}",
            ))
    return found


def main() -> int:
    """Print the table; the exit code is 1 where a solution was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--images", type=int, default=500)
    parser.add_argument(
        "--deadline-ms", type=float, default=30_000.0,
        help="of an image: long, so that rates do not depend on what else the machine does",
    )
    options = parser.parse_args()
    started_s = time.process_time()
    found = outcomes(options.images, options.deadline_ms)
    print("| camera | told | images | of those with 6 stars solved | wrong | > 95 % | > 99 % |")
    print("|---|---|---|---|---|---|---|")
    n_wrong = 0
    for camera in sorted({one.camera for one in found}):
        for told in ("known", "nothing"):
            mine = [one for one in found if (one.camera, one.told) == (camera, told)]
            enough = [one for one in mine if one.enough]
            nees = np.array([one.nees for one in mine if one.solved])
            wrong = sum(one.wrong for one in mine)
            n_wrong += wrong
            solved = sum(one.solved for one in enough)
            print(
                f"| {camera} | {told} | {len(mine)} | {solved} of {len(enough)} | {wrong} | "
                f"{100 * np.mean(nees > BOUNDS[95]):.1f} % | "
                f"{100 * np.mean(nees > BOUNDS[99]):.1f} % |"
            )
    print()
    for one in found:
        if one.wrong or (one.enough and not one.solved):
            print(f"image {one.image}, {one.camera}, told {one.told}: {one.ended}")
    print(f"{time.process_time() - started_s:.0f} s of CPU")
    return int(n_wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
