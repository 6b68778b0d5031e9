"""When identify_node looks for what would solve its frames: seldom, in time that is left over.

Each look costs up to a tenth of a second (`calibration/hints.py` says for what). A frame that
shows no sky is searched to its deadline: the search of one that is to be looked at ends early.
"""

import time

from star_tracker.calibration.hints import hint, wants_hint
from star_tracker.geometry.spherical import Floats
from star_tracker.solution import Solution, Status
from star_tracker.tracker import StarTracker

#: Shortest time between two frames that are looked at, s, and longest time for one, ms.
_PERIOD_S, _LONGEST_MS = 2.0, 100.0
#: The share of the deadline after which such a frame is given up, if the one before was unsolved.
_SHARE = 0.75
#: Frames in a row without a solution, after which a look need not keep up with the stream.
_HOPELESS = 10


class Hinter:
    """Looks at some of the frames that were not solved, or badly, for what would solve them."""

    def __init__(self) -> None:
        self._looked_s, self._n_unsolved = -_PERIOD_S, 0

    @property
    def due(self) -> bool:
        """Whether the next frame may be looked at."""
        return time.monotonic() - self._looked_s >= _PERIOD_S

    @property
    def at_leisure(self) -> bool:
        """Whether the next frame may take longer than a fast stream leaves.

        Where nothing is solved, nothing is lost.
        """
        return self.due and self._n_unsolved >= _HOPELESS

    def search_ms(self, deadline_ms: float) -> float:
        """Return the part of a frame's deadline that its search may take."""
        return _SHARE * deadline_ms if self.due and self._n_unsolved else deadline_ms

    def hint(
        self, tracker: StarTracker, xy_px: Floats, solution: Solution, deadline_ms: float
    ) -> str:
        """Return what would solve a frame, or solve it better; empty where that is not known.

        Args:
            tracker: what solved it, or did not.
            xy_px: (n, 2) its centroids.
            solution: how that ended.
            deadline_ms: of the frame; what the search has left of it is taken.
        """
        unsolved = solution.status in (Status.NO_MATCH, Status.TIMEOUT)
        self._n_unsolved = self._n_unsolved + 1 if unsolved else 0
        left_ms = deadline_ms - solution.solve_ms
        if not self.due or not wants_hint(solution) or left_ms <= 0:
            return ""
        self._looked_s = time.monotonic()
        tried = tracker.camera, tracker.settings
        return hint(tracker.database, tried, xy_px, solution, min(left_ms, _LONGEST_MS))
