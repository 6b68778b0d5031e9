"""How long a frame may take so that those after it do not wait."""

from collections import deque

#: The mean is taken over so many frames: a burst that the queue holds is no faster stream.
_FRAMES = 10
#: The share of the time between two frames that a search may take; the rest is for all else.
_SHARE = 0.75
#: Nearly every sky is identified in a part of that, ms. A faster stream drops frames instead.
_LEAST_MS = 5.0


class Pace:
    """Measures the time between frames, and says what a frame may take of it."""

    def __init__(self) -> None:
        self._received_s: deque[float] = deque(maxlen=_FRAMES + 1)

    def deadline_ms(self, received_s: float, longest_ms: float) -> float:
        """Take in when a frame was received, s of one clock; return how long it may take, ms.

        That is `longest_ms` for the first two frames, which tell nothing, and never longer.
        """
        times = self._received_s
        times.append(received_s)
        if len(times) <= 2:  # the first two may come together, from before the start
            return longest_ms
        period_ms = 1e3 * (times[-1] - times[0]) / (len(times) - 1)
        return min(longest_ms, max(_SHARE * period_ms, _LEAST_MS))
