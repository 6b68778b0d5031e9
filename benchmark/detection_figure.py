"""The picture of docs/detection.png: a rendered frame with what is found, and how well.

`python benchmark/detection_figure.py [--frames N]`. Left a frame of the real sky's stars to V = 8
over a gradient, banding and hot pixels, with its centroids; right, from `benchmark/detection.py`'s
stars of known signal to noise, how many are found and how far off they are, over the Cramer-Rao
bound. It needs matplotlib.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from detection import SIGNALS, rendered_scene
from matplotlib.axes import Axes
from scipy.spatial import cKDTree

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.centroids import DetectSettings, Flag
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.figures.style import BLUE, VERMILION, house_style, new_figure, save
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.optics.camera import Camera

SHAPE, DPI = (480, 640), 130
#: Of a centroid that is counted as a star's, px.
MATCH_PX = 2.0
#: Towards Cygnus.
BORESIGHT_DEG = (305.0, 40.0, 0.0)
WIDTHS_PX = (0.6, 1.0, 1.6)


def draw_frame(axes: Axes) -> None:
    """Draw a frame and its centroids."""
    asked = RenderSettings(
        sky_gradient=(0.9, 0.5), row_banding_e=12.0, hot_pixels=1e-4, seed=1, exposure_s=0.3
    )
    camera = Camera.from_fov(12.0, SHAPE[1], SHAPE[0], parity="normal")
    rotation = rotation_from_boresight(*np.radians(BORESIGHT_DEG))
    image = render(camera, rotation, StarCatalog.hipparcos(limiting_magnitude=8.0), asked).image
    low, high = np.percentile(image, (1, 99.7))
    axes.imshow(image, cmap="gray", vmin=low, vmax=high, extent=(0, SHAPE[1], SHAPE[0], 0))
    found = detect_stars(image, DetectSettings(keep_suspects=True))
    hot = found.flagged(Flag.HOT | Flag.EXTENDED | Flag.STREAK)
    for chosen, marker, colour, name in (
        (~hot, "o", BLUE, "star"), (hot, "s", VERMILION, "hot pixel, left out"),
    ):
        axes.scatter(
            found.x_px[chosen], found.y_px[chosen], s=55, marker=marker, facecolors="none",
            edgecolors=colour, linewidths=1.1, label=f"{name}: {np.count_nonzero(chosen)}",
        )
    axes.legend(loc="lower right", fontsize=7)
    axes.set(xlim=(0, SHAPE[1]), ylim=(SHAPE[0], 0), xticks=[], yticks=[])
    axes.set_title("12 deg over 640 px: gradient, banding, hot pixels")


def measured(sigma_px: float, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the share found and the rms error over the bound (m,) for each of `SIGNALS`."""
    signal, off, bound = [], [], []
    for seed in range(frames):
        scene = rendered_scene("", SHAPE[::-1], RenderSettings(
            psf_sigma_px=sigma_px, bits=16, gain_e_per_dn=1.0, full_well_e=60_000.0, seed=seed
        ))
        found = detect_stars(scene.rendered.image, DetectSettings(max_stars=500))
        signal.append(scene.signal)
        off.append(cKDTree(found.xy_px).query(scene.rendered.xy_px)[0])
        bound.append(scene.bounds_px())
    q, off_px, bound_px = (np.concatenate(one) for one in (signal, off, bound))
    seen = off_px < MATCH_PX
    share = [np.mean(seen[q == one]) for one in SIGNALS]
    ratio = [np.sqrt(np.mean((off_px / bound_px)[seen & (q == one)] ** 2)) for one in SIGNALS]
    return np.array(share), np.array(ratio)


def main() -> None:
    """Write the picture and print its numbers."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=40, help="frames for each width")
    frames = parser.parse_args().frames
    with house_style():
        figure = new_figure(9.2, 3.9, DPI)
        left, share_axes, error_axes = (
            figure.add_axes(box) for box in (
                (0.01, 0.04, 0.53, 0.88), (0.61, 0.56, 0.37, 0.36), (0.61, 0.12, 0.37, 0.36),
            )
        )
        draw_frame(left)
        for sigma_px, marker, colour in zip(
            WIDTHS_PX, "osD", (BLUE, "0.2", VERMILION), strict=True
        ):
            share, ratio = measured(sigma_px, frames)
            looks = {"marker": marker, "color": colour, "ms": 4, "lw": 1,
                     "label": f"width {sigma_px:g} px"}
            share_axes.semilogx(SIGNALS, 100 * share, **looks)
            error_axes.semilogx(SIGNALS, ratio, **looks)
            print(f"{sigma_px} px: found {np.round(100 * share)} %, error {np.round(ratio, 2)}")
        error_axes.axhline(1.0, color="0.6", lw=0.8)
        for axes in (share_axes, error_axes):
            axes.set_xticks(SIGNALS, [f"{q:g}" for q in SIGNALS])
            axes.minorticks_off()
        share_axes.set(ylim=(0, 105), ylabel="found, %", title="Stars of known signal to noise")
        error_axes.set(ylim=(0, 1.5), ylabel="error / bound", xlabel="signal to noise")
        error_axes.legend(loc="lower right", fontsize=7)
        save(figure, ROOT / "docs" / "detection.png", DPI)


if __name__ == "__main__":
    main()
