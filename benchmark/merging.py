"""Merging of close stars held against rendered images: which limit and margin predict best.

    python benchmark/merging.py [--frames N]

Random fields of a wide, coarse camera (60 deg over 256 px, 4 px in a degree) are rendered with all
stars to V = 8, a star image of 1 px and noise that hides stars fainter than V = 4.5. Detected is
what stands 5 sigma above it in connected pixels, at the first moment. For each limit of merging
and each margin below the limiting magnitude: the share of centroids with a catalogue star within
0.5 and 1 px, and how many catalogue stars a field has. `depth.BLEND_PX` and `merging.MARGIN_MAG`
are from this table.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.ndimage import center_of_mass, label
from scipy.ndimage import sum as total
from scipy.spatial import cKDTree

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.merging import merge_close
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import random_rotation
from star_tracker.optics.camera import Camera

CAMERA = Camera.from_fov(60, 256, 256)
PX_DEG = float(np.degrees(1 / CAMERA.focal_length_px))
LIMIT_MAG, SIGMA_PX, SEED = 4.5, 1.0, 1
LIMITS_PX = (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
MARGINS_MAG = (0.75, 2.0, 3.5)


def places(vectors: Floats, rotation: Floats, margin_px: float) -> tuple[Floats, Floats]:
    """Return the indices and pixels of the stars in the image, widened by a margin."""
    ahead = np.flatnonzero(vectors @ rotation[:, 2] > 0.3)
    pixels = CAMERA.pixels(vectors[ahead] @ rotation)
    inside = CAMERA.contains(pixels, margin_px)
    return ahead[inside], pixels[inside]


def detected(stars: StarCatalog, rotation: Floats, rng: np.random.Generator) -> Floats:
    """Return the centroids (n, 2) of a rendered field."""
    index, pixels = places(stars.vectors, rotation, 5 * SIGMA_PX)
    at = np.arange(256) + 0.5
    spread = [
        np.exp(-((at - pixels[:, [axis]]) ** 2) / (2 * SIGMA_PX**2)) for axis in (0, 1)
    ]
    light = 10 ** (-0.4 * (stars.v_mag[index] - LIMIT_MAG))
    image = np.einsum("k,ky,kx->yx", light, spread[1], spread[0], optimize=True)
    noise = 1 / 6  # of the peak of a star at the limit
    image += rng.normal(0, noise, image.shape)
    blobs, n = label(image > 5 * noise)
    size = total(np.ones_like(image), blobs, range(1, n + 1))
    centres = np.array(center_of_mass(np.where(image > 0, image, 0), blobs, range(1, n + 1)))
    return centres.reshape(-1, 2)[size >= 3][:, ::-1] + 0.5


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=40)
    rng = np.random.default_rng(SEED)
    every = StarCatalog.hipparcos(limiting_magnitude=8.0, min_separation_deg=0.0)
    fields = [random_rotation(rng) for _ in range(parser.parse_args().frames)]
    images = [detected(every, rotation, rng) for rotation in fields]
    print(f"{np.mean([len(one) for one in images]):.1f} centroids a field")
    print("| limit, px | margin, mag | within 0.5 px, % | within 1 px, % | stars a field |")
    print("|---|---|---|---|---|")
    for limit_px in LIMITS_PX:
        for margin in MARGINS_MAG if limit_px else MARGINS_MAG[:1]:
            near = every.v_mag <= LIMIT_MAG + margin
            merged = merge_close(
                every.vectors[near], every.v_mag[near], np.radians(limit_px * PX_DEG)
            )
            seen = merged.vectors[merged.v_mag <= LIMIT_MAG]
            predicted = [places(seen, rotation, 0.0)[1] for rotation in fields]
            off = np.concatenate([
                cKDTree(there).query(found)[0]
                for there, found in zip(predicted, images, strict=True)
            ])
            print(
                f"| {limit_px:g} | {margin:g} | {100 * np.mean(off < 0.5):.1f} "
                f"| {100 * np.mean(off < 1):.1f} "
                f"| {np.mean([len(one) for one in predicted]):.1f} |"
            )


if __name__ == "__main__":
    main()
