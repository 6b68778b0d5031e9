"""What the study found: a record for each contestant, camera and value of a sweep."""

import csv
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from star_tracker.solution import Status
from star_tracker.study.chunks import IDENTIFIED, MAPS, WRONG, Chunk, Outcomes
from star_tracker.study.configuration import Study
from star_tracker.study.contestants import Contestant
from star_tracker.study.troubles import COMBINED, Trouble, Value

#: Names of the records' sweeps that are none.
MAP, COMBINED_SWEEP = "map", "combined"
#: Standard normal quantile of a two-sided 95 % interval.
_Z = 1.959963984540054
_ARCSEC_PER_DEG = 3600.0


@dataclass(frozen=True)
class Record:
    """How a contestant did under one condition, or on one map.

    Attributes:
        method, form: the contestant.
        camera: name of the camera, `maps` for a map.
        sweep: the quantity that was varied, `combined` or `map`.
        value: its value, the name of the combined condition or the number of the map.
        condition: all that the frames suffer from, in words.
        n: number of frames; of stars for a map.
        identified_percent: solved with a right attitude (a right label); with the bounds of the
            95 % Wilson interval.
        wrong_percent: claimed to be solved, but wrong; with the bounds.
        unanswered_percent: the rest.
        n_timeout: how many of the rest met the deadline.
        tolerance_deg: boresight error up to which a solution is right; None for a map.
        median_error_arcsec: median boresight error of the right solutions; None without any.
        median_cpu_ms, p95_cpu_ms: CPU time of a solve.
        storage_bytes: size of the features that were searched.
    """

    method: str
    form: str
    camera: str
    sweep: str
    value: Value
    condition: str
    n: int
    identified_percent: float
    identified_low_percent: float
    identified_high_percent: float
    wrong_percent: float
    wrong_low_percent: float
    wrong_high_percent: float
    unanswered_percent: float
    n_timeout: int
    tolerance_deg: float | None
    median_error_arcsec: float | None
    median_cpu_ms: float
    p95_cpu_ms: float
    storage_bytes: int

    @property
    def contestant(self) -> Contestant:
        """Who it was."""
        return Contestant(self.method, self.form)


def wilson(k: int, n: int) -> tuple[float, float]:
    """Return the bounds of the 95 % Wilson score interval for k of n (n > 0), as fractions.

    E. B. Wilson, Probable inference, the law of succession, and statistical inference (1927).
    """
    p, z2 = k / n, _Z**2
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n**2))
    # At the ends the bound is exactly 0 or 1, but for rounding.
    return (0.0 if k == 0 else centre - half), (1.0 if k == n else centre + half)


def summarise(study: Study, results: dict[Chunk, Outcomes]) -> list[Record]:
    """Return a study's records: maps first, then sweep after sweep, then what is combined."""
    cells: dict[tuple[str, str, str], list[Outcomes]] = {}
    for chunk, result in results.items():
        cells.setdefault(chunk.cell, []).append(result)
    return [
        _record(place, contestant, cells[contestant.name, place.camera_name, place.condition])
        for place in _places(study) for contestant in study.contestants
    ]


@dataclass(frozen=True)
class _Place:
    """Where a record stands: all of it but the contestant."""

    camera_name: str
    sweep: str
    value: Value
    condition: str
    tolerance_deg: float | None


def _places(study: Study) -> Iterator[_Place]:
    for number in study.maps:
        yield _Place(MAPS, MAP, float(number), f"map {number}", None)

    def swept(sweep: str, value: Value, trouble: Trouble) -> Iterator[_Place]:
        for name, camera in study.cameras:
            yield _Place(name, sweep, value, trouble.name, trouble.correct_deg(camera))

    for sweep in study.sweeps:
        for value in sweep.values:
            yield from swept(sweep.quantity, value, sweep.trouble(value))
    for name in study.combined:
        yield from swept(COMBINED_SWEEP, name, COMBINED[name])


def _record(place: _Place, contestant: Contestant, results: list[Outcomes]) -> Record:
    outcomes = [outcome for result in results for outcome in result.outcomes]
    cpu_ms = [ms for result in results for ms in result.cpu_ms]
    errors = [
        error for result in results
        for outcome, error in zip(result.outcomes, result.error_deg, strict=False)
        if outcome == IDENTIFIED and error is not None
    ]
    n, right, wrong = len(outcomes), outcomes.count(IDENTIFIED), outcomes.count(WRONG)
    right_bounds, wrong_bounds = wilson(right, n), wilson(wrong, n)
    return Record(
        contestant.method, contestant.form, place.camera_name, place.sweep, place.value,
        place.condition, n,
        100 * right / n, 100 * right_bounds[0], 100 * right_bounds[1],
        100 * wrong / n, 100 * wrong_bounds[0], 100 * wrong_bounds[1],
        100 * (n - right - wrong) / n, outcomes.count(Status.TIMEOUT.value),
        place.tolerance_deg, float(np.median(errors)) * _ARCSEC_PER_DEG if errors else None,
        float(np.median(cpu_ms)), float(np.percentile(cpu_ms, 95)), results[0].storage_bytes,
    )


def write_csv(records: Iterable[Record], path: Path) -> None:
    """Write records as a table; what there is none of stays empty.

    Raises ValueError where the file cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(Record)])
            writer.writeheader()
            writer.writerows(asdict(record) for record in records)
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror}") from error


def read_csv(path: Path) -> list[Record]:
    """Read what `write_csv` wrote. Raises ValueError for another file."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        return [
            Record(**{name: read(row[name]) for name, read in _READERS.items()})  # type: ignore[arg-type]
            for row in rows
        ]
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} is no table of results: {error}; write it again") from error


def _value(text: str) -> Value:
    try:
        return float(text)
    except ValueError:
        return text


def _optional(text: str) -> float | None:
    return float(text) if text else None


_BY_TYPE: dict[object, Callable[[str], object]] = {
    str: str, int: int, float: float, Value: _value, float | None: _optional,
}
_READERS = {field.name: _BY_TYPE[field.type] for field in fields(Record)}
