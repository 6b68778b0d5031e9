"""The stars of an image as they are fitted, and the image that they are fitted to."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled
from star_tracker.detection.planes import Plane
from star_tracker.detection.psf import REACH_SIGMAS, Psf, star_shape
from star_tracker.geometry.spherical import Floats

#: A star as it is fitted. `background` is relative to the image's own; `unexplained` is what of
#: the star's square the fit leaves over beyond the noise; `reach` how far the star's saturated
#: pixels lie from its middle; `neighbours` how many other stars share its pixels.
STAR = np.dtype([
    ("x", "f8"), ("y", "f8"), ("sigma", "f8"), ("flux", "f8"), ("background", "f8"),
    ("peak", "f8"), ("noise", "f8"), ("snr", "f8"), ("unexplained", "f8"), ("reach", "f8"),
    ("flags", "i8"), ("neighbours", "i8"),
])
Stars = NDArray[np.void]
#: One row of them; what numpy says of a row does not know its fields.
Star = Any


class Scene(NamedTuple):
    """What stars are fitted to.

    Attributes:
        residual: (h, w) image without background; fitted stars are taken out of it and put back.
        pixels: (h, w) image, NaN where not to be used.
        saturation_level: from which value on a pixel does not count.
        channel: (2, 2) colours of a Bayer pattern.
        noise: (ny, nx) standard deviation of a pixel in each tile, as the filtered image has it.
        shot: variance that a star adds to a pixel, for each unit that it adds to its value.
    """

    residual: Plane
    pixels: Plane
    saturation_level: float
    channel: NDArray[np.int64]
    noise: Floats
    shot: float


class Window(NamedTuple):
    """The pixels of a fit: the first column and row, and (4, ny, nx) of `psf.star_shape`."""

    corner: tuple[int, int]
    shape: Floats


@compiled
def noise_at(scene: Scene, x: float, y: float) -> float:
    """Return the standard deviation of a pixel near (x, y)."""
    height, width = scene.residual.shape
    ny, nx = scene.noise.shape
    row, column = int(y * ny / height), int(x * nx / width)
    return float(scene.noise[min(max(row, 0), ny - 1), min(max(column, 0), nx - 1)])


@compiled
def window_of(scene: Scene, star: Star, psf: Psf, sigmas: float) -> Window:
    """Return the window of a star within the image, to so many of its widths."""
    height, width = scene.residual.shape
    around = sigmas * star.sigma + 0.5 + star.reach
    reach_x, reach_y = around + 0.5 * abs(psf.dx_px), around + 0.5 * abs(psf.dy_px)
    left, top = max(0, int(star.x - reach_x)), max(0, int(star.y - reach_y))
    right, bottom = min(width, int(star.x + reach_x) + 1), min(height, int(star.y + reach_y) + 1)
    return Window((left, top), np.empty((4, max(0, bottom - top), max(0, right - left))))


@compiled
def add_star(scene: Scene, star: Star, flux: Floats, psf: Psf, sign: float) -> None:
    """Put a star into the residual (sign 1) or take it out (-1)."""
    wide = Psf(star.sigma, psf.dx_px, psf.dy_px)
    window = window_of(scene, star, psf, REACH_SIGMAS)
    star_shape(wide, star.x, star.y, window.corner, window.shape)
    left, top = window.corner
    _, ny, nx = window.shape.shape
    for i in range(ny):
        for j in range(nx):
            colour = scene.channel[(top + i) & 1, (left + j) & 1]
            scene.residual[top + i, left + j] += sign * flux[colour] * window.shape[0, i, j]
