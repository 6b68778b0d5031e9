"""One file as a frame: centroids, their brightness and what is known of the camera."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.detect import detect_stars
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.frame_file import read_frame
from star_tracker.maps.star_map import read_star_map
from star_tracker.offline.image_file import read_image


@dataclass(frozen=True)
class FileFrame:
    """What a file shows.

    Attributes:
        path: the file.
        size_px: width and height of the image.
        xy_px: (n, 2) centroids; the origin is the outer corner of the first pixel.
        intensity: (n,) their brightness, None where it is not known.
        detect_ms: CPU time of reading and detecting.
        is_image: whether the file is an image.
        added_px: what was added to the coordinates of a file that counts them otherwise.
    """

    path: Path
    size_px: tuple[int, int]
    xy_px: Floats
    intensity: Floats | None
    detect_ms: float
    is_image: bool = False
    added_px: float = 0.0

    @property
    def told_px(self) -> Floats:
        """The centroids (n, 2) as the file counts them."""
        return self.xy_px - self.added_px


def read_centroids(
    path: Path, size_px: tuple[int, int] | None, added_px: float = 0.0
) -> FileFrame:
    """Read a list of centroids or a star map, whose own camera is left aside but for its size.

    `added_px` is added to a list's coordinates, so that they are counted from the outer corner of
    the first pixel, as those of a map are. Raises ValueError for a file that is neither, and for a
    list without an image size.
    """
    if is_star_map(path):
        star_map = read_star_map(path)
        size = star_map.camera.width_px, star_map.camera.height_px
        return FileFrame(path, size, star_map.xy_px, None, 0.0)
    if size_px is None:
        raise ValueError(
            f"{path} is a list of centroids: give the size of its image with --width-px and "
            "--height-px"
        )
    xy, intensity = read_frame(path)
    return FileFrame(path, size_px, xy + added_px, intensity, 0.0, added_px=added_px)


@dataclass(frozen=True)
class OpenImage:
    """An image (h, w) or (h, w, colours) out of a file, and the CPU time of reading it."""

    path: Path
    pixels: NDArray[Any]
    read_ms: float


def open_image(path: Path) -> OpenImage:
    """Read an image file. Raises ValueError naming the file."""
    started_ns = time.thread_time_ns()
    pixels = read_image(path)
    return OpenImage(path, pixels, (time.thread_time_ns() - started_ns) / 1e6)


def detect_in(image: OpenImage, settings: DetectSettings, bayer: str = "") -> FileFrame:
    """Detect the stars of an image. Raises ValueError naming its file."""
    started_ns = time.thread_time_ns()
    try:
        found = detect_stars(image.pixels, settings, bayer=bayer)
    except ValueError as error:
        raise ValueError(f"{image.path}: {error}") from error
    size = int(image.pixels.shape[1]), int(image.pixels.shape[0])
    elapsed_ms = image.read_ms + (time.thread_time_ns() - started_ns) / 1e6
    flux = np.asarray(found.flux, float)
    return FileFrame(image.path, size, found.xy_px, flux, elapsed_ms, is_image=True)


def is_list(path: Path) -> bool:
    """Return whether a file is text with centroids, not an image."""
    return path.suffix.lower() in {".csv", ".txt"}


def is_star_map(path: Path) -> bool:
    """Return whether a file is a star map, with its camera."""
    try:
        with path.open(encoding="utf-8") as file:
            return file.read(20).startswith("# star map")
    except (OSError, UnicodeDecodeError):
        return False
