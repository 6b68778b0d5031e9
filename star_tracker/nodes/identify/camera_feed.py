"""Which camera took a frame? Pairs frames with what was announced on camera_info."""

from collections import deque

from star_tracker.optics.camera import Camera

#: How many cameras are remembered. A frame older than all of them takes none, if they differ.
_REMEMBERED = 64
#: Of so many frames the last, this share has to have a CameraInfo of its own stamp, or else a
#: frame no longer waits for one: a driver may publish it for the first frame only, or for some.
_FRAMES, _MOST = 10, 0.8
#: How many cameras are kept apart by their frame_id.
_MOST_FEEDS = 16


class CameraFeed:
    """The cameras announced so far, by stamp in nanoseconds.

    Three habits are served. Image drivers publish a CameraInfo with each frame, of the same stamp;
    it may arrive after the frame, and taking the one before would be wrong when the camera has
    changed. Others publish it now and then; the newest one that is not younger than the frame
    holds. Others again publish it once, with any stamp: a camera that is the only one announced
    serves every frame, as there is no other that it could be.
    """

    def __init__(self) -> None:
        self._cameras: deque[tuple[int, Camera]] = deque(maxlen=_REMEMBERED)
        #: The last frames by stamp, and whether each had a CameraInfo of its own.
        self._partners: deque[tuple[int, bool]] = deque(maxlen=_FRAMES)
        #: Whether a frame has taken the only camera although that is younger than the frame.
        self.timeless = False

    def announce(self, stamp_ns: int, camera: Camera) -> None:
        """Remember a camera."""
        self._cameras.append((stamp_ns, camera))
        for i, (stamp, _) in enumerate(self._partners):  # some come after their frame
            if stamp == stamp_ns:
                self._partners[i] = (stamp, True)
        if self._only is None:
            self.timeless = False

    def settled(self, stamp_ns: int) -> Camera | None:
        """Return the camera of a frame if nothing that may still arrive can change it."""
        exact = self._exact(stamp_ns)
        if exact is not None or self._with_each_frame:
            return exact
        return self._earlier(stamp_ns) or (self._only if self.timeless else None)

    def best(self, stamp_ns: int) -> Camera | None:
        """Return the camera that holds at a stamp as far as is known now."""
        found = self._exact(stamp_ns) or self._earlier(stamp_ns)
        if found is None:
            found, self.timeless = self._only, self._only is not None
        return found

    def answered(self, stamp_ns: int) -> None:
        """Take in that a frame is through, and remember whether it had a camera of its own."""
        self._partners.append((stamp_ns, self._exact(stamp_ns) is not None))

    @property
    def _with_each_frame(self) -> bool:
        """Whether nearly every frame has a CameraInfo of its own."""
        found = [has for _, has in self._partners]
        return any(found) and sum(found) >= _MOST * len(found)

    @property
    def _only(self) -> Camera | None:
        """The camera, if all that were announced are the same."""
        cameras = [camera for _, camera in self._cameras]
        same = all(one is cameras[0] or one == cameras[0] for one in cameras)
        return cameras[0] if cameras and same else None

    def _exact(self, stamp_ns: int) -> Camera | None:
        """Return the camera announced for exactly this stamp, the last one if there are more."""
        found = [camera for stamp, camera in self._cameras if stamp == stamp_ns]
        return found[-1] if found else None

    def _earlier(self, stamp_ns: int) -> Camera | None:
        """Return the newest camera that is not younger than a stamp."""
        earlier = [(stamp, i) for i, (stamp, _) in enumerate(self._cameras) if stamp <= stamp_ns]
        return self._cameras[max(earlier)[1]][1] if earlier else None


class CameraFeeds:
    """The cameras of one topic, each by its frame_id.

    A detector may leave out the frame_id or give its frames another: where all that was announced
    has one, it does not matter what the frames have. Where it has several, several cameras share
    the topic, and a frame takes that of its own frame_id, or none.
    """

    def __init__(self) -> None:
        self._feeds: dict[str, CameraFeed] = {}
        #: What frames have that took the only camera under another frame_id, after one wait: that
        #: of their own might have been on its way.
        self._strangers: set[str] = set()

    @property
    def frame_ids(self) -> list[str]:
        """Under which frame_id cameras were announced."""
        return sorted(self._feeds)

    @property
    def timeless(self) -> bool:
        """Whether a frame has taken the only camera although that is younger than the frame."""
        return any(feed.timeless for feed in self._feeds.values())

    def announce(self, frame_id: str, stamp_ns: int, camera: Camera) -> None:
        """Remember a camera."""
        if frame_id not in self._feeds:
            if len(self._feeds) >= _MOST_FEEDS:
                self._feeds.pop(next(iter(self._feeds)))
            self._feeds[frame_id] = CameraFeed()
        self._feeds[frame_id].announce(stamp_ns, camera)

    def settled(self, frame_id: str, stamp_ns: int) -> Camera | None:
        """Return the camera of a frame if nothing that may still arrive can change it."""
        feed = self._of(frame_id)
        if feed is None or (frame_id and frame_id not in self._feeds.keys() | self._strangers):
            return None
        return feed.settled(stamp_ns)

    def best(self, frame_id: str, stamp_ns: int) -> Camera | None:
        """Return the camera that holds for a frame as far as is known now."""
        feed = self._of(frame_id)
        if feed is None:
            return None
        if frame_id not in self._feeds and len(self._strangers) < _MOST_FEEDS:
            self._strangers.add(frame_id)
        return feed.best(stamp_ns)

    def answered(self, frame_id: str, stamp_ns: int) -> None:
        """Take in that a frame is through."""
        feed = self._of(frame_id)
        if feed is not None:
            feed.answered(stamp_ns)

    def _of(self, frame_id: str) -> CameraFeed | None:
        if len(self._feeds) == 1:
            return next(iter(self._feeds.values()))
        return self._feeds.get(frame_id)
