"""The report of a study: an HTML page, a Markdown page, a CSV table and a picture of all curves.

All are made of the same records; the HTML page (`data/report.html.jinja`) needs nothing else.
"""

import math
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import jinja2

from star_tracker.maps.simulation import CORRECT_DEG
from star_tracker.resources import package_version, resource_path, write_whole
from star_tracker.study.configuration import Study
from star_tracker.study.figures import alternative, curves_svg, write_overview
from star_tracker.study.plan import COMBINED, MAP
from star_tracker.study.quantities import NAMED, QUANTITIES
from star_tracker.study.records import Record, as_csv
from star_tracker.study.tables import axis_of, label, markdown_tables, optional

_TEMPLATE = "report.html.jinja"


@dataclass(frozen=True)
class Section:
    """A part of the page: a heading, a remark, and the records, all and by camera for curves."""

    anchor: str
    title: str
    remark: str
    records: list[Record]
    curves: dict[str, list[Record]]


@dataclass(frozen=True)
class Balance:
    """All frames and maps of one contestant."""

    name: str
    settings: str
    storage_bytes: int | None
    maps_right: str
    maps_lost: str
    n_frames: int
    n_wrong: int
    n_timeout: int


def write_report(study: Study, records: list[Record], notes: list[str], folder: Path) -> None:
    """Write report.html, report.md, results.csv and curves.png into a folder.

    `notes` are sentences about what was left out. Raises ValueError where a file cannot be
    written.
    """
    curves = [mine for part in sections(study, records) for mine in part.curves.values()]
    texts = {
        "results.csv": as_csv(records),
        "report.html": html_page(study, records, notes),
        "report.md": markdown_page(study, records, notes),
    }
    try:
        for name, text in texts.items():
            write_whole(path := folder / name, text)
        if curves:
            write_overview(curves, path := folder / "curves.png")
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror}") from error


def markdown_page(study: Study, records: list[Record], notes: list[str]) -> str:
    """Return who was measured, how, and the tables."""
    contestants = [f"- **{one.title}**: {one.settings}." for one in study.contestants]
    method = [f"- **{term}**: {text}" for term, text in definitions(study)]
    return "\n\n".join([
        f"# {study.title}", "\n".join(contestants + [f"- {note}." for note in notes]),
        "Cells: identified % / wrong % / median ms / 95th percentile ms.", "\n".join(method),
        *markdown_tables(study, records),
    ]) + "\n"


def html_page(study: Study, records: list[Record], notes: list[str]) -> str:
    """Return the page with curves and all numbers."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(resource_path(f"data/{_TEMPLATE}").parent),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )
    return environment.get_template(_TEMPLATE).render(
        study=study, balances=balances(study, records), sections=sections(study, records),
        definitions=definitions(study), notes=notes, label=label, number=optional,
        picture=curves_svg, words=alternative,
    )


def sections(study: Study, records: list[Record]) -> list[Section]:
    """Return the parts of the page: each sweep, the combined conditions, at last the maps."""
    found: dict[str, list[Record]] = {}
    for record in records:
        found.setdefault(record.sweep, []).append(record)
    parts = []
    for sweep, mine in sorted(found.items(), key=lambda item: item[0] == MAP):
        curves: dict[str, list[Record]] = {}
        for record in mine if sweep != MAP else []:
            curves.setdefault(record.camera, []).append(record)
        title = "The paper's star maps" if sweep == MAP else axis_of(sweep).title
        parts.append(Section(sweep, title, _remark(study, sweep), mine, curves))
    return parts


def _remark(study: Study, sweep: str) -> str:
    """Return what has to be known of a section."""
    if sweep == MAP:
        return "Rates are of the map's stars: those with the paper's number, or with another."
    if sweep == COMBINED:
        titled = (NAMED[name] for name in study.combined if NAMED[name].title)
        return "; ".join(condition.words for condition in titled) + "."
    bases = [dict(one.base) for one in study.sweeps if one.quantity == sweep]
    base = ", ".join(
        f"{QUANTITIES[key].title.lower()} ({QUANTITIES[key].label(value)})"
        for key, value in (bases[0] if bases else {}).items()
    )
    return f"Meanwhile: {base}." if base else ""


def balances(study: Study, records: list[Record]) -> list[Balance]:
    """Return what each contestant did in all; a condition that sweeps share counts once."""
    result = []
    for one in study.contestants:
        mine = [record for record in records if record.contestant == one.title]
        maps = [record for record in mine if record.sweep == MAP]
        lost = [str(int(float(r.value))) for r in maps if r.identified_percent < 100]
        frames = {(r.camera, r.condition): r for r in mine if r.sweep != MAP}.values()
        result.append(Balance(
            one.title, one.settings, mine[0].storage_bytes if mine else None,
            f"{len(maps) - len(lost)} of {len(maps)}" if maps else "",
            ", ".join(lost) or ("none" if maps else ""), sum(r.n for r in frames),
            sum(round(r.wrong_percent * r.n / 100) for r in frames),
            sum(r.n_timeout for r in frames),
        ))
    return result


def definitions(study: Study) -> list[tuple[str, str]]:
    """Return the terms of the report with what they mean."""
    noises = (
        f", or within {study.correct_noises:g} standard deviations of the centroid noise where "
        "that is more" if study.correct_noises else ", at any noise"
    )
    brightness = study.brightness_noise_mag
    deadline = study.deadline_ms
    packages = ["numpy", "scipy", "numba", *(
        one.package for one in study.contestants if one.package
    )]
    versions = ", ".join(f"{name} {version(name)}" for name in dict.fromkeys(packages))
    return [
        ("identified", f"solved, and the boresight lies within {CORRECT_DEG:g} deg of the true "
         f"one{noises}. The true attitude is that of the camera that took the frame: where "
         "another principal point is told, the angle between the two counts as an error."),
        ("wrong", "claimed to be solved, and farther off."),
        ("unanswered", "not solved, and said so."),
        ("bound", "frames that show four true stars or more, %."),
        ("error", "of the boresight, median over the identified frames."),
        ("beyond bound", "solved frames whose boresight is off by more than the 99 % bound of the "
         "covariance told with it, by chi-square of 2 degrees of freedom: 1 % where it is true."),
        ("intervals", "95 %, Wilson's. The bars of the curves are the same. Markers at one value "
         "stand side by side to be told apart."),
        ("CPU time", "of the process during a contestant's own call, from pixels to attitude, "
         "solved or not; other programs on the machine lengthen it, and all threads count."),
        ("frames", f"random attitudes, seed {study.seed}, the same frames for all contestants"
         f"{', who take turns' if study.interleave else ''}; the same seed gives the same results "
         "but for the times, on any number of processes."),
        ("brightness", "measured only where a condition says so." if brightness is None else
         f"a true star's magnitude is measured with a noise of {brightness:g} mag, a false star "
         "is as bright as any star."),
        ("deadline", "none." if math.isinf(deadline) else
         f"{deadline:g} ms of wall-clock time a frame for this package; the peers keep theirs."),
        ("features", "size of what a contestant searches."),
        ("software", f"star_tracker {package_version()}, Python {platform.python_version()}, "
         f"{versions}; {_processor()}."),
    ]


def _processor() -> str:
    """Return the processor's name, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
