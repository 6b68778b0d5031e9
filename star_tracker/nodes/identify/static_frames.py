"""Rotations between frames that are fixed to each other, as /tf_static tells them."""

import numpy as np

from star_tracker.geometry.spherical import Floats


class StaticFrames:
    """A forest of frames. Each has one parent at most; the newest word on a frame counts."""

    def __init__(self) -> None:
        self._parent: dict[str, tuple[str, Floats]] = {}

    def take(self, parent: str, child: str, rotation: Floats) -> None:
        """Take in the rotation (3, 3) that turns vectors in the child into the parent."""
        self._parent[child] = (parent, rotation)

    def rotation(self, into: str, of: str) -> Floats | None:
        """Return the rotation (3, 3) that turns vectors in `of` into `into`, None = not known."""
        above_of, above_into = self._above(of), self._above(into)
        shared = next((frame for frame in above_of if frame in above_into), None)
        if shared is None:
            return None
        return above_into[shared].T @ above_of[shared]

    def _above(self, frame: str) -> dict[str, Floats]:
        """Return each frame above one, itself first, with the rotation of its vectors into it."""
        found = {frame: np.eye(3)}
        while frame in self._parent:
            parent, rotation = self._parent[frame]
            if parent in found:  # a circle is no tree: it leads nowhere
                break
            found[parent] = rotation @ found[frame]
            frame = parent
        return found
