"""What commands print: tables for people, JSON for machines."""

from rich.console import Console
from rich.table import Table

from star_tracker.commands.options import Record, json_text


def print_result(record: Record, tables: list[Table], as_json: bool) -> None:
    """Print the record for machines or the tables for people."""
    if as_json:
        print(json_text(record, indent=2))
        return
    console = Console()
    for table in tables:
        console.print(table)


def bar_console() -> Console:
    """Return where a bar of progress is drawn: nowhere but on a terminal.

    rich 13 ends a bar with an empty line, even one that is not drawn.
    """
    console = Console(stderr=True)
    return console if console.is_terminal else Console(stderr=True, quiet=True)


def cell(value: object, spec: str) -> str:
    """Return a table cell, empty for a value that is not known."""
    return "" if value is None else format(value, spec)
