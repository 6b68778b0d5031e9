"""`star_tracker compare`: both methods and their paper forms side by side (paper, 5.4)."""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from star_tracker.camera import Camera
from star_tracker.catalog import StarCatalog
from star_tracker.commands.options import add_json_argument
from star_tracker.database import FeatureDatabase
from star_tracker.evaluation import CAMERAS, CONDITIONS, Score, score_condition, score_map
from star_tracker.match_group import MatchGroupSettings
from star_tracker.radial_cyclic import RadialCyclicSettings
from star_tracker.solution import SolveSettings
from star_tracker.star_maps import paper_maps
from star_tracker.tracker import StarTracker

_MAP_REPEATS = 5
_CAPTION = (
    "identified % / wrong % / median CPU ms; m: % missing, f: % false stars, sparse: 0.5 px, 60 % "
    "missing, comb: 0.5 px, 20 % missing, 50 % false, hard: 1 px, 40 % missing, 100 % false"
)


@dataclass(frozen=True)
class Contestant:
    """A method in one of its forms, with the size of the features that it searches, bytes."""

    name: str
    settings: SolveSettings
    database_bytes: int


@dataclass(frozen=True)
class Entry:
    """The score of one contestant under one condition, or on one map."""

    contestant: Contestant
    condition: str
    score: Score

    def as_record(self) -> dict[str, object]:
        """Return the entry as plain values with units in their names."""
        return {
            "method": self.contestant.name, "condition": self.condition, "n": self.score.n,
            "identified_percent": self.score.correct_percent,
            "wrong_percent": self.score.wrong_percent,
            "median_ms": self.score.median_ms, "p95_ms": self.score.p95_ms,
            "database_bytes": self.contestant.database_bytes,
        }


def contestants(database: FeatureDatabase, deadline_ms: float) -> tuple[Contestant, ...]:
    """Return both methods, each as this package and as the paper has it.

    The paper's form of match-group voting is plain flags at a tolerance of 3 px; that of the
    patterns ranks the guide stars by the printed f_T. What follows, alignment, pose and
    verification, is the same for both forms: only the way to the candidates is compared.
    """
    pairs, patterns = database.pairs.nbytes, database.patterns.packed.nbytes
    plain = MatchGroupSettings(
        pair_tolerance_px=(3.0,), cells=3, quick=False, voting="plain"
    )
    printed = RadialCyclicSettings(ring_factors=(1,), similarity="paper")
    return (
        Contestant(
            "match_group", SolveSettings(method="match_group", deadline_ms=deadline_ms), pairs
        ),
        Contestant(
            "match_group, paper",
            SolveSettings(method="match_group", match_group=plain, deadline_ms=deadline_ms), pairs,
        ),
        Contestant(
            "radial_cyclic", SolveSettings(method="radial_cyclic", deadline_ms=deadline_ms),
            patterns,
        ),
        Contestant(
            "radial_cyclic, paper",
            SolveSettings(method="radial_cyclic", radial_cyclic=printed, deadline_ms=deadline_ms),
            patterns,
        ),
    )


def run(
    database: FeatureDatabase, camera: Camera, n_frames: int, seed: int, deadline_ms: float
) -> Iterator[Entry]:
    """Yield all entries: the eight maps, then the conditions, each for all contestants."""
    field = contestants(database, deadline_ms)
    for star_map in paper_maps():
        for contestant in field:
            tracker = StarTracker(database, star_map.camera, contestant.settings)
            yield Entry(contestant, star_map.name, score_map(tracker, star_map, _MAP_REPEATS))
    for condition in CONDITIONS:
        for contestant in field:
            tracker = StarTracker(database, camera, contestant.settings)
            score = score_condition(tracker, condition, n_frames, seed)
            yield Entry(contestant, condition.name, score)


def table(entries: list[Entry], title: str) -> Table:
    """Lay the entries out, a row for each condition and a column for each contestant."""
    found = {(entry.condition, entry.contestant.name): entry.score for entry in entries}
    field = {entry.contestant.name: entry.contestant for entry in entries}
    result = Table(title=title, caption=_CAPTION)
    result.add_column("condition")
    for name in field:
        result.add_column(name.replace(", ", "\n"), justify="right")
    for condition in dict.fromkeys(entry.condition for entry in entries):
        scores = [found[condition, name] for name in field]
        result.add_row(condition.split(":")[0], *(
            f"{s.correct_percent:.3g}/{s.wrong_percent:.2g}/{s.median_ms:.3g}" for s in scores
        ))
    sizes = [f"{contestant.database_bytes / 1e6:.2f} MB" for contestant in field.values()]
    result.add_row("features", *sizes)
    return result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--frames", type=int, default=50, metavar="N", help="frames a condition (%(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=2019, metavar="N", help="seed of the frames (%(default)s)"
    )
    parser.add_argument(
        "--camera", choices=tuple(CAMERAS), default="12 deg",
        help="field of view of the camera (%(default)s)",
    )
    parser.add_argument(
        "--deadline-ms", type=float, default=500.0, metavar="MS",
        help="deadline of a frame, ms (%(default)s)",
    )
    add_json_argument(parser)


def execute(options: argparse.Namespace) -> None:
    """Run the comparison and print it. Raises ValueError for an option out of range."""
    if options.frames < 1 or options.seed < 0:
        raise ValueError("--frames must be at least 1 and --seed at least 0")
    database = FeatureDatabase.build(StarCatalog.paper())
    camera = CAMERAS[options.camera]
    total = 4 * (len(paper_maps()) + len(CONDITIONS))
    entries = []
    # The bar is for people: nothing of it is written where standard error is no terminal.
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task("comparing", total=total)
        for entry in run(database, camera, options.frames, options.seed, options.deadline_ms):
            entries.append(entry)
            progress.advance(task)
    if options.json:
        print(json.dumps([entry.as_record() for entry in entries], indent=2))
    else:
        title = f"eight maps, and {options.frames} frames a condition at {options.camera}"
        Console().print(table(entries, title))
