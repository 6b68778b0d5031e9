"""What a detector is asked for and what it gives."""

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats

#: Narrower than this no lens draws a star: the pixel itself is 0.29 px wide in this measure.
PSF_RANGE_PX = (0.4, 12.0)


class Flag(IntFlag):
    """What is special about a centroid.

    The last three are left out of what is returned, unless `DetectSettings.keep_suspects` asks
    for them; a streak is a suspect only among round stars.
    """

    SATURATED = 1
    EDGE = 2
    BLEND = 4
    STREAK = 8
    HOT = 16
    EXTENDED = 32


@dataclass(frozen=True)
class DetectSettings:
    """What the user decides. Raises ValueError for a value out of range, naming it.

    Attributes:
        threshold_sigma: least signal to noise of a star, in standard deviations of the filtered
            image's own local noise.
        max_stars: the brightest so many are returned. An identification wants some 25 to 60 guide
            stars in the image; the others are what no catalogue or field of view is perfect for.
        psf_sigma_px: width of a star's image, the standard deviation of a Gaussian; None = find
            out from each image. Of use where an image can hold few stars.
        saturation_level: pixel value from which on a pixel counts as saturated; None = the largest
            of the pixel type, or a plateau at the image's own largest value.
        keep_suspects: also return hot pixels, extended things and lone streaks, with their flags.
    """

    threshold_sigma: float = 5.0
    max_stars: int = 150
    psf_sigma_px: float | None = None
    saturation_level: float | None = None
    keep_suspects: bool = False

    def __post_init__(self) -> None:
        if not 3 <= self.threshold_sigma <= 100:
            raise ValueError("threshold_sigma must be from 3 to 100")
        if not 1 <= self.max_stars <= 5000:
            raise ValueError("max_stars must be from 1 to 5000")
        low, high = PSF_RANGE_PX
        if self.psf_sigma_px is not None and not low <= self.psf_sigma_px <= high:
            raise ValueError(f"psf_sigma_px must be from {low:g} to {high:g}")
        if self.saturation_level is not None and not np.isfinite(self.saturation_level):
            raise ValueError("saturation_level must be a finite number")
        for name in ("threshold_sigma", "psf_sigma_px", "saturation_level"):
            value = getattr(self, name)
            if value is not None:  # an integer would have compiled code made anew for it
                object.__setattr__(self, name, float(value))


@dataclass(frozen=True)
class ImageQuality:
    """What an image is like as a whole.

    Attributes:
        background: median level between the stars, in units of the image.
        noise: median standard deviation of a pixel about the background.
        psf_sigma_px: width of the stars, the standard deviation of a Gaussian before the pixels
            have widened it.
        streak_px: (dx, dy) that the stars moved during the exposure, up to its sign; (0, 0) where
            they are round.
        saturation_level: pixel value from which on pixels count as saturated, infinity for none.
        n_peaks: places that were looked at.
    """

    background: float = float("nan")
    noise: float = float("nan")
    psf_sigma_px: float = float("nan")
    streak_px: tuple[float, float] = (0.0, 0.0)
    saturation_level: float = float("inf")
    n_peaks: int = 0


@dataclass(frozen=True)
class Centroids:
    """The stars of one image, the brightest first.

    Attributes:
        x_px, y_px: (n,) middle of the star; the origin is the outer corner of the first pixel, so
            a star on the middle of the first pixel has 0.5, 0.5.
        flux: (n,) sum over the star's image of what it adds to the background; estimated where
            saturated.
        snr: (n,) flux over the standard deviation that the background's noise gives it. Along
            each axis the centroid's own is about sqrt(2) size / snr, less where the star's photons
            are the noise.
        peak: (n,) highest pixel above the background.
        size_px: (n,) width, the standard deviation of a Gaussian.
        flags: (n,) uint8, sums of `Flag`.
        quality: the image as a whole.
    """

    x_px: Floats
    y_px: Floats
    flux: Floats
    snr: Floats
    peak: Floats
    size_px: Floats
    flags: NDArray[np.uint8]
    quality: ImageQuality

    def __len__(self) -> int:
        return len(self.x_px)

    @property
    def xy_px(self) -> Floats:
        """The centroids as (n, 2)."""
        return np.column_stack([self.x_px, self.y_px])

    def flagged(self, flag: Flag) -> NDArray[np.bool_]:
        """Return which centroids (n,) have any of some flags."""
        return np.asarray((self.flags & flag) != 0)

    @classmethod
    def none(cls, quality: ImageQuality) -> "Centroids":
        """Return what an image without stars gives."""
        empty = np.empty(0)
        return cls(empty, empty, empty, empty, empty, empty, np.empty(0, np.uint8), quality)
