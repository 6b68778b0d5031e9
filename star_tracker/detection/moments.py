"""How wide a star is, and whether it is drawn to a line.

Adaptive moments (after Bernstein & Jarvis 2002, AJ 123, 583): the second moments of a star under
an elliptical Gaussian window that follows the star's own shape. Unlike plain moments they do not
grow with the window; what the window takes away is undone as for Gaussians, for which the result
is exact. Their window is the star itself; here it is a little wider, since one narrower than a
pixel would see nothing.
"""

import math

import numpy as np

from star_tracker.compiled import compiled
from star_tracker.detection.planes import Plane
from star_tracker.geometry.spherical import Floats

#: Variance by which the window is wider than the star, px^2, and least variance of a star: that
#: of a single pixel.
_WIDER_PX2, _LEAST_PX2 = 0.5, 1 / 12
#: Standard deviations of the window that are summed over, and the farthest that is looked at.
_WINDOW_SIGMAS, _FARTHEST_PX = 3.0, 75.0
#: What runs out of that is a line where its variance across is less than this part of that along.
_THIN = 0.01
_MAX_ITERATIONS = 25
_CONVERGED = 0.005
#: The window's variances grow by no more than this factor in a step, and its middle moves by no
#: more than its width.
_GROWTH = 3.0


@compiled
def adaptive_moments(residual: Plane, x: float, y: float, sigma_px: float) -> Floats:
    """Return x, y, px, and the moments xx, xy, yy, px^2, of what stands near (x, y).

    `sigma_px` is the width to begin with. All are NaN where it does not settle. Of a line that is
    longer than is looked at they are the last ones, and `is_endless`.
    """
    failed = np.full(5, np.nan)
    xx, xy, yy = sigma_px**2, 0.0, sigma_px**2
    for _ in range(_MAX_ITERATIONS):
        wx, wy = xx + _WIDER_PX2, yy + _WIDER_PX2
        total, dx, dy, sxx, sxy, syy = _weighted(residual, x, y, (wx, xy, wy))
        if not (total > 0.0 and sxx > 0.0 and syy > 0.0 and sxx * syy > sxy * sxy):
            return failed
        # A Gaussian of covariance C under a window W shows (1/C + 1/W)^-1.
        a, b, c = _inverse(sxx, sxy, syy)
        p, q, r = _inverse(wx, xy, wy)
        new = _inverse(a - p, b - q, c - r)
        if not (new[0] > 0.0 and new[2] > 0.0 and new[0] * new[2] > new[1] * new[1]
                and new[0] + new[2] < _GROWTH * (xx + yy)):
            scale = _GROWTH * (xx + yy) / (sxx + syy)  # more than the window can tell
            new = (scale * sxx, scale * sxy, scale * syy)
        new = (max(new[0], _LEAST_PX2), new[1], max(new[2], _LEAST_PX2))
        # The mean under the window is drawn to its middle: undone by C (1/C + 1/W).
        ux, uy = a * dx + b * dy, b * dx + c * dy
        bound = math.sqrt(max(wx, wy))
        x += min(max(new[0] * ux + new[1] * uy, -bound), bound)
        y += min(max(new[1] * ux + new[2] * uy, -bound), bound)
        change = abs(new[0] - xx) + abs(new[1] - xy) + abs(new[2] - yy)
        xx, xy, yy = new
        if not math.isfinite(x + y + xx + yy):
            return failed
        if _runs_out(xx, yy):
            half, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
            if half - spread < _THIN * (half + spread):
                return np.array([x, y, xx, xy, yy])
            return failed
        if change < _CONVERGED * (xx + yy):
            return np.array([x, y, xx, xy, yy])
    return failed


@compiled
def is_endless(moments: Floats) -> bool:
    """Return whether moments x, y, xx, xy, yy are those of a line longer than is looked at."""
    return _runs_out(moments[2], moments[4])


@compiled
def _runs_out(xx: float, yy: float) -> bool:
    return bool(_WINDOW_SIGMAS * math.sqrt(xx + yy) >= _FARTHEST_PX)


@compiled
def _inverse(xx: float, xy: float, yy: float) -> tuple[float, float, float]:
    """Return the inverse of a symmetrical matrix; infinite for a singular one."""
    determinant = xx * yy - xy * xy
    return yy / determinant, -xy / determinant, xx / determinant


@compiled
def _weighted(
    residual: Plane, x: float, y: float, window: tuple[float, float, float]
) -> tuple[float, float, float, float, float, float]:
    """Return the sum under a Gaussian window, the mean offset from (x, y), xx, xy and yy."""
    height, width = residual.shape
    a, b, c = _inverse(window[0], window[1], window[2])
    reach_x, reach_y = _WINDOW_SIGMAS * math.sqrt(window[0]), _WINDOW_SIGMAS * math.sqrt(window[2])
    total = sx = sy = sxx = sxy = syy = 0.0
    for row in range(max(0, int(y - reach_y)), min(height, int(y + reach_y) + 1)):
        dy = row + 0.5 - y
        for column in range(max(0, int(x - reach_x)), min(width, int(x + reach_x) + 1)):
            dx = column + 0.5 - x
            exponent = a * dx * dx + 2 * b * dx * dy + c * dy * dy
            if exponent < _WINDOW_SIGMAS**2:
                value = math.exp(-0.5 * exponent) * residual[row, column]
                total += value
                sx += value * dx
                sy += value * dy
                sxx += value * dx * dx
                sxy += value * dx * dy
                syy += value * dy * dy
    mx, my = sx / total, sy / total
    return total, mx, my, sxx / total - mx * mx, sxy / total - mx * my, syy / total - my * my
