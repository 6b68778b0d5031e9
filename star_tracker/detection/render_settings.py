"""What a rendered image is made of, and what comes of it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.centroids import PSF_RANGE_PX
from star_tracker.detection.image import BAYER_PATTERNS
from star_tracker.geometry.spherical import Floats

#: Numbers that must not be negative.
_NOT_NEGATIVE = (
    "sky_e_per_s", "read_noise_e", "row_banding_e", "column_banding_e", "hot_pixel_e",
    "clouds_mag", "bias_dn",
)


@dataclass(frozen=True)
class Planet:
    """A point of light that is in no catalogue: where it stands (ICRS), and its V magnitude."""

    ra_deg: float
    dec_deg: float
    v_mag: float


@dataclass(frozen=True)
class RenderSettings:
    """A sensor, its lens and the weather. Raises ValueError for a value out of range, naming it.

    The defaults are a small camera of 20 mm aperture: a star of V = 6 gives 1100 electrons.

    Attributes:
        exposure_s: time of exposure.
        zero_point_mag: V magnitude of a star that gives one electron a second.
        psf_sigma_px: width of a star, the standard deviation of a Gaussian.
        sky_e_per_s: background in the middle of the image, electrons a second and pixel.
        sky_gradient: change of the background across the width and across the height, as a part
            of the middle's.
        read_noise_e: standard deviation of a read-out, electrons.
        row_banding_e, column_banding_e: standard deviation of the rows' and columns' offsets.
        hot_pixels: part of the pixels that are hot.
        hot_pixel_e: their mean charge; it is distributed exponentially.
        full_well_e: largest charge of a pixel.
        bleeding: whether charge beyond it runs along the column; else it is lost.
        gain_e_per_dn: electrons for each unit of the image.
        bias_dn: level of no charge.
        bits: of the converter, 8 to 16; up to 8 give uint8, more uint16.
        bayer: colours of the first two pixels of the first two rows, such as `rggb`; empty for a
            sensor without colours.
        bayer_response: what red, green and blue pixels see of the light.
        rate_deg_s: the camera's rate of turn about its x, y and z axis.
        planets: what is in no catalogue.
        clouds_mag: extinction where the clouds are thickest; 0 for none.
        clouds_scale_px: size of a cloud.
        seed: of all chance; the same seed gives the same image.
    """

    exposure_s: float = 0.2
    zero_point_mag: float = 15.4
    psf_sigma_px: float = 1.0
    sky_e_per_s: float = 200.0
    sky_gradient: tuple[float, float] = (0.0, 0.0)
    read_noise_e: float = 5.0
    row_banding_e: float = 0.0
    column_banding_e: float = 0.0
    hot_pixels: float = 0.0
    hot_pixel_e: float = 2000.0
    full_well_e: float = 20_000.0
    bleeding: bool = False
    gain_e_per_dn: float = 5.0
    bias_dn: float = 50.0
    bits: int = 12
    bayer: str = ""
    bayer_response: tuple[float, float, float] = (0.7, 1.0, 0.6)
    rate_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    planets: tuple[Planet, ...] = ()
    clouds_mag: float = 0.0
    clouds_scale_px: float = 100.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in _NOT_NEGATIVE:
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be 0 or more")
        for name in ("exposure_s", "full_well_e", "gain_e_per_dn", "clouds_scale_px"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be greater than 0")
        low, high = PSF_RANGE_PX
        if not low <= self.psf_sigma_px <= high:
            raise ValueError(f"psf_sigma_px must be from {low:g} to {high:g}")
        if not 0 <= self.hot_pixels <= 1:
            raise ValueError("hot_pixels must be from 0 to 1")
        if not 8 <= self.bits <= 16:
            raise ValueError("bits must be from 8 to 16")
        if self.bayer and self.bayer not in BAYER_PATTERNS:
            raise ValueError(
                f"bayer {self.bayer!r} is unknown: use {', '.join(BAYER_PATTERNS)} or none"
            )
        if not np.all(np.isfinite([*self.rate_deg_s, *self.sky_gradient, self.zero_point_mag])):
            raise ValueError("rate_deg_s, sky_gradient and zero_point_mag must be finite numbers")

    @property
    def saturation_dn(self) -> float:
        """Largest value of a pixel: the full well or the converter's end."""
        return min(self.bias_dn + self.full_well_e / self.gain_e_per_dn, 2.0**self.bits - 1)

    def electrons(self, v_mag: Floats) -> Floats:
        """Return what stars of V magnitudes (n,) give in an exposure without clouds."""
        return np.asarray(self.exposure_s * 10 ** (-0.4 * (v_mag - self.zero_point_mag)))


@dataclass(frozen=True)
class RenderedImage:
    """An image and what is in it.

    Attributes:
        image: (h, w) uint8 or uint16.
        xy_px: (n, 2) where the stars stand in the middle of the exposure; some stand up to a few
            widths outside of the image.
        catalog_index: (n,) catalogue index, -1 for a planet.
        electrons: (n,) their charge, clouds subtracted, before saturation and colour filters.
        rotation: (3, 3) attitude in the middle of the exposure, camera to ICRS.
    """

    image: NDArray[np.uint8] | NDArray[np.uint16]
    xy_px: Floats
    catalog_index: NDArray[np.int64]
    electrons: Floats
    rotation: Floats
