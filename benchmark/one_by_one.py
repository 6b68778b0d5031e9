"""How fast this package is beside one setting of one peer at a time.

`python benchmark/one_by_one.py [--frames 400] [--seed 2026] [--peers NAME,NAME]`: for each setting
of each peer of `benchmark.yaml`, or those that are named, a study of its own, of these two alone,
under the conditions of `benchmark.yaml`: our median CPU time over the peer's. There all take
turns, and most of them run the same peer's code, which favours that in the caches; here each has
the other between its own frames.
"""

import argparse
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.console import Console
from rich.progress import Progress

from star_tracker.study import execution, plan, records, store, tables
from star_tracker.study.configuration import Study, read_study
from star_tracker.study.contestants import Contestant
from star_tracker.study.own_methods import OwnMethod

STUDY = Path(__file__).with_name("benchmark.yaml")


def ratios(study: Study, own: Contestant, peer: Contestant) -> dict[tuple[str, str], str]:
    """Return our median time over the peer's, by camera and condition."""
    two = replace(study, contestants=(own, peer))
    console = Console(stderr=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        planned = plan.plan(two)
        task = bar.add_task(peer.title, total=len(planned))
        results = execution.run_all(
            planned, store.Store(Path(folder)), execution.local(1),
            lambda n: bar.advance(task, n),
        )
    found = records.summarise(two, results)
    return {
        (camera, row.label): tables.ratio(row.records[peer.title])
        for camera, rows in tables.rows(found).items() for row in rows
        if peer.title in row.records
    }


def main() -> None:
    """Print a table of all peers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--peers", default="", help="by commas; default: all")
    options = parser.parse_args()
    study, notes = plan.installed(read_study(STUDY))
    for note in notes:
        print(note, file=sys.stderr)
    study = replace(study, frames=options.frames, seed=options.seed, images=())
    own = study.contestants[0]
    named = options.peers.split(",") if options.peers else []
    peers = [
        one for one in study.contestants
        if not isinstance(one, OwnMethod) and (not named or one.title in named)
    ]
    found = {peer.title: ratios(study, own, peer) for peer in peers}
    places = dict.fromkeys(place for column in found.values() for place in column)
    print(tables.markdown_table(["condition", *found], (
        [f"{camera}, {label}", *(column.get((camera, label), "") for column in found.values())]
        for camera, label in places
    )))


if __name__ == "__main__":
    main()
