"""Hot pixels: sharper than any star that the lens can draw."""

import math

from star_tracker.compiled import compiled
from star_tracker.detection.stars import Scene, noise_at

#: A star has at least this part of the light beside its peak that the sharpest star of its width
#: has; where noise leaves room for that, so many standard deviations of it.
_HOT_SHARE, _HOT_SIGMAS = 0.5, 2.0
#: Colours of a Bayer pattern differ: a red star is faint beside a red pixel.
_HOT_SHARE_BAYER = 0.2


@compiled
def is_hot(scene: Scene, row: int, column: int, flatness: float) -> bool:
    """Return whether the highest pixel about a peak is sharper than any star."""
    height, width = scene.residual.shape
    y, x = row, column
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(column - 1, 0), min(column + 2, width)):
            if scene.residual[i, j] > scene.residual[y, x]:
                y, x = i, j
    bayer = scene.channel[1, 1] != scene.channel[0, 0] or scene.channel[0, 1] != 0
    beside, n = 0.0, 0
    for i in range(max(y - 1, 0), min(y + 2, height)):
        for j in range(max(x - 1, 0), min(x + 2, width)):
            if (i == y) != (j == x):
                beside += scene.residual[i, j]
                n += 1
    peak, share = scene.residual[y, x], _HOT_SHARE_BAYER if bayer else _HOT_SHARE
    room = _HOT_SIGMAS * noise_at(scene, column, row) / math.sqrt(n)
    return bool(beside / n + room < share * flatness * peak)
