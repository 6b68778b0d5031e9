"""Planes of pixels that are used again from image to image.

Memory that comes fresh from the system is cleared page by page when it is first written, which
takes longer than all that is done to a pixel. So each thread keeps its planes. What they hold is
lost with the next image of that thread: nothing that is returned to a user may be one of them.
"""

import threading
from math import prod

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]

#: Planes of larger images are not kept: a thread holds 16 MB of each of five planes at the most.
KEPT_PIXELS = 4_000_000


class _Kept(threading.local):
    """The planes of a thread by what they are used for."""

    def __init__(self) -> None:
        self.planes: dict[str, Plane] = {}


_kept = _Kept()


def plane(name: str, shape: tuple[int, ...]) -> Plane:
    """Return a plane (h, w) for a purpose, holding anything; the next one of that name is it."""
    size = prod(shape)
    if size > KEPT_PIXELS:
        return np.empty(shape, np.float32)
    if name not in _kept.planes or _kept.planes[name].size < size:
        _kept.planes[name] = np.empty(size, np.float32)
    return _kept.planes[name][:size].reshape(shape)
