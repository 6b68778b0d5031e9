"""Filtering an image for its own stars: what it is filtered for is found out from itself."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.background import subtract_background
from star_tracker.detection.centroids import PSF_RANGE_PX, DetectSettings
from star_tracker.detection.filter import matched_filter
from star_tracker.detection.image import Frame
from star_tracker.detection.planes import Plane, plane
from star_tracker.detection.psf import PIXEL_VARIANCE, Psf
from star_tracker.detection.search import find_peaks
from star_tracker.detection.stars import Scene
from star_tracker.detection.tiles import Tiles, tile_size_px
from star_tracker.detection.width import LONGEST_PX, image_psf

#: The first look supposes stars of this width, px. One that is off by `_SAME_WIDTH`, as the pixels
#: see it, costs 8 % of the signal to noise, 2 r / (1 + r^2); only beyond it the image is filtered
#: again.
_FIRST_SIGMA_PX, _SAME_WIDTH = 0.8, 1.5
#: Lines whose ends are off by no more than this, in widths, are the same.
_SAME_LINE = 1.5
_MOST_LOOKS = 4
#: Where the first look shows no stars, two pixels along each axis are taken together, then four,
#: then eight: stars of as many times the width would be seen then.
_MOST_BINNED = 8
#: Peaks that are looked at, for each star that is asked for: the others may be hot pixels. Of
#: drawn stars, which take longer, there are fewer.
_PEAKS_PER_STAR, _PEAKS_PER_STREAK = 8, 2
#: A binned image has at least so many pixels along each axis.
_SMALLEST_PX = 16


class Look(NamedTuple):
    """An image filtered for stars.

    Attributes:
        scene: what stars are fitted to.
        tiles: its background.
        brightness: (h, w) the filtered image.
        peaks: (n, 2) row and column of its peaks.
        psf: the image of a star.
    """

    scene: Scene
    tiles: Tiles
    brightness: Plane
    peaks: NDArray[np.int64]
    psf: Psf


def look_at(frame: Frame, asked: DetectSettings) -> Look:
    """Filter an image, again if need be, until what it is filtered for is what it shows."""
    known = asked.psf_sigma_px
    psf = Psf(known or _FIRST_SIGMA_PX)
    shape = frame.pixels.shape
    residual = plane("residual", shape)
    tiles = subtract_background(frame, tile_size_px(psf.sigma_px), residual)
    room = plane("filtered", shape)
    look = first = _filter(frame, (residual, tiles), psf, asked, room)
    for turn in range(_MOST_LOOKS - 1):
        found = image_psf(look.scene, look.peaks, psf, known)
        if found is None and known is None and turn == 0:
            found = _wide_psf(frame, (residual, tiles), asked)
        if found is None:
            # There is nothing to go by: the first look is as good as any.
            return first
        look = look._replace(psf=found)
        if found.streak_px > LONGEST_PX:
            # Where in such a streak the star was in the middle of the exposure cannot be told.
            return look._replace(peaks=look.peaks[:0])
        if _alike(found, psf):
            return look
        if tile_size_px(found.sigma_px) != tile_size_px(psf.sigma_px):
            residual = plane("residual again", shape)
            tiles = subtract_background(frame, tile_size_px(found.sigma_px), residual)
        psf = found
        room = plane("filtered again", shape)
        look = _filter(frame, (residual, tiles), psf, asked, room)
    return look


def _filter(
    frame: Frame, without: tuple[Plane, Tiles], psf: Psf, asked: DetectSettings, room: Plane
) -> Look:
    """Filter a frame whose background is subtracted into the room (h, w) given."""
    residual, tiles = without
    filtered = matched_filter(residual, tiles, psf, frame.step, room)
    per_star = _PEAKS_PER_STREAK if psf.streak_px > 0 else _PEAKS_PER_STAR
    peaks = find_peaks(filtered, tiles, asked.threshold_sigma, per_star * asked.max_stars)
    scene = Scene(
        residual, frame.pixels, frame.saturation_level, frame.channel,
        filtered.noise * math.sqrt(filtered.norm), 0.0,
    )
    return Look(scene, tiles, filtered.flux, peaks, psf)


def _wide_psf(
    frame: Frame, without: tuple[Plane, Tiles], asked: DetectSettings
) -> Psf | None:
    """Return the image of a star that is too wide to be seen pixel by pixel, None for no such."""
    mean, tiles = without
    largest, n = frame.pixels, 1
    while n < _MOST_BINNED and min(mean.shape) >= 2 * _SMALLEST_PX:
        mean, largest, n = *_binned(mean, largest), 2 * n
        coarse = Frame(
            largest, frame.saturation_level, frame.step / n, np.zeros((2, 2), np.int64)
        )
        coarse_tiles = tiles._replace(y=tiles.y // n, x=tiles.x // n)
        coarse_tiles.y[-1], coarse_tiles.x[-1] = mean.shape
        look = _filter(
            coarse, (mean, coarse_tiles), Psf(_FIRST_SIGMA_PX), asked, np.empty_like(mean)
        )
        found = image_psf(look.scene, look.peaks, look.psf, None)
        if found is not None:
            sigma = min(n * found.sigma_px, PSF_RANGE_PX[1])
            return Psf(sigma, n * found.dx_px, n * found.dy_px)
    return None


def _binned(residual: Plane, pixels: Plane) -> tuple[Plane, Plane]:
    """Return the mean of the residual and the largest pixel of each 2 x 2 pixels.

    The largest one tells whether one is saturated; NaN where one is not to be used.
    """
    height, width = (n // 2 * 2 for n in residual.shape)
    a, b, c, d = (residual[i:height:2, j:width:2] for i in (0, 1) for j in (0, 1))
    p, q, r, s = (pixels[i:height:2, j:width:2] for i in (0, 1) for j in (0, 1))
    mean = np.float32(0.25) * (a + b + c + d)
    return mean, np.maximum(np.maximum(p, q), np.maximum(r, s))


def _alike(a: Psf, b: Psf) -> bool:
    """Return whether what was found with one image of a star will do for the other."""
    ratio = math.sqrt((a.sigma_px**2 + PIXEL_VARIANCE) / (b.sigma_px**2 + PIXEL_VARIANCE))
    turned = min(
        math.hypot(a.dx_px - sign * b.dx_px, a.dy_px - sign * b.dy_px) for sign in (1, -1)
    )
    return 1 / _SAME_WIDTH < ratio < _SAME_WIDTH and turned < _SAME_LINE * a.sigma_px
