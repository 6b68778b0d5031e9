"""Are the centroids evenly spread? What lies in a crowd fits guide stars by chance more often.

The evidence (`evidence.py`) takes unrelated centroids to lie anywhere in the image. A smudge, a
glint or a swarm does not: forty points in a twentieth of the image have four hundred times the
density, and some of them match guide stars far more often. So a frame is described by a second
model, too: a part of it (`share`) normally distributed about a middle, the rest anywhere. Where
that is the likelier one by the Bayesian information criterion (Schwarz 1978), the evidence of a
pose is reduced by how much likelier the places of its matched centroids are under it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled, struct

#: Fewer centroids are no crowd: three of four stars lie together often enough.
_FEWEST = 8
#: Rounds of the fit, by expectation and maximisation (Dempster et al. 1977).
_ROUNDS = 12
#: Evenly spread centroids have a generalised variance of a twelfth of the image, about; those that
#: have more than this part of that do not crowd, and are not looked at further.
_EVEN = 0.8
#: Parameters of the model: a share, a middle and a covariance.
_PARAMETERS = 6.0
#: Smallest standard deviation of a crowd, px.
_NARROWEST_PX = 1.0

#: The crowd of a frame, undistorted image coordinates in px:
#:
#: - known: whether it has been looked for; begins anew with each frame;
#: - share: part of the centroids in it, 0 = there is none;
#: - x, y: its middle;
#: - xx, xy, yy: its covariance, px^2.
CrowdType, Crowd = struct("Crowd", __name__, ("known", "share", "x", "y", "xx", "xy", "yy"))


@compiled
def no_crowd() -> Any:
    """Return the crowd of a frame in which none has been looked for."""
    return Crowd(False, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)


@compiled
def crowding(
    crowd: Any, frame: Any, area_px2: float, observed: NDArray[np.int64], k: int
) -> float:
    """Return log10 of how much likelier the crowd makes the places of k matched centroids.

    Never below 0: stars outside of a crowd are no better than stars where there is none.
    """
    if not crowd.known:
        _look_for_crowd(crowd, frame, area_px2)
    if crowd.share == 0.0:
        return 0.0
    total = 0.0
    for i in range(k):
        place = frame.plane_px[observed[i]]
        total += np.log(_density(crowd, place[0], place[1], area_px2))
    return max(total, 0.0) / np.log(10.0)


@compiled
def _density(crowd: Any, x: float, y: float, area_px2: float) -> float:
    """Return the density at a place in units of that of evenly spread centroids."""
    return _of_crowd(crowd, x, y, area_px2) + 1.0 - crowd.share


@compiled
def _of_crowd(crowd: Any, x: float, y: float, area_px2: float) -> float:
    """Return the part of the crowd in the density at a place."""
    dx, dy = x - crowd.x, y - crowd.y
    determinant = crowd.xx * crowd.yy - crowd.xy * crowd.xy
    half2 = 0.5 * (
        crowd.yy * dx * dx - 2 * crowd.xy * dx * dy + crowd.xx * dy * dy
    ) / determinant
    peak = area_px2 / (2 * np.pi * np.sqrt(determinant))
    return crowd.share * peak * np.exp(-half2)


@compiled
def _look_for_crowd(crowd: Any, frame: Any, area_px2: float) -> None:
    """Fit a crowd to a frame, and keep it if it describes the centroids better than none."""
    crowd.known, crowd.share = True, 0.0
    n, places = frame.n, frame.plane_px
    if n < _FEWEST:
        return
    crowd.share = 1.0
    _fit(crowd, frame, area_px2)
    spread = np.sqrt(max(crowd.xx * crowd.yy - crowd.xy * crowd.xy, 0.0))
    if spread > _EVEN * area_px2 / 12.0:
        crowd.share = 0.0
        return
    crowd.share = 0.5
    for _ in range(_ROUNDS):
        _fit(crowd, frame, area_px2)
    gain = -0.5 * _PARAMETERS * np.log(n)
    for j in range(n):
        gain += np.log(_density(crowd, places[j, 0], places[j, 1], area_px2))
    if gain <= 0.0:
        crowd.share = 0.0


@compiled
def _fit(crowd: Any, frame: Any, area_px2: float) -> None:
    """Fit the crowd anew, each centroid weighted by how likely it is one of it so far."""
    n, places = frame.n, frame.plane_px
    weight = x = y = xx = xy = yy = 0.0
    for j in range(n):
        px, py = places[j, 0], places[j, 1]
        w = 1.0
        if crowd.share < 1.0:
            mine = _of_crowd(crowd, px, py, area_px2)
            w = mine / (mine + 1.0 - crowd.share)
        weight += w
        x += w * px
        y += w * py
        xx += w * px * px
        xy += w * px * py
        yy += w * py * py
    if weight < 1.0:
        return
    x, y = x / weight, y / weight
    least = _NARROWEST_PX * _NARROWEST_PX
    crowd.share = min(weight / n, 1.0 - 1.0 / n)
    crowd.x, crowd.y = x, y
    crowd.xx, crowd.xy = xx / weight - x * x + least, xy / weight - x * y
    crowd.yy = yy / weight - y * y + least
