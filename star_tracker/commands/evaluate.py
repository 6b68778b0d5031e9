"""`star_tracker evaluate`: the robustness report."""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from star_tracker.commands.options import add_json_argument
from star_tracker.resources import resource_path

if TYPE_CHECKING:
    from star_tracker.study.configuration import Study
    from star_tracker.study.execution import Execute
    from star_tracker.study.records import Record

_INTERRUPTED = 130
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
        from star_tracker.study import configuration, execution, page, records
    except ModuleNotFoundError as error:
        raise ValueError(
            f"evaluate needs {error.name}: pip install 'star_tracker[report]'"
        ) from error
    study = configuration.read_study(options.config or resource_path("config/evaluation.yaml"))
    if options.quick:
        study = study.quick()
    if options.scheduler is None:
        execute_on = execution.local(options.jobs)
    else:
        execute_on = execution.on_cluster(options.scheduler)
    found = _run(study, execute_on, options.output / "chunks")
    records.write_csv(found, options.output / "results.csv")
    page.write_page(study, found, options.output / "report.html")
    if options.json:
        print(json.dumps([asdict(record) for record in found], indent=2, allow_nan=False))
        return
    console = Console()
    for table in _tables(study, found):
        console.print(table)
        console.print()
    print(f"{options.output / 'report.html'} has the curves, results.csv beside it the numbers")


def _run(study: "Study", execute_on: "Execute", folder: Path) -> list["Record"]:
    """Return the study's records; where the user ends it, end with one line and exit code 130."""
    from star_tracker.study import chunks, execution, records, store

    planned = chunks.plan(study)
    kept = store.Store(folder)
    # The bar is for people: nothing of it is written where standard error is no terminal.
    console = Console(stderr=True)
    try:
        with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
            task = bar.add_task("evaluating", total=len(planned))
            results = execution.run_all(
                planned, kept, execute_on, lambda n: bar.advance(task, n)
            )
    except KeyboardInterrupt:
        print(
            "star_tracker evaluate: ended; start the same command again to go on from here",
            file=sys.stderr,
        )
        raise SystemExit(_INTERRUPTED) from None
    if kept.damaged:
        print(
            f"star_tracker evaluate: {len(kept.damaged)} damaged files in {kept.folder} were "
            "computed again", file=sys.stderr,
        )
    return records.summarise(study, results)


def _tables(study: "Study", found: list["Record"]) -> list[Table]:
    """Lay the records out: the maps, then each camera."""
    from star_tracker.study.chunks import MAPS

    tables = []
    if study.maps:
        tables.append(_table(study, found, MAPS, "the paper's maps"))
    for name, _ in study.cameras:
        title = f"{study.frames} frames a condition at {name}"
        tables.append(_table(study, found, name, title))
    tables[-1].caption = _CAPTION
    return tables


def _table(study: "Study", found: list["Record"], camera: str, title: str) -> Table:
    """Return a table with a row for each condition and a column for each contestant."""
    from star_tracker.study.page import label

    # Without frames around the cells, so that four contestants go into 80 columns.
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    table.add_column("condition")
    for contestant in study.contestants:
        table.add_column(contestant.name.replace(", ", "\n"), justify="right")
    rows: dict[tuple[str, object], list[Record]] = {}
    for record in found:
        if record.camera == camera:
            rows.setdefault((record.sweep, record.value), []).append(record)
    sweep = None
    for (name, _), records in rows.items():
        if sweep not in {None, name}:
            table.add_section()
        sweep = name
        table.add_row(label(records[0]), *(
            f"{r.identified_percent:.3g}/{r.wrong_percent:.2g}/{r.median_cpu_ms:.3g}"
            for r in records
        ))
    table.add_section()
    sizes = (f"{record.storage_bytes / 1e6:.2f} MB" for record in records)
    table.add_row("features", *sizes)
    return table
