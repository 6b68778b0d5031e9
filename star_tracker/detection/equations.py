"""The normal equations of a star's fit, and their solution.

Unknowns are the place (x and y), the logarithm of the width, the background and the flux of each
colour, in this order.
"""

import math
from typing import NamedTuple

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.detection.planes import Plane
from star_tracker.detection.stars import Scene, Star, Window
from star_tracker.geometry.spherical import Floats

#: Where an unknown stands, the first of those that are several; and the most that there are.
PLACE, WIDTH, BACKGROUND, FLUX, MOST_UNKNOWNS = 0, 2, 3, 4, 7


class Light(NamedTuple):
    """What is supposed of pixels of one colour.

    Attributes:
        flux, background: of the star, as far as they are known.
        variance: of a pixel without the star; `shot` is what the star adds for each unit.
        shot: see `Scene`.
        limit: pixels from this value on do not count.
    """

    flux: float
    background: float
    variance: float
    shot: float
    limit: float


@compiled
def equations(
    scene: Scene, star: Star, flux: Floats, window: Window, system: tuple[Floats, Floats]
) -> int:
    """Write the normal equations of a step, lower half; return the number of pixels that count."""
    normal, right = system
    for i in range(MOST_UNKNOWNS):
        right[i] = 0.0
        for j in range(i + 1):
            normal[i, j] = 0.0
    left, top = window.corner
    _, ny, nx = window.shape.shape
    # Of a Bayer pattern every second pixel of every second row has the same colour.
    apart = 1 if np.max(scene.channel) == 0 else 2
    n_pixels = 0
    for i in range(min(apart, ny)):
        for j in range(min(apart, nx)):
            colour = scene.channel[(top + i) & 1, (left + j) & 1]
            light = Light(
                flux[colour], star.background, star.noise * star.noise, scene.shot,
                scene.saturation_level,
            )
            n, sums = _sums(
                scene.pixels[top + i : top + ny : apart, left + j : left + nx : apart],
                scene.residual[top + i : top + ny : apart, left + j : left + nx : apart],
                window.shape[:, i::apart, j::apart], light,
            )
            _add_sums(sums, FLUX + colour, normal, right)
            n_pixels += n
    return n_pixels


@compiled
def _sums(
    pixels: Plane, residual: Plane, shape: Floats, light: Light
) -> tuple[int, tuple[float, ...]]:
    """Return how many pixels (m, n) of one colour count, and their sums for `_add_sums`.

    `shape` (4, m, n) is the star's there. The sums are numbers of their own, which stay in
    registers.
    """
    star, by_x, by_y, by_width = shape
    share, background = light.flux, light.background
    n_pixels = 0
    xx = xy = yy = xw = yw = ww = xb = yb = wb = bb = rx = ry = rw = rb = 0.0
    fx = fy = fw = fb = ff = rf = 0.0
    for i in range(star.shape[0]):
        for j in range(star.shape[1]):
            if not pixels[i, j] < light.limit:  # nor NaN
                continue
            n_pixels += 1
            seen = star[i, j]
            weight = 1.0 / (light.variance + light.shot * share * seen)
            off = weight * (residual[i, j] - background - share * seen)
            dx, dy, dw = share * by_x[i, j], share * by_y[i, j], share * by_width[i, j]
            wx, wy, wdw, ws = weight * dx, weight * dy, weight * dw, weight * seen
            xx, xy, yy = xx + wx * dx, xy + wx * dy, yy + wy * dy
            xw, yw, ww = xw + wx * dw, yw + wy * dw, ww + wdw * dw
            xb, yb, wb, bb = xb + wx, yb + wy, wb + wdw, bb + weight
            rx, ry, rw, rb = rx + off * dx, ry + off * dy, rw + off * dw, rb + off
            fx, fy, fw, fb = fx + ws * dx, fy + ws * dy, fw + ws * dw, fb + ws
            ff, rf = ff + ws * seen, rf + off * seen
    return n_pixels, (
        xx, xy, yy, xw, yw, ww, xb, yb, wb, bb, fx, fy, fw, fb, ff, rx, ry, rw, rb, rf,
    )


@compiled
def _add_sums(sums: tuple[float, ...], at: int, normal: Floats, right: Floats) -> None:
    """Add the sums of one colour's pixels, whose flux is unknown number `at`, to the equations."""
    k = 0
    for i in range(FLUX):
        for j in range(i + 1):
            normal[i, j] += sums[k]
            k += 1
    for j in range(FLUX):
        normal[at, j] += sums[k]
        right[j] += sums[k + FLUX + 1]
        k += 1
    normal[at, at] += sums[k]
    right[at] += sums[k + FLUX + 1]


@compiled
def solve(normal: Floats, right: Floats, n: int) -> bool:
    """Solve n symmetrical equations in place, by Cholesky; only the lower half is read."""
    for i in range(n):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            if i > j:
                normal[i, j] = total / normal[j, j]
            elif total > 1e-12 * abs(normal[i, i]):
                normal[i, i] = math.sqrt(total)
            else:
                return False
    for i in range(n):
        for k in range(i):
            right[i] -= normal[i, k] * right[k]
        right[i] /= normal[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= normal[k, i] * right[k]
        right[i] /= normal[i, i]
    return True
