"""Detection beside other detectors: time, stars found, false detections, centroid error.

`python benchmark/detection.py [IMAGE...] [--repeat N]`. All detectors see the same images in the
same run: rendered ones, of which all is known, and the files given, of which only the time and the
number of stars are compared. tetra3rs (both of its extractors with their defaults, one thread) and
sep take part where they are installed. Times are CPU times of this
process. Centroid errors are over the Cramer-Rao bound, of isolated stars at q = 8 and more that
every detector found; a detection farther than 3 px from every star is false. Prints tables in
Markdown.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

try:
    import tetra3rs
except ImportError:
    tetra3rs = None
try:
    import sep
except ImportError:
    sep = None

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.bound import position_bound_px, signal_to_noise
from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderedImage, RenderSettings
from star_tracker.optics.camera import Camera

Detector = Callable[[np.ndarray], np.ndarray]
#: Centroids this near to a star are it; farther than `FALSE_PX` from all they are false.
MATCH_PX, FALSE_PX = 2.0, 3.0
#: Signal to noise of the rendered stars, and from where on their errors count.
SIGNALS, ERROR_FROM = (5.0, 6.0, 8.0, 12.0, 20.0, 50.0, 150.0), 8.0
SPACING_PX, JITTER_PX = 64, 8.0
SIZES = ((816, 612), (1280, 960), (1936, 1216))


@dataclass(frozen=True)
class Scene:
    """A rendered image, its settings, and the signal to noise (n,) of each star."""

    name: str
    asked: RenderSettings
    rendered: RenderedImage
    signal: np.ndarray

    @property
    def noise_e(self) -> float:
        """Standard deviation of a pixel without stars, electrons."""
        return noise_e(self.asked)

    def bounds_px(self) -> np.ndarray:
        """Return the bound (n,) of each star's error, both axes together."""
        return np.array([
            np.hypot(*position_bound_px(
                self.asked.psf_sigma_px, tuple(xy), electrons, noise_e=self.noise_e,
            )) for xy, electrons in zip(
                self.rendered.xy_px, self.rendered.electrons, strict=True
            )
        ])


def noise_e(asked: RenderSettings) -> float:
    """Return the standard deviation of a pixel without stars, electrons."""
    sky = asked.sky_e_per_s * asked.exposure_s
    return float(np.sqrt(sky + asked.read_noise_e**2 + asked.gain_e_per_dn**2 / 12))


def rendered_scene(name: str, size: tuple[int, int], asked: RenderSettings) -> Scene:
    """Return stars of known signal to noise on a grid with jitter."""
    rng = np.random.default_rng(asked.seed)
    width, height = size
    half = SPACING_PX // 2
    grid = np.meshgrid(
        np.arange(half, width - half, SPACING_PX), np.arange(half, height - half, SPACING_PX)
    )
    xy = np.column_stack([axis.ravel() for axis in grid]).astype(float)
    xy += rng.uniform(-JITTER_PX, JITTER_PX, xy.shape)
    signal = rng.choice(SIGNALS, len(xy))
    electrons = signal / signal_to_noise(asked.psf_sigma_px, 1.0, noise_e=noise_e(asked))
    camera = Camera.from_fov(12.0, width, height, parity="normal")
    v_mag = asked.zero_point_mag - 2.5 * np.log10(electrons / asked.exposure_s)
    none = np.zeros(len(xy), np.int64)
    catalog = StarCatalog(camera.vectors(xy), v_mag, none, none)
    return Scene(name, asked, render(camera, np.eye(3), catalog, asked), signal)


def scenes() -> list[Scene]:
    """Return the rendered images."""
    kinds = {
        "plain": {}, "gradient": {"sky_gradient": (0.8, 0.5)},
        "banding": {"row_banding_e": 8.0, "column_banding_e": 4.0},
        "hot pixels": {"hot_pixels": 1e-4},
    }
    several = []
    for size in SIZES:
        for bits, gain, bias in ((8, 12.0, 6.0), (16, 1.0, 100.0)):
            for name, more in kinds.items():
                asked = RenderSettings(
                    bits=bits, gain_e_per_dn=gain, bias_dn=bias, full_well_e=60_000.0, seed=1,
                    **more,
                )
                several.append(rendered_scene(f"{name}, {bits} bit", size, asked))
    return several


def ours(image: np.ndarray) -> np.ndarray:
    """Return our centroids (n, 2), the origin at the outer corner of the first pixel."""
    return detect_stars(image, DetectSettings(max_stars=1000)).xy_px


def by_default(image: np.ndarray) -> np.ndarray:
    """Return our centroids (n, 2), the brightest 150, as the package asks for them."""
    return detect_stars(image).xy_px


def detectors() -> dict[str, Detector]:
    """Return what is installed."""
    several: dict[str, Detector] = {"star_tracker": ours}
    if tetra3rs is not None:
        several["tetra3rs"] = lambda image: _tetra3rs(tetra3rs.extract_centroids, image)
        several["tetra3rs, fast"] = lambda image: _tetra3rs(
            tetra3rs.extract_centroids_fast, image
        )
    if sep is not None:
        several["sep, 3 sigma"] = _sep
    return several


def _sep(image: np.ndarray) -> np.ndarray:
    """Return centroids (n, 2); sep's origin is the middle of the first pixel."""
    plane = np.array(image, np.float32)
    background = sep.Background(plane)
    background.subfrom(plane)
    found = sep.extract(plane, 3.0, err=background.globalrms)
    return np.column_stack([found["x"], found["y"]]) + 0.5


def _tetra3rs(extract: Callable[..., object], image: np.ndarray) -> np.ndarray:
    """Return centroids (n, 2); tetra3rs's origin is the middle of the image."""
    height, width = image.shape
    try:
        found = extract(image, threads=1).centroids
    except TypeError:  # the fast one has one thread
        found = extract(image).centroids
    middle = ((width - 1) / 2 + 0.5, (height - 1) / 2 + 0.5)
    return np.array([(one.x, one.y) for one in found]).reshape(-1, 2) + middle


def timed(detector: Detector, image: np.ndarray, repeat: int) -> tuple[np.ndarray, float]:
    """Return centroids and the median CPU time, ms a megapixel."""
    found = detector(image)  # compiles
    times = []
    for _ in range(repeat):
        started = time.process_time()
        found = detector(image)
        times.append(time.process_time() - started)
    return found, 1e9 * float(np.median(times)) / image.size


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table in Markdown."""
    for row in (head, tuple("---" for _ in head), *rows):
        print("| " + " | ".join(row) + " |")
    print()


def rendered_table(several: list[Scene], peers: dict[str, Detector], repeat: int) -> None:
    """Print what each detector makes of the rendered images."""
    rows = []
    runs = {name: [timed(one, s.rendered.image, repeat) for s in several]
            for name, one in peers.items()}
    offsets = {
        name: [cKDTree(found if len(found) else np.full((1, 2), 1e9)).query(s.rendered.xy_px)[0]
               for (found, _), s in zip(run, several, strict=True)]
        for name, run in runs.items()
    }
    signal = np.concatenate([s.signal for s in several])
    bounds = np.concatenate([s.bounds_px() for s in several])
    megapixels = sum(s.rendered.image.size for s in several) / 1e6
    every = np.all([np.concatenate(one) < MATCH_PX for one in offsets.values()], axis=0)
    for name, run in runs.items():
        off = np.concatenate(offsets[name])
        false = sum(
            int(np.sum(cKDTree(s.rendered.xy_px).query(found)[0] > FALSE_PX)) if len(found) else 0
            for (found, _), s in zip(run, several, strict=True)
        )
        counted = every & (signal >= ERROR_FROM)
        error = np.sqrt(np.mean((off[counted] / bounds[counted]) ** 2))
        rows.append((
            name, f"{np.median([ms for _, ms in run]):.1f}",
            *(f"{100 * np.mean(off[signal == q] < MATCH_PX):.0f}" for q in SIGNALS),
            f"{false / megapixels:.1f}", f"{error:.2f}",
        ))
    table(("detector", "ms/MP", *(f"q={q:g}, %" for q in SIGNALS), "false/MP", "error/bound"),
          rows)


def time_table(several: list[Scene], peers: dict[str, Detector], repeat: int) -> None:
    """Print the times by size and type."""
    head = ("size", *peers)
    rows = []
    for size in SIZES:
        for kind in (np.uint8, np.uint16):
            images = [s.rendered.image for s in several
                      if s.rendered.image.shape == size[::-1] and s.rendered.image.dtype == kind]
            rows.append((f"{size[0]} x {size[1]}, {kind.__name__}", *(
                f"{np.median([timed(one, image, repeat)[1] for image in images]):.1f}"
                for one in peers.values()
            )))
    table(head, rows)


def files_table(files: list[Path], peers: dict[str, Detector], repeat: int) -> None:
    """Print times and numbers of detections of files."""
    several = {name: [] for name in peers}
    for path in files:
        image = np.asarray(Image.open(path).convert("L"))
        for name, one in peers.items():
            found, ms = timed(one, image, repeat)
            several[name].append((ms, len(found)))
    table(("detector", "ms/MP, median", "ms/MP, worst", "detections, median"), [
        (name, f"{np.median(ms):.1f}", f"{np.max(ms):.1f}", f"{np.median(n):.0f}")
        for name, (ms, n) in ((name, np.array(rows).T) for name, rows in several.items())
    ])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("images", type=Path, nargs="*", help="files for times only")
    parser.add_argument("--repeat", type=int, default=7, help="timed runs an image")
    options = parser.parse_args()
    peers, several = detectors(), scenes()
    print("Rendered images, all sizes\n")
    rendered_table(several, peers, options.repeat)
    print("CPU time, ms a megapixel\n")
    time_table(several, peers, options.repeat)
    if options.images:
        print(f"{len(options.images)} files\n")
        files_table(options.images, {**peers, "star_tracker": by_default}, options.repeat)


if __name__ == "__main__":
    main()
