"""What the log says of a stream of frames: the first fix, lost, found again, what would help."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from star_tracker.identification.labels import StarState
from star_tracker.solution import Solution, Status

#: So many frames in a row without a solution, and the fix is lost: a cloud passes in fewer.
_LOST = 3
#: Shortest time between two lines of the same kind, s.
QUIET_S = 10.0
#: The same for a hint on frames that are solved.
_HINT_S = 60.0


@dataclass(frozen=True)
class Line:
    """A line for the log, and whether it is a warning."""

    text: str
    warns: bool = False


class Announcements:
    """Follows a stream of frames and says what has changed.

    While nothing is solved there is a line every ten seconds at most, with what would help. Times
    are seconds of a clock that never goes back.
    """

    def __init__(self) -> None:
        self._solved_once = self._lost = False
        self._n_solved = self._n_unsolved = 0
        self._said_s = self._hint_said_s = -np.inf
        self._hint, self._hint_s = "", -np.inf

    def on_frame(self, solution: Solution, hint: str, now_s: float) -> Line | None:
        """Take in how a frame ended; return what there is to say, if anything."""
        if hint:
            self._hint, self._hint_s = hint, now_s
        if solution.attitude is not None:
            return self._on_fix(solution, hint, now_s)
        self._n_unsolved += 1
        if self._n_unsolved < _LOST or now_s - self._said_s < QUIET_S:
            return None
        if solution.status is Status.BAD_INPUT:  # of which there is a complaint
            return None
        self._said_s = now_s
        if not self._solved_once:
            text = f"no fix in {self._n_unsolved} frames"
        elif self._lost:
            text = f"still no fix, for {self._n_unsolved} frames"
        else:
            text = f"lost after {self._n_solved} solved frames"
        self._lost = True
        return Line(f"{text}: {solution.status.value}: {solution.reason}{self._help(now_s)}", True)

    def _on_fix(self, solution: Solution, hint: str, now_s: float) -> Line | None:
        first, again, n = not self._solved_once, self._lost, self._n_unsolved
        self._solved_once, self._lost, self._n_unsolved = True, False, 0
        self._n_solved = 1 if again else self._n_solved + 1
        if first:
            return Line(f"first fix: {fix(solution)}")
        if again:
            return Line(f"found again after {n} frames: {fix(solution)}")
        if hint and now_s - self._hint_said_s >= _HINT_S:
            self._hint_said_s = now_s
            return Line(f"solved, but {hint}", True)
        return None

    def _help(self, now_s: float) -> str:
        """Return what would help, where that was found out of late."""
        return f"; {self._hint}" if now_s - self._hint_s <= QUIET_S else ""


class Throttle:
    """Lets one complaint of each kind through every ten seconds, and counts the others."""

    def __init__(self) -> None:
        self._said_s: dict[str, float] = {}
        self._held_back: Counter[str] = Counter()

    def passed(self, kind: str, text: str, now_s: float) -> str:
        """Return what to say of a complaint, empty for nothing."""
        if now_s - self._said_s.get(kind, -np.inf) < QUIET_S:
            self._held_back[kind] += 1
            return ""
        self._said_s[kind] = now_s
        n = self._held_back.pop(kind, 0)
        return f"{text} ({n} more of this kind)" if n else text


def boresight(solution: Solution) -> str:
    """Say where a solved frame's camera points, in degrees."""
    ra, dec = np.degrees([solution.attitude.ra_rad, solution.attitude.dec_rad])
    return f"RA {ra:.3f} Dec {dec:+.3f}"


def fix(solution: Solution) -> str:
    """Say a solved frame in a few words."""
    state = solution.identification.state
    n = int((state == StarState.IDENTIFIED).sum())
    return f"{boresight(solution)}, {n} of {len(state)} stars"


def frame_line(solution: Solution) -> str:
    """Say how a frame ended in one line."""
    if solution.attitude is None:
        return f"{solution.status.value}: {solution.reason}"
    return (
        f"{solution.status.value}: {fix(solution)}, rms {solution.rms_px:.2f} px, "
        f"{solution.solve_ms:.2f} ms"
    )
