"""Does a frame fit in a mirror as well? Then its stars do not tell which parity is the true one.

Seen in a mirror, the identified stars would lie at other centroids of the same frame: all of them
where a reflection, and a turn, take them. Two of them, far from each other, and any two centroids
as far apart fix such a turn; a third star refuses nearly all.
"""

from typing import Any

import numpy as np

from star_tracker.compiled import compiled, inlined
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.cells import chord
from star_tracker.identification.judge import nearest_centroid

#: Of more centroids than this any star's mirror image is near one: they are not looked at, as that
#: would take longer than all else.
_MOST = 300

_Three = tuple[float, float, float]


@compiled
def fits_in_mirror(frame: Any, matches: Any, k: int, gate_px: float, focal_px: float) -> bool:
    """Return whether all of the first `k` matched centroids have a centroid for a mirror image.

    Those are to be within `gate_px` of their places, at a focal length of `focal_px`.
    """
    n, vectors, observed = frame.n, frame.vectors, matches.observed
    if n > _MOST:
        return False
    far, most = 0, 0.0
    for i in range(1, k):
        apart = chord(vectors, observed[0], observed[i])
        if apart > most:
            far, most = i, apart
    figure = np.empty((k, 3))
    axes = _axes(vectors[observed[0]], vectors[observed[far]])
    for i in range(k):
        u = vectors[observed[i]]
        for axis in range(3):
            a = axes[axis]
            figure[i, axis] = a[0] * u[0] + a[1] * u[1] + a[2] * u[2]
    tolerance = 2.0 * gate_px / focal_px
    for p in range(n):
        for q in range(n):
            if p != q and abs(chord(vectors, p, q) - most) <= tolerance:
                axes = _axes(vectors[p], vectors[q])
                if _is_there(frame, figure, axes, gate_px, focal_px):
                    return True
    return False


@inlined
def _axes(u: Floats, v: Floats) -> tuple[_Three, _Three, _Three]:
    """Return axes that two directions fix: u, towards v, and across both."""
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    length = max(np.sqrt(x * x + y * y + z * z), 1e-12)
    x, y, z = x / length, y / length, z / length
    towards = y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]
    return (u[0], u[1], u[2]), towards, (x, y, z)


@compiled
def _is_there(
    frame: Any, figure: Floats, axes: tuple[_Three, _Three, _Three], gate_px: float,
    focal_px: float,
) -> bool:
    """Return whether each star of a figure (k, 3), reflected, has a centroid near its place."""
    first, second, across = axes
    for i in range(len(figure)):
        a, b, c = figure[i]
        z = a * first[2] + b * second[2] - c * across[2]
        if not z > 0.0:
            return False
        x = (a * first[0] + b * second[0] - c * across[0]) / z * focal_px
        y = (a * first[1] + b * second[1] - c * across[1]) / z * focal_px
        if nearest_centroid(frame, x, y, gate_px)[0] < 0:
            return False
    return True
