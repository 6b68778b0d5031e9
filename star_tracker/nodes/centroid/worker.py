"""A thread that detects, so that the node goes on listening; one image waits, the newest."""

import threading
from collections.abc import Callable

from star_tracker.nodes.centroid.detector import Detection, IncomingImage


class Worker:
    """Detects in a thread of its own, one image after another.

    Args:
        prepare: called once, in the thread, before the first image.
        detect: called in the thread; must not raise.
        done: called in the thread with what it returned; must not take long.
    """

    def __init__(
        self, prepare: Callable[[], None], detect: Callable[[IncomingImage], Detection],
        done: Callable[[Detection], None],
    ) -> None:
        self._prepare, self._detect, self._done = prepare, detect, done
        self._changed = threading.Condition()
        self._waiting: IncomingImage | None = None
        self._ending = False
        self.ready = False
        #: Images in whose place a newer one came.
        self.n_overtaken = 0
        self._thread = threading.Thread(target=self._run, name="detection", daemon=True)
        self._thread.start()

    def put(self, image: IncomingImage) -> None:
        """Let an image be the next one."""
        with self._changed:
            self.n_overtaken += self._waiting is not None
            self._waiting = image
            self._changed.notify()

    def finish(self) -> None:
        """End the thread after the image that it is at."""
        with self._changed:
            self._ending = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        self._prepare()
        self.ready = True
        while (image := self._next()) is not None:
            self._done(self._detect(image))

    def _next(self) -> IncomingImage | None:
        """Wait for an image; None where the thread is to end."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._ending)
            image, self._waiting = self._waiting, None
            return None if self._ending else image
