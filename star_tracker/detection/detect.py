"""The whole path: image -> background -> filtered image -> peaks -> stars."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from star_tracker.detection.centroids import Centroids, DetectSettings, Flag, ImageQuality
from star_tracker.detection.image import as_frame
from star_tracker.detection.look import Look, look_at
from star_tracker.detection.measure import Hunt, measure
from star_tracker.detection.psf import flatness
from star_tracker.detection.refine import refine, shot_noise
from star_tracker.detection.stars import STAR

#: Smaller images hold no star with sky around it.
_SMALLEST_PX = 5


def detect_stars(
    image: ArrayLike,
    settings: DetectSettings | None = None,
    *,
    bayer: str = "",
    mask: ArrayLike | None = None,
    dark: ArrayLike | None = None,
) -> Centroids:
    """Return the stars of an image, the brightest first.

    Args:
        image: (h, w) or (h, w, 1, 3 or 4) real numbers of any type and byte order; colours are
            averaged, the fourth is opacity. Pixels that are not finite are left out.
        settings: threshold, number of stars and little else.
        bayer: colours of the first two pixels of the first two rows, such as `rggb`, where the
            image is a colour sensor's raw one.
        mask: (h, w), not 0 where a pixel is not to be used, as in numpy.ma.
        dark: (h, w), a frame without light and of the same exposure, subtracted.

    An image in which there are no stars gives none. Raises ValueError for what is no image, a
    mask or a dark frame of another size, and an image too large, naming the remedy.
    """
    asked = settings or DetectSettings()
    frame = as_frame(
        image, bayer=bayer, mask=mask, dark=dark, saturation_level=asked.saturation_level
    )
    if min(frame.pixels.shape) < _SMALLEST_PX or frame.is_blank:
        return Centroids.none(ImageQuality())
    look = look_at(frame, asked)
    return _centroids(_measure(look, asked), asked, _quality(look))


def _measure(look: Look, asked: DetectSettings) -> NDArray[np.void]:
    """Return the stars, and suspects, at the peaks as rows of `STAR`."""
    scene, peaks, psf = look.scene, look.peaks, look.psf
    stars, fluxes = np.zeros(len(peaks), STAR), np.empty((len(peaks), 3))
    hunt = Hunt(psf, flatness(psf), asked.threshold_sigma, asked.max_stars, asked.keep_suspects)
    n = measure(scene, peaks, look.brightness, hunt, (stars, fluxes))
    lit = scene._replace(shot=shot_noise(scene, stars, n, fluxes, psf))
    refine(lit, stars, n, fluxes, psf)
    return stars[:n]


def _quality(look: Look) -> ImageQuality:
    usable = np.isfinite(look.tiles.noise)
    return ImageQuality(
        float(np.median(look.tiles.level[usable])), float(np.median(look.scene.noise[usable])),
        look.psf.sigma_px, (look.psf.dx_px, look.psf.dy_px), look.scene.saturation_level,
        len(look.peaks),
    )


def _centroids(
    stars: NDArray[np.void], asked: DetectSettings, quality: ImageQuality
) -> Centroids:
    """Return the stars that were asked for, the brightest first, and suspects if asked for."""
    suspects = Flag.HOT | Flag.EXTENDED
    if quality.streak_px == (0.0, 0.0):
        suspects |= Flag.STREAK
    else:
        stars["flags"][stars["flags"] & suspects == 0] |= Flag.STREAK
    suspect = stars["flags"] & suspects != 0
    good = stars[~suspect & (stars["snr"] >= asked.threshold_sigma)]
    kept = good[np.argsort(-good["flux"], kind="stable")][: asked.max_stars]
    if asked.keep_suspects:
        kept = np.concatenate([kept, stars[suspect]])
    x, y, flux, snr, peak, size = (
        np.ascontiguousarray(kept[name]) for name in ("x", "y", "flux", "snr", "peak", "sigma")
    )
    return Centroids(x, y, flux, snr, peak, size, kept["flags"].astype(np.uint8), quality)
