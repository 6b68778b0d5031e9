"""Where the view of a node goes: a live screen, lines, or one view and the end. No ROS here."""

import math
from collections.abc import Callable
from typing import Protocol

from rich.console import Console
from rich.live import Live

from star_tracker.nodes.watch.model import Frame, Watched
from star_tracker.nodes.watch.record import json_line
from star_tracker.nodes.watch.view import View


class Output(Protocol):
    """What is told of the node that is watched."""

    def frame(self, watched: Watched, frame: Frame) -> None:
        """Take note of a frame; each comes once."""

    def look(self, watched: Watched, now_s: float) -> bool:
        """Called several times a second. Return whether to go on."""


class Lines:
    """A line for each frame.

    Args:
        line: makes it.
    """

    def __init__(self, line: Callable[[Watched, Frame], str]) -> None:
        self._line = line

    def frame(self, watched: Watched, frame: Frame) -> None:
        """Print the frame's line at once, also into a pipe."""
        print(self._line(watched, frame), flush=True)

    def look(self, _: Watched, __: float) -> bool:
        """Go on."""
        return True


class Screen:
    """The view on the whole terminal, until told to stop; its last state stays there.

    A context manager: on leaving the terminal is as it was, also after an error.
    """

    def __init__(self, console: Console, n_stars: int) -> None:
        self._console, self._n_stars = console, n_stars
        self._live = Live(console=console, screen=True, auto_refresh=False)
        self._last: View | None = None

    def __enter__(self) -> "Screen":
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()
        if self._last is not None:
            self._console.print(self._last)

    def frame(self, _: Watched, __: Frame) -> None:
        """A frame is shown with the next look: the eye needs no more."""

    def look(self, watched: Watched, now_s: float) -> bool:
        """Draw the view anew, and go on."""
        self._last = View(watched, now_s, self._n_stars, fits=True)
        self._live.update(self._last, refresh=True)
        return True


class Once:
    """One view, or one line of JSON, as soon as a frame and a report have been heard.

    What has been heard by `timeout_s` must do; `silent` afterwards says that it was nothing.

    Args:
        console: where the view goes.
        n_stars: stars to list at most.
        as_json: a line of JSON instead of a view.
        timeout_s: how long to wait at most.
    """

    def __init__(self, console: Console, n_stars: int, as_json: bool, timeout_s: float) -> None:
        self._console, self._n_stars, self._as_json = console, n_stars, as_json
        self._timeout_s = timeout_s
        self._until_s = math.inf
        self.silent = False

    def frame(self, _: Watched, __: Frame) -> None:
        """What there is to show is in the state."""

    def look(self, watched: Watched, now_s: float) -> bool:
        """Show and end, or go on waiting."""
        if self._until_s == math.inf:
            self._until_s = now_s + self._timeout_s
        complete = watched.frame is not None and watched.health is not None
        if not complete and now_s < self._until_s:
            return True
        if not watched.heard:
            self.silent = True
        elif self._as_json:
            print(json_line(watched, watched.frame))
        else:
            self._console.print(View(watched, now_s, self._n_stars))
        return False
