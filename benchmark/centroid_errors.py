"""Errors of centroids over the Cramer-Rao bound by signal to noise, and what becomes of pairs.

`python benchmark/centroid_errors.py [--images N]`. Rendered, isolated stars whose signal to noise
q is spread evenly over its logarithm, from 5 to where the sensor saturates: the share that is
found, the rms error over the bound, and the mean error along x and y, by decades of q. A plain
background, a gradient, banding, and with a tenth of the stars saturated, which have a row of their
own. Then pairs of like stars (and of one four times as bright as the other) by their separation in
widths: how many are split, and of those that are not how far from the middle of their light and
from the first star, the brighter one, the one centroid lies, and whether it is flagged `BLEND`.
Prints tables in Markdown.
"""

import argparse
import os
import sys
from dataclasses import replace
from itertools import pairwise
from math import erf, sqrt
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.spatial import cKDTree

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.bound import position_bound_px, signal_to_noise
from star_tracker.detection.centroids import Centroids, DetectSettings, Flag
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.optics.camera import Camera

SENSOR = RenderSettings(bits=16, gain_e_per_dn=1.0, bias_dn=100.0, full_well_e=60_000.0)
SIZE_PX, SPACING_PX, JITTER_PX = (640, 480), 64, 8.0
FAINTEST, EVERY = 5.0, DetectSettings(max_stars=500)
#: A tenth of the stars is so much brighter than what saturates.
SATURATED_BY = 3.0
#: The part of the largest value below which a pixel counts.
_UNSATURATED = 0.98
DECADES = (FAINTEST, 10.0, 100.0, 1000.0, np.inf)
KINDS = {
    "plain": {}, "gradient": {"sky_gradient": (0.8, 0.5)},
    "banding": {"row_banding_e": 8.0, "column_banding_e": 4.0}, "a tenth saturated": {},
}
WIDTHS_PX = (0.7, 1.0, 1.6)
#: A pair's stars are this strong; a detection is a star's within so many px.
PAIR_SIGNAL, NEAR_PX = 60.0, 0.5
APART_WIDTHS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)


def noise_e(asked: RenderSettings) -> float:
    """Return the standard deviation of a pixel without stars, electrons."""
    sky = asked.sky_e_per_s * asked.exposure_s
    return float(np.sqrt(sky + asked.read_noise_e**2 + asked.gain_e_per_dn**2 / 12))


def electrons_at(asked: RenderSettings, signal: np.ndarray) -> np.ndarray:
    """Return the charge of stars of a signal to noise."""
    return np.asarray(signal / signal_to_noise(asked.psf_sigma_px, 1.0, noise_e=noise_e(asked)))


def saturating(asked: RenderSettings) -> float:
    """Return the signal to noise of a star that nearly fills the pixel that it is in."""
    on_a_pixel = erf(0.5 / (asked.psf_sigma_px * sqrt(2))) ** 2
    electrons = 0.9 * asked.full_well_e / on_a_pixel  # there is light of the sky, too
    return signal_to_noise(asked.psf_sigma_px, electrons, noise_e=noise_e(asked))


def grid(rng: np.random.Generator) -> np.ndarray:
    """Return places (n, 2) far from each other and from the border, anywhere within a pixel."""
    half = SPACING_PX // 2
    axes = np.meshgrid(*(np.arange(half, size - half + 1, SPACING_PX) for size in SIZE_PX))
    xy = np.column_stack([axis.ravel() for axis in axes]).astype(float)
    return xy + rng.uniform(-JITTER_PX, JITTER_PX, xy.shape)


def detected(xy: np.ndarray, electrons: np.ndarray, asked: RenderSettings) -> Centroids:
    """Render stars and return what is found."""
    camera = Camera.from_fov(12.0, *SIZE_PX, parity="normal")
    v_mag = asked.zero_point_mag - 2.5 * np.log10(electrons / asked.exposure_s)
    none = np.zeros(len(xy), np.int64)
    catalog = StarCatalog(camera.vectors(xy), v_mag, none, none)
    return detect_stars(render(camera, np.eye(3), catalog, asked).image, EVERY)


def measured(kind: str, sigma_px: float, n_images: int) -> np.ndarray:
    """Return rows of q, error x, y, bound, whether found (1) and saturated (1) of all stars."""
    asked = replace(SENSOR, psf_sigma_px=sigma_px, **KINDS[kind])
    rng, rows = np.random.default_rng(5), []
    brightest = saturating(asked)
    for seed in range(n_images):
        xy = grid(rng)
        signal = np.exp(rng.uniform(np.log(FAINTEST), np.log(brightest), len(xy)))
        full = np.zeros(len(xy), bool)
        if kind == "a tenth saturated":
            full[::10] = True
            signal[full] = SATURATED_BY * brightest
        electrons = electrons_at(asked, signal)
        found = detected(xy, electrons, replace(asked, seed=seed))
        off, index = cKDTree(found.xy_px).query(xy)
        error = found.xy_px[index] - xy
        for k, place in enumerate(xy):
            well = np.inf
            if full[k]:  # what counts as saturated begins a little below
                well = _UNSATURATED * asked.full_well_e - asked.sky_e_per_s * asked.exposure_s
            bound = position_bound_px(
                sigma_px, tuple(place), float(electrons[k]), noise_e=noise_e(asked),
                full_well_e=well,
            )
            rows.append((signal[k], *error[k], *bound, off[k] < 2.5, full[k]))
    return np.array(rows, float)


def row_of(name: str, which: str, rows: np.ndarray) -> None:
    """Print what the stars of a decade are like."""
    seen = rows[rows[:, 5] == 1]
    ratio = np.sqrt(np.mean((seen[:, 1:3] / seen[:, 3:5]) ** 2))
    bias = seen[:, 1:3].mean(axis=0)
    own = seen[:, 1:3].std() / np.sqrt(len(seen))
    print(
        f"| {name} | {which} | {len(rows)} | {100 * len(seen) / len(rows):.0f} | {ratio:.2f} | "
        f"{bias[0]:+.4f} | {bias[1]:+.4f} | {own:.4f} |"
    )


def error_table(n_images: int) -> None:
    """Print errors and biases by decade."""
    print("| width, background | q | stars | found, % | error/bound | bias x, px | bias y, px "
          "| its own error |")
    print("|---|---|---|---|---|---|---|---|")
    for sigma_px in WIDTHS_PX:
        for kind in KINDS:
            rows = measured(kind, sigma_px, n_images)
            name = f"{sigma_px:g} px, {kind}"
            for low, high in pairwise(DECADES):
                here = (rows[:, 0] >= low) & (rows[:, 0] < high) & (rows[:, 6] == 0)
                if here.any():
                    to = f"to {high:g}" if np.isfinite(high) else "to saturation"
                    row_of(name, f"{low:g} {to}", rows[here])
            if rows[:, 6].any():
                row_of(name, "saturated", rows[rows[:, 6] == 1])
    print()


def pairs_of(apart: float, share: float, sigma_px: float, n_images: int) -> np.ndarray:
    """Return rows of what becomes of pairs, among as many single stars.

    Whether it is split, one centroid, or left out; of one centroid its distance from the light's
    middle and from the first star, px, and whether it is flagged.
    """
    asked = replace(SENSOR, psf_sigma_px=sigma_px)
    rng, outcome = np.random.default_rng(6), []
    for seed in range(n_images):
        every = grid(rng)
        middle, single = every[::2], every[1::2]
        angle = rng.uniform(0, 2 * np.pi, len(middle))
        half = apart * sigma_px / 2 * np.column_stack([np.cos(angle), np.sin(angle)])
        first, second = middle - half, middle + half
        signal = np.full(2 * len(middle) + len(single), PAIR_SIGNAL)
        signal[len(middle) : 2 * len(middle)] *= share
        xy = np.vstack([first, second, single])
        found = detected(xy, electrons_at(asked, signal), replace(asked, seed=seed))
        light = (first + share * second) / (1 + share)
        reach = apart * sigma_px / 2 + 2 * sigma_px
        for k, near in enumerate(cKDTree(found.xy_px).query_ball_point(middle, reach)):
            off = np.hypot(*(found.xy_px[near, None] - [first[k], second[k], light[k]]).T)
            split = len(near) == 2 and bool((off[:2].min(axis=1) < NEAR_PX).all())
            alone = (off[2, 0], off[0, 0], bool(found.flags[near[0]] & Flag.BLEND)) if (
                len(near) == 1
            ) else (np.nan,) * 3
            outcome.append((split, len(near) == 1, not near, *alone))
    return np.array(outcome, float)


def pair_row(apart: float, share: float, sigma_px: float, n_images: int) -> None:
    """Print what becomes of pairs."""
    rows = pairs_of(apart, share, sigma_px, n_images)
    split, one, none = 100 * rows[:, :3].mean(axis=0)
    parts = ["-"] * 3
    if one > 0:
        light, first, flagged = rows[rows[:, 1] == 1, 3:].T
        parts = [f"{np.sqrt(np.mean(off**2)):.2f}" for off in (light, first)]
        parts.append(f"{100 * flagged.mean():.0f}")
    print(f"| {sigma_px:g} | {apart:g} | 1 : {share:g} | {len(rows)} | {split:.0f} | {one:.0f} | "
          f"{none:.0f} | {' | '.join(parts)} |")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--images", type=int, default=40, help="of each kind")
    options = parser.parse_args()
    error_table(options.images)
    print("| width, px | apart, widths | light | pairs | split, % | one centroid, % | none, % | "
          "one: rms from the light's middle, px | from the first star, px | flagged, % |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for sigma_px in (1.0, 1.6):
        for share in (1.0, 0.25):
            for apart in APART_WIDTHS:
                pair_row(apart, share, sigma_px, max(1, options.images // 8))


if __name__ == "__main__":
    main()
