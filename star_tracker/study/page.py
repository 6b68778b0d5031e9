"""The report: one self-contained HTML page (`data/report.html.jinja`)."""

import math
import platform
from dataclasses import dataclass
from pathlib import Path

import jinja2
import numba
import numpy as np
import scipy

from star_tracker.maps.simulation import CORRECT_DEG
from star_tracker.resources import resource_path
from star_tracker.study.chunks import database, version
from star_tracker.study.configuration import Study
from star_tracker.study.figures import alternative, curves_svg
from star_tracker.study.records import COMBINED_SWEEP, MAP, Record
from star_tracker.study.troubles import COMBINED, QUANTITIES

_TEMPLATE = "report.html.jinja"


@dataclass(frozen=True)
class Section:
    """A part of the page: a heading, a remark, pictures and a table of records."""

    anchor: str
    title: str
    remark: str
    figures: tuple[tuple[str, str, str], ...]
    records: tuple[Record, ...]


@dataclass(frozen=True)
class Balance:
    """All frames and maps of one contestant."""

    name: str
    storage_bytes: int
    maps_right: str
    maps_lost: str
    n_frames: int
    n_wrong: int
    n_timeout: int


def label(record: Record) -> str:
    """Return what names a record's row in a table."""
    if record.sweep in QUANTITIES:
        return QUANTITIES[record.sweep].label(record.value)
    return record.condition if record.sweep == MAP else str(record.value)


def write_page(study: Study, records: list[Record], path: Path) -> None:
    """Write the report. Raises ValueError where the file cannot be written."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(resource_path(f"data/{_TEMPLATE}").parent),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )
    environment.globals["label"] = label
    text = environment.get_template(_TEMPLATE).render(
        study=study, balances=balances(study, records), sections=sections(study, records),
        correct_deg=CORRECT_DEG, n_guide_stars=len(database().catalog), version=version(),
        deadline=_deadline(study.deadline_ms), versions=_versions(),
    )
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror}") from error


def sections(study: Study, records: list[Record]) -> list[Section]:
    """Return the parts of the page: each sweep, the combined conditions, the maps."""
    found: dict[str, list[Record]] = {}
    for record in records:
        found.setdefault(record.sweep, []).append(record)
    parts = []
    for sweep in study.sweeps:
        mine = found[sweep.quantity]
        base = ", ".join(
            f"{QUANTITIES[key].title.lower()} ({QUANTITIES[key].label(value)})"
            for key, value in sweep.base
        )
        remark = f"Meanwhile: {base}." if base else ""
        parts.append(Section(
            sweep.quantity, QUANTITIES[sweep.quantity].title, remark, _figures(mine), tuple(mine)
        ))
    if COMBINED_SWEEP in found:
        remark = "; ".join(COMBINED[name].name for name in study.combined) + "."
        mine = found[COMBINED_SWEEP]
        parts.append(Section(COMBINED_SWEEP, "Combined troubles", remark, (), tuple(mine)))
    if MAP in found:
        remark = "Rates are of the map's stars: those with the paper's number, or with another."
        parts.append(Section(MAP, "The paper's star maps", remark, (), tuple(found[MAP])))
    return parts


def balances(study: Study, records: list[Record]) -> list[Balance]:
    """Return what each contestant did in all; a condition that sweeps share counts once."""
    result = []
    for contestant in study.contestants:
        mine = [record for record in records if record.contestant == contestant]
        maps = [record for record in mine if record.sweep == MAP]
        lost = [str(int(r.value)) for r in maps if r.identified_percent < 100]
        frames = {(r.camera, r.condition): r for r in mine if r.sweep != MAP}.values()
        result.append(Balance(
            contestant.name, mine[0].storage_bytes, f"{len(maps) - len(lost)} of {len(maps)}",
            ", ".join(lost) or "none", sum(r.n for r in frames),
            sum(round(r.wrong_percent * r.n / 100) for r in frames),
            sum(r.n_timeout for r in frames),
        ))
    return result


def _figures(records: list[Record]) -> tuple[tuple[str, str, str], ...]:
    """Return camera, picture and words for it, for each camera."""
    cameras: dict[str, list[Record]] = {}
    for record in records:
        cameras.setdefault(record.camera, []).append(record)
    return tuple(
        (camera, curves_svg(mine), alternative(mine)) for camera, mine in cameras.items()
    )


def _deadline(deadline_ms: float) -> str:
    return "none" if math.isinf(deadline_ms) else f"{deadline_ms:g} ms of wall-clock time a frame"


def _versions() -> str:
    libraries = ", ".join(
        f"{library.__name__} {library.__version__}" for library in (np, scipy, numba)
    )
    return f"Python {platform.python_version()}, {libraries}, {platform.machine()}"
