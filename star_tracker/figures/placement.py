"""Where labels go so that they can be read: a small deterministic search, without matplotlib.

All lengths are in one unit, that of the picture (points or pixels); y is up. A box is
(left, bottom, right, top).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats

#: Directions in which a label may lie from its point, the preferred ones first, and how far
#: beyond the nearest possible place, in multiples of a label's height.
_DIRECTIONS_DEG = (0, 45, -45, 180, 135, -135, 90, -90, 22.5, -22.5, 157.5, -157.5)
_DISTANCES = (0.0, 0.7, 1.5, 2.4)
#: What it costs, in areas of the label, to cover another label, a symbol, the frame; and what a
#: less preferred place costs.
_COVERS_LABEL, _COVERS_SYMBOL, _LEAVES_FRAME = 40.0, 6.0, 60.0
_STEP, _DISTANCE = 0.01, 0.35
_ROUNDS = 4


@dataclass(frozen=True)
class Placed:
    """Where labels go.

    Attributes:
        centre: (n, 2) centres of the labels.
        shown: (n,) false for a label that would cover one that is shown.
        far: (n,) true where a line should lead from the point to the label.
    """

    centre: Floats
    shown: NDArray[np.bool_]
    far: NDArray[np.bool_]


def boxes(centre: Floats, size: Floats) -> Floats:
    """Return boxes (..., 4) for centres (..., 2) and sizes (..., 2)."""
    half = np.asarray(size) / 2
    return np.concatenate([centre - half, centre + half], axis=-1)


def overlap_area(a: Floats, b: Floats) -> Floats:
    """Return the common area of boxes (..., 4), broadcast against each other."""
    width = np.minimum(a[..., 2], b[..., 2]) - np.maximum(a[..., 0], b[..., 0])
    height = np.minimum(a[..., 3], b[..., 3]) - np.maximum(a[..., 1], b[..., 1])
    return np.asarray(np.maximum(width, 0.0) * np.maximum(height, 0.0))


def place_labels(
    points: Floats, sizes: Floats, gaps: Floats, symbols: Floats, frame: Floats
) -> Placed:
    """Place labels of `sizes` (n, 2) beside `points` (n, 2).

    Each label has a number of possible places around its point, at least `gaps` (n,) away; it
    takes the one that covers least of the other labels, of the `symbols` (m, 4), boxes, and of
    what lies outside of the `frame` (4,). The labels choose in turn, the most crowded first, and
    again in a few rounds. A label that still covers another one is not shown.
    """
    n = len(points)
    if n == 0:
        return Placed(np.zeros((0, 2)), np.zeros(0, bool), np.zeros(0, bool))
    where, far, fixed = _candidates(points, sizes, gaps, symbols, frame)
    # The more its best places cost, the earlier a label may choose.
    order = np.argsort(-np.sort(fixed, axis=1)[:, :4].sum(axis=1), kind="stable")
    chosen = np.full(n, -1)
    for _ in range(_ROUNDS):
        before = chosen.copy()
        for i in order:
            others = np.flatnonzero((chosen >= 0) & (np.arange(n) != i))
            taken = where[others, chosen[others]]
            common = overlap_area(where[i][:, None], taken[None]).sum(axis=1)
            cost = fixed[i] + _COVERS_LABEL * common / np.prod(sizes[i])
            chosen[i] = int(np.argmin(cost))
        if np.array_equal(before, chosen):
            break
    final = where[np.arange(n), chosen]
    return Placed(
        (final[:, :2] + final[:, 2:]) / 2, _readable(final, order), far[chosen]
    )


def _candidates(
    points: Floats, sizes: Floats, gaps: Floats, symbols: Floats, frame: Floats
) -> tuple[Floats, NDArray[np.bool_], Floats]:
    """Return the boxes (n, c, 4) to choose from, which are far (c,), and their costs (n, c)."""
    direction = np.radians(_DIRECTIONS_DEG)
    unit = np.column_stack([np.cos(direction), np.sin(direction)])
    steps = np.repeat(_DISTANCES, len(unit))
    unit = np.tile(unit, (len(_DISTANCES), 1))
    away = gaps[:, None] + steps[None] * sizes[:, 1:]
    # The label's nearest corner, or the middle of its nearest side, lies on the gap's circle.
    reach = np.sign(unit.round(9))[None] * (sizes / 2)[:, None]
    centre = points[:, None] + unit[None] * away[..., None] + reach
    where = boxes(centre, sizes[:, None])
    area = np.prod(sizes, axis=1)[:, None]
    inside = overlap_area(where, frame)
    # One label at a time: all at once would be gigabytes for a thousand stars.
    covered = np.array([
        overlap_area(its_own[:, None], symbols).sum(axis=1) for its_own in where
    ])
    preference = _STEP * np.tile(np.arange(len(direction)), len(_DISTANCES)) + _DISTANCE * steps
    cost = (
        preference[None] + _COVERS_SYMBOL * covered / area
        + _LEAVES_FRAME * (area - inside) / area
    )
    return where, steps > 1.0, cost


def _readable(final: Floats, order: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which of the boxes (n, 4) to show, so that none covers another."""
    shown = np.zeros(len(final), bool)
    for i in order:
        shown[i] = not np.any(overlap_area(final[i], final[shown]) > 0)
    return shown
