"""How well a star can be placed at all: the Cramer-Rao bound of a rendered star."""

import math

import numpy as np

from star_tracker.detection.psf import Psf, round_shape
from star_tracker.geometry.spherical import Floats


def position_bound_px(
    sigma_px: float,
    xy_px: tuple[float, float],
    electrons: float,
    *,
    noise_e: float,
    full_well_e: float = math.inf,
) -> tuple[float, float]:
    """Return the least standard deviations, x and y, px, of an unbiased centroid of a star.

    The star is a Gaussian summed over pixels with known width and background; its pixels have the
    variance noise^2 + what the star itself gives (King 1983; Winick 1986, JOSA A 3, 1809). A pixel
    that the star fills beyond `full_well_e` counts for nothing. In the limits of no background and
    of nothing else these are sigma / q and sqrt(2) sigma / q, q being the signal to noise.
    """
    reach = math.ceil(6 * sigma_px + 1)
    corner = (math.floor(xy_px[0]) - reach, math.floor(xy_px[1]) - reach)
    shape: Floats = np.empty((4, 2 * reach + 1, 2 * reach + 1))
    round_shape(Psf(sigma_px), *xy_px, corner, shape)
    light = electrons * shape[0]
    weight = np.where(light < full_well_e, 1 / (noise_e**2 + light), 0.0)
    slopes = electrons * shape[1:3].reshape(2, -1)
    information = (slopes * weight.ravel()) @ slopes.T
    variance = np.linalg.inv(information)
    return math.sqrt(variance[0, 0]), math.sqrt(variance[1, 1])


def signal_to_noise(
    sigma_px: float, electrons: float, *, noise_e: float, xy_px: tuple[float, float] = (0.5, 0.5)
) -> float:
    """Return the signal to noise of a star in the noise of its background alone."""
    reach = math.ceil(6 * sigma_px + 1)
    shape: Floats = np.empty((4, 2 * reach + 1, 2 * reach + 1))
    round_shape(Psf(sigma_px), *xy_px, (-reach, -reach), shape)
    return electrons * math.sqrt(float(np.sum(shape[0] ** 2))) / noise_e
