"""star_tracker against other star identifiers: the same stars, the same frames, the same run.

`python benchmark/peers_benchmark.py` (`make benchmark`) takes a few minutes; `--full` takes 1000
frames a condition. Every frame is handed to all contestants in turn, so that the machine's moods
hit all alike; who goes first changes from frame to frame. Timed is CPU time of this process around
a contestant's own call. A returned solution is correct if its boresight is within 0.1 deg of the
true one, whatever the noise, else wrong; the rest of the frames are unsolved. The peers come with
`pip install '.[benchmark]'`; one that is not installed is left out.
"""

import argparse
import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from peers import Contestant, Entry, starting_list
from peers_report import Row, results_page, tables, write_plot
from star_tracker.optics.camera import Camera
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.maps.simulation import boresight_angle_deg
from star_tracker.study.scoring import Score
from star_tracker.maps.simulation import CAMERAS, CONDITIONS, CORRECT_DEG, Condition, frames
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import SyntheticField

FOLDER = Path(__file__).resolve().parent
#: Frames a condition, and how many of them a slow contestant sees: by default and with --full.
FRAMES, SLOW_FRAMES = 40, 10
FULL_FRAMES, FULL_SLOW_FRAMES = 1000, 100
#: Frames of each of these before the first that counts: caches are filled, code is compiled.
_WARM_UP = 5
_WARM_UP_CONDITIONS = (Condition("easy", 0.0), Condition("hard", 1.0, 0.4, 1.0))
#: Four stars are the fewest that anyone here calls a solution.
_MIN_STARS = 4


def judge(found: Floats | None, true: Floats) -> str:
    """Return `correct`, `wrong` or `unsolved` for a found and a true rotation, camera to ICRS."""
    if found is None:
        return "unsolved"
    # A NaN is no place in the sky.
    return "correct" if boresight_angle_deg(found, true) <= CORRECT_DEG else "wrong"


def timed(contestant: Contestant, frame: SyntheticField) -> tuple[Floats | None, float]:
    """Solve one frame; return the rotation, camera to ICRS, and the CPU time of the solve, ms."""
    given = contestant.prepare(frame)
    started = time.process_time_ns()
    answer = contestant.solve(given)
    cpu_ms = (time.process_time_ns() - started) / 1e6
    return contestant.rotation(answer), cpu_ms


def why_missing(package: str) -> str:
    """Return why a package cannot be imported, in one line; empty where it can."""
    try:
        importlib.import_module(package)
    except ImportError as error:
        return f"{package} is left out: {error}"
    return ""


def installed(entries: tuple[Entry, ...]) -> tuple[list[Entry], list[str]]:
    """Return the entries whose package can be imported, and a line for each package that can't."""
    packages = dict.fromkeys(entry.package for entry in entries if entry.package)
    missing = {package: reason for package in packages if (reason := why_missing(package))}
    return [entry for entry in entries if entry.package not in missing], list(missing.values())


def run(
    entries: list[Entry], cameras: dict[str, Camera], n: int, seed: int,
    advance: Callable[[], Any] = lambda: None,
) -> Iterator[Row]:
    """Yield a row for each camera and condition; `advance` is called after each frame."""
    catalog = StarCatalog.paper()
    for camera_name, camera in cameras.items():
        field = [(entry, entry.build(catalog, camera)) for entry in entries]
        for condition in _WARM_UP_CONDITIONS:
            score(field, frames(catalog, camera, condition, _WARM_UP, seed + 1))
        for condition in CONDITIONS:
            for _, contestant in field:
                contestant.tell_noise(condition.noise_px)
            scores, bound = score(field, frames(catalog, camera, condition, n, seed), advance)
            yield Row(camera_name, condition.name, bound, scores)


def score(
    field: list[tuple[Entry, Contestant]], condition_frames: Iterator[SyntheticField],
    advance: Callable[[], Any] = lambda: None,
) -> tuple[dict[str, Score], float]:
    """Let all contestants solve the frames in turn.

    Returns the scores by the entries' names, and the percentage of frames that show at least four
    true stars.
    """
    verdicts: dict[str, list[str]] = {entry.name: [] for entry, _ in field}
    times: dict[str, list[float]] = {entry.name: [] for entry, _ in field}
    solvable = []
    for i, frame in enumerate(condition_frames):
        solvable.append(int(np.sum(frame.catalog_index >= 0)) >= _MIN_STARS)
        # Each frame another one goes first: it finds the processor's caches full of other things.
        first = i % len(field)
        for entry, contestant in field[first:] + field[:first]:
            if i % entry.every == 0:
                rotation, cpu_ms = timed(contestant, frame)
                verdicts[entry.name].append(judge(rotation, frame.rotation))
                times[entry.name].append(cpu_ms)
        advance()
    scores = {
        name: Score(
            len(verdict), verdict.count("correct"), verdict.count("wrong"), np.array(times[name])
        )
        for name, verdict in verdicts.items()
    }
    return scores, 100.0 * float(np.mean(solvable))


def options_of(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line; --full stands for numbers of frames that are not given."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, help=f"frames a condition ({FRAMES})")
    parser.add_argument(
        "--slow-frames", type=int, help=f"of these, how many ruststartracker sees ({SLOW_FRAMES})"
    )
    parser.add_argument(
        "--full", action="store_true",
        help=f"{FULL_FRAMES} frames a condition, {FULL_SLOW_FRAMES} for ruststartracker",
    )
    parser.add_argument("--seed", type=int, default=2019, help="seed of the frames (2019)")
    parser.add_argument("--camera", choices=tuple(CAMERAS), help="one camera only")
    parser.add_argument(
        "--output", type=Path, default=FOLDER / "results",
        help="folder for table and plot (benchmark/results)",
    )
    parser.add_argument(
        "--write-results", action="store_true", help="write benchmark/RESULTS.md, too"
    )
    options = parser.parse_args(arguments)
    usual = (FULL_FRAMES, FULL_SLOW_FRAMES) if options.full else (FRAMES, SLOW_FRAMES)
    options.frames = usual[0] if options.frames is None else options.frames
    options.slow_frames = usual[1] if options.slow_frames is None else options.slow_frames
    if min(options.frames, options.slow_frames) < 1 or options.seed < 0:
        parser.error("--frames and --slow-frames must be at least 1 and --seed at least 0")
    return options


def measure(options: argparse.Namespace, entries: list[Entry], console: Console) -> list[Row]:
    """Run everything behind a progress bar, which is shown on a terminal only."""
    cameras = {
        name: camera for name, camera in CAMERAS.items() if options.camera in (None, name)
    }
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    )
    with Progress(
        *columns, console=console, disable=not console.is_terminal, transient=True
    ) as progress:
        task = progress.add_task("frames", total=len(cameras) * len(CONDITIONS) * options.frames)
        return list(
            run(entries, cameras, options.frames, options.seed, lambda: progress.advance(task))
        )


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark, print its tables and write the files."""
    options = options_of(arguments)
    console = Console(stderr=True)
    entries, remarks = installed(starting_list(-(-options.frames // options.slow_frames)))
    for remark in remarks:
        console.print(remark, markup=False, highlight=False, soft_wrap=True)
    rows = measure(options, entries, console)
    page = results_page(rows, entries, options.seed)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "peers.md").write_text(page, encoding="utf-8")
    print(tables(rows, entries))
    try:
        write_plot(rows, entries, options.output / "peers.png")
    except ImportError as error:
        console.print(f"no plot is drawn: {error}", markup=False, highlight=False)
    if options.write_results:
        (FOLDER / "RESULTS.md").write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
