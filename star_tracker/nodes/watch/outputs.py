"""Where the view of a node goes: a live screen, lines of JSON, or one view and the end."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.live import Live

from star_tracker.nodes.watch.record import json_line
from star_tracker.nodes.watch.state import Frame, Watched
from star_tracker.nodes.watch.view import view_of

#: Called several times a second with the state, the frames that are new in it, and the time in
#: seconds. Returns whether to go on.
Output = Callable[[Watched, list[Frame], float], bool]


def print_lines(watched: Watched, frames: list[Frame], _: float) -> bool:
    """Print a line of JSON for each frame, at once also into a pipe."""
    for frame in frames:
        print(json_line(watched, frame), flush=True)
    return True


@contextmanager
def screen(console: Console, n_stars: int) -> Iterator[Output]:
    """Give an output that draws on the whole terminal; the last view stays there afterwards."""
    live = Live(console=console, screen=True, auto_refresh=False)

    def draw(watched: Watched, _: list[Frame], now_s: float) -> bool:
        live.update(view_of(watched, now_s, n_stars), refresh=True)
        return True

    try:
        with live:
            yield draw
    finally:
        console.print(live.get_renderable())


class Once:
    """One view as soon as a whole frame and a report have been heard, or else after `timeout_s`.

    Topics are found one after the other: the first frame that is heard may lack its stars.

    Args:
        show: prints the view of the state at a time.
        timeout_s: how long to wait.
    """

    def __init__(self, show: Callable[[Watched, float], None], timeout_s: float) -> None:
        self._show, self._timeout_s = show, timeout_s
        self._until_s: float | None = None
        #: Whether nothing was heard, and so nothing shown.
        self.silent = False

    def __call__(self, watched: Watched, _: list[Frame], now_s: float) -> bool:
        """Show and end, or wait longer."""
        self._until_s = self._until_s or now_s + self._timeout_s
        frame, reported = watched.frame, bool(watched.reports)
        whole = frame is not None and frame.complete
        if not (whole and reported) and now_s < self._until_s:
            return True
        self.silent = frame is None and not reported
        if not self.silent:
            self._show(watched, now_s)
        return False
