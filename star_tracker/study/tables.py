"""Records laid out as tables: a row for each condition, a column for each contestant."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from star_tracker.study.configuration import Study
from star_tracker.study.plan import MAP
from star_tracker.study.quantities import COMBINED, QUANTITIES, Quantity, Value
from star_tracker.study.records import Record


@dataclass(frozen=True)
class Row:
    """The records of one condition at one camera, by the contestants' titles."""

    sweep: str
    label: str
    bound_percent: float | None
    records: dict[str, Record]

    def cells(self, study: Study, cell: Callable[[Record], str]) -> list[str]:
        """Return a cell for each contestant, empty where it takes no part."""
        found = (self.records.get(one.title) for one in study.contestants)
        return [cell(record) if record else "" for record in found]


def axis_of(sweep: str) -> Quantity:
    """Return what a sweep varies; the name of a condition counts as a quantity, too."""
    return QUANTITIES.get(sweep, COMBINED)


def label(record: Record) -> str:
    """Return what names a record's row."""
    return record.condition if record.sweep == MAP else axis_of(record.sweep).label(record.value)


def rows(records: Iterable[Record]) -> dict[str, list[Row]]:
    """Return the rows of each camera's table, in the order of the records."""
    cells: dict[str, dict[tuple[str, Value], list[Record]]] = {}
    for record in records:
        cells.setdefault(record.camera, {}).setdefault(
            (record.sweep, record.value), []
        ).append(record)
    return {
        camera: [
            Row(sweep, label(found[0]), found[0].bound_percent, {r.contestant: r for r in found})
            for (sweep, _), found in places.items()
        ]
        for camera, places in cells.items()
    }


def score(r: Record) -> str:
    """Return identified % / wrong % / median ms / 95th percentile ms."""
    rates = f"{r.identified_percent:.1f} / {r.wrong_percent:.1f}"
    return f"{rates} / {three_digits(r.median_cpu_ms)} / {three_digits(r.p95_cpu_ms)}"


def short_score(r: Record) -> str:
    """Return identified % / wrong % / median ms, as short as can be."""
    return f"{r.identified_percent:.3g}/{r.wrong_percent:.2g}/{r.median_cpu_ms:.3g}"


def megabytes(record: Record) -> str:
    """Return the size of the features."""
    size = record.storage_bytes
    return "" if size is None else f"{size / 1e6:.2f} MB"


def ratio(record: Record) -> str:
    """Return the first contestant's median time over that of this one."""
    return "" if record.time_ratio is None else three_digits(record.time_ratio)


def beyond_bound(record: Record) -> str:
    """Return how many solved frames are beyond the bound of their covariance, and wrong ones."""
    if record.beyond_bound_percent is None:
        return ""
    n_wrong = round(record.wrong_percent * record.n / 100)
    return f"{record.beyond_bound_percent:.1f} / {record.n_wrong_beyond} of {n_wrong}"


def three_digits(value: float) -> str:
    """Return a number with three significant digits, or whole."""
    digits = 2 - math.floor(math.log10(value)) if value > 0 else 0
    return f"{value:.{max(0, digits)}f}"


def optional(value: float | None, spec: str) -> str:
    """Return a number in a format, nothing for none."""
    return "" if value is None else format(value, spec)


def markdown_table(head: list[str], body: Iterable[list[str]]) -> str:
    """Return a table in Markdown; all columns but the first are numbers."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, rule, *body])


def markdown_tables(study: Study, records: list[Record]) -> list[str]:
    """Return headings and tables of each camera: the scores, then the ratios of times."""
    first, *others = (one.title for one in study.contestants)
    n_frames = [f"{-(-study.frames // one.every)} frames" for one in study.contestants]
    parts = []
    for camera, found in rows(records).items():
        simulated = any(row.bound_percent is not None for row in found)
        names = [
            f"{name}<br>{n}" if simulated else name
            for name, n in zip([first, *others], n_frames, strict=True)
        ]
        bound = [[optional(row.bound_percent, ".1f")] if simulated else [] for row in found]
        parts += [f"## {camera}", markdown_table(
            ["condition", *(["bound"] if simulated else []), *names],
            [
                [row.label, *share, *row.cells(study, score)]
                for row, share in zip(found, bound, strict=True)
            ],
        )]
        if others:
            parts += [
                f"Median time of {first} divided by that of the others, on the frames that they "
                "saw (below 1: the other is slower):",
                markdown_table(
                    ["condition", *others],
                    [[row.label, *row.cells(study, ratio)[1:]] for row in found],
                ),
            ]
        parts += _covariances(study, found)
    return parts


def _covariances(study: Study, found: list[Row]) -> list[str]:
    """Return how true the covariances are of those contestants that tell one; nothing for none."""
    body = [[row.label, *row.cells(study, beyond_bound)] for row in found]
    names = ["condition", *(one.title for one in study.contestants)]
    told = [at for at in range(len(names)) if any(cells[at] for cells in body)]
    if len(told) < 2:
        return []
    return [
        "Solved frames beyond the 99 % bound of the covariance told with them, % (1 where it is "
        "true) / how many of the wrong ones are:",
        markdown_table([names[at] for at in told], [[cells[at] for at in told] for cells in body]),
    ]
