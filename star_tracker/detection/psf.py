"""How a star looks: a Gaussian, drawn along a line where the camera turned, summed over pixels."""

import math
from typing import NamedTuple

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats

#: Beyond so many standard deviations a star adds nothing to speak of.
REACH_SIGMAS = 3.0
#: Variance that a pixel adds to what it sees, px^2.
PIXEL_VARIANCE = 1 / 12
#: Beside a line nothing is computed so far out: most of its window.
_NOTHING_SIGMAS = 5.0
_SQRT_HALF = math.sqrt(0.5)
_PEAK = 1 / math.sqrt(2 * math.pi)


class Psf(NamedTuple):
    """The image of a star.

    Attributes:
        sigma_px: standard deviation of the Gaussian.
        dx_px, dy_px: the line that the star moved along, up to its sign; 0, 0 = round.
    """

    sigma_px: float
    dx_px: float = 0.0
    dy_px: float = 0.0

    @property
    def streak_px(self) -> float:
        """Length of the line."""
        return math.hypot(self.dx_px, self.dy_px)

    @property
    def reach_px(self) -> tuple[int, int]:
        """How far a star reaches from the pixel of its middle, along x and along y."""
        around = REACH_SIGMAS * self.sigma_px + 0.5
        return (
            math.ceil(around + abs(self.dx_px) / 2), math.ceil(around + abs(self.dy_px) / 2)
        )


def gaussian_profile(sigma_px: float, reach_px: int) -> Floats:
    """Return what the pixels -reach to reach, (2 reach + 1,), see of a Gaussian at 0."""
    edges = np.arange(-reach_px, reach_px + 2) - 0.5
    below = np.array([0.5 * math.erfc(-e * _SQRT_HALF / sigma_px) for e in edges])
    return np.diff(below)


def flatness(psf: Psf) -> float:
    """Return the mean of a pixel's four neighbours over its own value, for a star in its middle.

    No star of this width is sharper. A line is as the neighbours along it are left out of it.
    """
    _, middle, beside = gaussian_profile(psf.sigma_px, 1)
    return float(beside / middle)


@compiled
def pixel_share(
    edge: float, centre: float, sigma: float
) -> tuple[float, float, float, float]:
    """Return a Gaussian's share below a pixel edge, its density there, and two derivatives.

    The derivatives are those of the share by the centre and by the logarithm of sigma.
    """
    off = edge - centre
    density = _PEAK / sigma * math.exp(-0.5 * (off / sigma) ** 2)
    return 0.5 * math.erfc(-off * _SQRT_HALF / sigma), density, -density, -off * density


@compiled
def round_shape(
    psf: Psf, x: float, y: float, corner: tuple[int, int], shape: Floats
) -> None:
    """Write what the pixels of a window see of a round star of flux 1 at (x, y), px.

    `shape` is (4, ny, nx): the star and its derivatives by x, by y and by the logarithm of its
    width. The window's first pixel is `corner`, (x, y).
    """
    ny, nx = shape.shape[1:]
    across, down = np.empty((3, nx)), np.empty((3, ny))
    for line, centre, first in ((across, x, corner[0]), (down, y, corner[1])):
        share, _, slope, growth = pixel_share(float(first), centre, psf.sigma_px)
        for i in range(line.shape[1]):
            below, slope_below, growth_below = share, slope, growth
            share, _, slope, growth = pixel_share(first + i + 1.0, centre, psf.sigma_px)
            line[0, i], line[1, i] = share - below, slope - slope_below
            line[2, i] = growth - growth_below
    for i in range(ny):
        for j in range(nx):
            shape[0, i, j] = across[0, j] * down[0, i]
            shape[1, i, j] = across[1, j] * down[0, i]
            shape[2, i, j] = across[0, j] * down[1, i]
            shape[3, i, j] = across[2, j] * down[0, i] + across[0, j] * down[2, i]


@compiled
def drawn_shape(
    psf: Psf, x: float, y: float, corner: tuple[int, int], shape: Floats
) -> None:
    """Write the same of a star that moved along the PSF's line, with (x, y) as its middle.

    Pixels are taken at their middles and as a part of the Gaussian's width, which is good to 1 %
    for sigma above 0.7 px. The width's derivative is left at 0.
    """
    length = math.hypot(psf.dx_px, psf.dy_px)
    along_x, along_y = psf.dx_px / length, psf.dy_px / length
    sigma = math.sqrt(psf.sigma_px**2 + PIXEL_VARIANCE)
    for i in range(shape.shape[1]):
        for j in range(shape.shape[2]):
            dx, dy = corner[0] + j + 0.5 - x, corner[1] + i + 0.5 - y
            u, v = along_x * dx + along_y * dy, along_x * dy - along_y * dx
            if abs(v) > _NOTHING_SIGMAS * sigma:
                shape[:, i, j] = 0.0
                continue
            end, end_density, _, _ = pixel_share(u + length / 2, 0.0, sigma)
            begin, begin_density, _, _ = pixel_share(u - length / 2, 0.0, sigma)
            across = _PEAK / sigma * math.exp(-0.5 * (v / sigma) ** 2)
            by_u = (end_density - begin_density) / length * across
            value = (end - begin) / length * across
            by_v = -v / sigma**2 * value
            shape[0, i, j] = value
            shape[1, i, j] = -(by_u * along_x - by_v * along_y)
            shape[2, i, j] = -(by_u * along_y + by_v * along_x)
            shape[3, i, j] = 0.0


@compiled
def star_shape(psf: Psf, x: float, y: float, corner: tuple[int, int], shape: Floats) -> None:
    """Write what the pixels of a window see of a star: `round_shape` or `drawn_shape`."""
    if psf.dx_px == 0.0 and psf.dy_px == 0.0:
        round_shape(psf, x, y, corner, shape)
    else:
        drawn_shape(psf, x, y, corner, shape)
