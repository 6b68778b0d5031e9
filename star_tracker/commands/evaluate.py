"""`star_tracker evaluate`: the robustness report."""

import argparse
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from star_tracker.commands.options import add_json_argument
from star_tracker.commands.printing import bar_console
from star_tracker.resources import resource_path

if TYPE_CHECKING:
    from star_tracker.study.chunks import Chunk, Outcomes
    from star_tracker.study.configuration import Study
    from star_tracker.study.execution import Execute
    from star_tracker.study.records import Record
    from star_tracker.study.scenes import Image

_CAPTION = (
    "identified % / wrong but claimed solved % / median CPU ms; comb: 0.5 px, 20 % missing, "
    "50 % false; hard: 1 px, 40 % missing, 100 % false; sparse: 0.5 px, 60 % missing"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--output", type=Path, default=Path("evaluation"), metavar="DIR",
        help="where report and results go, and from where a run resumes (%(default)s)",
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE",
        help="what to measure, a YAML file (config/evaluation.yaml)",
    )
    parser.add_argument(
        "--images", type=Path, metavar="DIR",
        help="real images for a study that asks for them, with truth.csv and centroids.csv (none)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="few frames and values: under a minute"
    )
    parser.add_argument(
        "--jobs", type=int, default=0, metavar="N",
        help="processes, 0 = one for each core (%(default)s)",
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler, for instance tcp://host:8786 (this "
        "machine's processes)",
    )
    add_json_argument(parser)


def execute(options: argparse.Namespace) -> None:
    """Run the study and write the report. Raises ValueError for what cannot be used."""
    try:  # all that need a library, before anything is done
        from star_tracker.study import execution, plan, records, report
    except ModuleNotFoundError as error:
        raise ValueError(
            f"evaluate needs {error.name}: apt install python3-{error.name}, or pip install "
            "matplotlib jinja2 joblib PyYAML"
        ) from error
    study, images, notes = _prepared(options)
    for note in notes:
        _say(note)
    if options.scheduler is None:
        execute_on = execution.local(options.jobs)
    else:
        execute_on = execution.on_cluster(options.scheduler)
    results = _run(plan.plan(study, images), execute_on, options.output / "chunks")
    found = records.summarise(study, results)
    report.write_report(study, found, notes, options.output)
    if options.json:
        print(json.dumps([asdict(record) for record in found], indent=2, allow_nan=False))
        return
    console = Console()
    for table in _tables(study, found):
        console.print(table)
        console.print()
    print(f"{options.output / 'report.html'} has the curves, results.csv beside it the numbers")


def _prepared(options: argparse.Namespace) -> tuple["Study", list["Image"], list[str]]:
    """Return the study of what is there, its real images, and sentences about what is not."""
    from star_tracker.study import configuration, plan, scenes

    study = configuration.read_study(options.config or resource_path("config/evaluation.yaml"))
    study, notes = plan.installed(study.quick() if options.quick else study)
    images: list[Image] = []
    if study.images:
        try:
            images = scenes.read_images(options.images)
        except ValueError as error:
            study = replace(study, images=())
            notes.append(f"real images are left out: {error}")
    return study, images, [*notes, *plan.absences(study)]


def _run(
    planned: list["Chunk"], execute_on: "Execute", folder: Path
) -> dict["Chunk", list["Outcomes"]]:
    """Return the results of all chunks; where the user ends it, say how to go on."""
    from star_tracker.study import execution, store

    kept = store.Store(folder)
    # The bar is for people: nothing of it is written where standard error is no terminal.
    console = bar_console()
    try:
        with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
            task = bar.add_task("evaluating", total=len(planned))
            results = execution.run_all(
                planned, kept, execute_on, lambda n: bar.advance(task, n)
            )
    except KeyboardInterrupt:
        _say("ended; start the same command again to go on from here")
        raise
    if kept.damaged:
        _say(f"{len(kept.damaged)} damaged files in {kept.folder} were computed again")
    return results


def _say(text: str) -> None:
    print(f"star_tracker evaluate: {text}", file=sys.stderr)


def _tables(study: "Study", found: list["Record"]) -> list[Table]:
    """Lay the records out: the maps, then each camera."""
    from star_tracker.study import chunks, tables

    result = []
    for camera, rows in tables.rows(found).items():
        frames = f"{study.frames} frames a condition at {camera}"
        title = {chunks.MAPS: "the paper's maps", chunks.IMAGES: camera}.get(camera, frames)
        # Without frames around the cells, so that four contestants go into 80 columns.
        table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, show_edge=False)
        table.add_column("condition")
        for contestant in study.contestants:
            table.add_column(contestant.title.replace(", ", "\n"), justify="right")
        for row, after in zip(rows, [*rows[1:], None], strict=True):
            table.add_row(
                row.label, *row.cells(study, tables.short_score),
                end_section=after is None or after.sweep != row.sweep,
            )
        table.add_row("features", *rows[-1].cells(study, tables.megabytes))
        result.append(table)
    if result:
        result[-1].caption = _CAPTION
    return result
