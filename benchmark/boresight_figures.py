"""The figures of docs/boresight.md: predicted and measured boresight error over K and volume.

`python benchmark/boresight_figures.py` writes docs/boresight_k.png and docs/boresight_volume.png
and prints what the page says about them. It needs matplotlib.
"""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from scipy.stats import spearmanr

from star_tracker.optics.camera import Camera
from star_tracker.calibration.error_propagation import three_star_covariance
from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import random_rotation
from star_tracker.calibration.three_star import (
    MAX_ERROR_FACTOR,
    cosines,
    error_factor,
    radii_px,
    tetrahedron_volume,
)

ARCSEC_PER_RAD = np.degrees(1) * 3600
CAMERA = Camera.from_fov(12, 512, 512)
SIGMA_PX = 0.1
SEED = 2019


@dataclass(frozen=True)
class Scatter:
    """Of each triple its K, volume and mean square radius, predicted and measured error."""

    k: np.ndarray
    volume: np.ndarray
    predicted_arcsec: np.ndarray
    measured_arcsec: np.ndarray
    rms_radius_rad: float


def scatter(n_triples: int, n_frames: int) -> Scatter:
    """Measure the closed form on random triples with K up to the limit."""
    rng = np.random.default_rng(SEED)
    rows, radii = [], []
    while len(rows) < n_triples:
        rotation, xy = random_rotation(rng), rng.random((3, 2)) * CAMERA.width_px
        stars, a = CAMERA.vectors(xy) @ rotation.T, radii_px(CAMERA, xy)
        k = float(error_factor(stars))
        if k > MAX_ERROR_FACTOR:
            continue
        noisy = xy + rng.normal(0, SIGMA_PX, (n_frames, 3, 2)) - (CAMERA.cx_px, CAMERA.cy_px)
        m = np.linalg.solve(stars, cosines(np.hypot(*np.moveaxis(noisy, -1, 0)), CAMERA.fx_px).T)
        errors = separation((m / np.linalg.norm(m, axis=0)).T, rotation[:, 2])
        predicted = np.sqrt(np.trace(three_star_covariance(stars, a, CAMERA.fx_px, SIGMA_PX)))
        rows.append((k, tetrahedron_volume(stars), predicted, np.sqrt(np.mean(errors**2))))
        radii.append(a / CAMERA.fx_px)
    k, volume, predicted, measured = np.array(rows).T
    rms_radius = float(np.sqrt(np.mean(np.square(radii))))
    return Scatter(
        k, volume, predicted * ARCSEC_PER_RAD, measured * ARCSEC_PER_RAD, rms_radius
    )


def draw(found: Scatter, x: np.ndarray, label: str, path: Path) -> plt.Axes:
    """Start a figure of both errors over x; `finish` writes it."""
    figure, axes = plt.subplots(figsize=(6.0, 4.2), dpi=110, layout="constrained")
    axes.loglog(
        x, found.predicted_arcsec, "o", markersize=6, markerfacecolor="none",
        markeredgecolor="0.6", markeredgewidth=1, label="predicted, first order",
    )
    axes.loglog(x, found.measured_arcsec, ".", color="black", markersize=3, label="Monte Carlo")
    axes.set_xlabel(label)
    axes.set_ylabel(f"boresight error at {SIGMA_PX:g} px, arcsec (rms)")
    axes.grid(visible=True, which="major", color="0.85")
    figure.set_label(str(path))
    return axes


def finish(axes: plt.Axes) -> None:
    """Write the figure to the file that `draw` was given."""
    floor = 2 / np.sqrt(3) * SIGMA_PX / CAMERA.fx_px * ARCSEC_PER_RAD
    axes.axhline(floor, linestyle=":", color="0.3", label=r"$2\sigma/\sqrt{3}$")
    axes.legend(loc="best", framealpha=1)
    figure = axes.get_figure()
    figure.savefig(figure.get_label(), metadata={"Software": None})
    plt.close(figure)


def main() -> int:
    """Draw both figures and print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--triples", type=int, default=500, help="random triples (500)")
    parser.add_argument("--frames", type=int, default=400, help="noisy frames a triple (400)")
    options = parser.parse_args()
    found = scatter(options.triples, options.frames)

    sigma_arcsec = SIGMA_PX / CAMERA.fx_px * ARCSEC_PER_RAD
    line = np.array([found.k.min(), found.k.max()])
    axes = draw(found, found.k, "error factor K (4-27)", ROOT / "docs" / "boresight_k.png")
    axes.loglog(line, line * sigma_arcsec, "--", color="0.3", label=r"$K\sigma$ (4-27)")
    axes.loglog(
        line, np.sqrt(2) * line * sigma_arcsec * found.rms_radius_rad, "-", color="0.3",
        label=r"$\sqrt{2}\,K\sigma\rho$",
    )
    finish(axes)
    finish(draw(
        found, found.volume, "volume of the star tetrahedron (4-29), unit sphere",
        ROOT / "docs" / "boresight_volume.png",
    ))

    ratio = found.measured_arcsec / found.predicted_arcsec
    print(f"{options.triples} triples, K {found.k.min():.1f} to {found.k.max():.0f}")
    radius_deg = np.degrees(found.rms_radius_rad)
    print(f"rms radius {radius_deg:.2f} deg, sigma {sigma_arcsec:.2f} arcsec")
    print(f"measured / predicted: mean {ratio.mean():.3f}, standard deviation {ratio.std():.3f}")
    for name, values in (
        ("K", found.k), ("volume", found.volume), ("predicted", found.predicted_arcsec)
    ):
        rank = spearmanr(values, found.measured_arcsec).statistic
        print(f"rank correlation of {name} with the measured error {rank:+.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
