"""Which camera took a frame? Pairs frames with the CameraInfo of the same or an earlier stamp."""

from collections import deque

from star_tracker.optics.camera import Camera

#: How many cameras are remembered. A frame older than all of them takes none.
_REMEMBERED = 64


class CameraFeed:
    """The cameras announced so far, by stamp in nanoseconds.

    Two habits are served. Image drivers publish a CameraInfo with each frame, of the same stamp;
    it may arrive after the frame, and taking the one before would be wrong when the camera has
    changed. Others publish it once, when the node is already there; then the newest one that is
    not younger than the frame holds.
    """

    def __init__(self) -> None:
        self._cameras: deque[tuple[int, Camera]] = deque(maxlen=_REMEMBERED)
        self._with_each_frame = False

    def announce(self, stamp_ns: int, camera: Camera) -> None:
        """Remember a camera."""
        self._cameras.append((stamp_ns, camera))

    def exact(self, stamp_ns: int) -> Camera | None:
        """Return the camera announced for exactly this stamp, the last one if there are more."""
        found = [camera for stamp, camera in self._cameras if stamp == stamp_ns]
        self._with_each_frame |= bool(found)
        return found[-1] if found else None

    def settled(self, stamp_ns: int) -> Camera | None:
        """Return the camera of a frame if nothing that may still arrive can change it."""
        exact = self.exact(stamp_ns)
        if exact is not None or self._with_each_frame:
            return exact
        return self.best(stamp_ns)

    def best(self, stamp_ns: int) -> Camera | None:
        """Return the camera that holds at a stamp as far as is known now."""
        earlier = [(stamp, i) for i, (stamp, _) in enumerate(self._cameras) if stamp <= stamp_ns]
        return self._cameras[max(earlier)[1]][1] if earlier else None
