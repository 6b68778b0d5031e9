"""What the study found: a record for each contestant, camera and value of a sweep."""

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields

import numpy as np

from star_tracker.geometry.spherical import ARCSEC_PER_RAD
from star_tracker.identification.ended import MIN_STARS
from star_tracker.solution import Status
from star_tracker.study.chunks import IDENTIFIED, WRONG, Chunk, Outcomes
from star_tracker.study.configuration import Study
from star_tracker.study.contestants import Contestant
from star_tracker.study.plan import Place, places
from star_tracker.study.quantities import Value

#: Standard normal quantile of a two-sided 95 % interval.
_Z = 1.959963984540054
#: The 99 % bound of chi-square with 2 degrees of freedom.
_BOUND = -2 * math.log(0.01)


@dataclass(frozen=True)
class Record:
    """How a contestant did under one condition, or on one map.

    Attributes:
        contestant: its title.
        camera: name of the camera, `maps` for a map.
        sweep: the quantity that was varied, `combined` or `map`.
        value: its value, the name of the condition or the number of the map.
        condition: all that the frames suffer from, in words.
        n: number of frames; of stars for a map.
        bound_percent: frames that show at least four true stars; None where that is not known.
        identified_percent: solved with a right attitude (a right label); with the bounds of the
            95 % Wilson interval.
        wrong_percent: claimed to be solved, but wrong; with the bounds.
        unanswered_percent: the rest.
        n_timeout: how many of the rest met the deadline.
        tolerance_deg: boresight error up to which a solution is right; None for a map.
        median_error_arcsec: median boresight error of the right solutions; None without any.
        median_cpu_ms, p95_cpu_ms: CPU time of a solve.
        time_ratio: median time of the study's first contestant over this one's, on the frames
            that this one saw; None where the first one takes no part.
        storage_bytes: size of the features that were searched; None = not known.
        beyond_bound_percent: solved frames whose boresight is off by more than the 99 % bound of
            the covariance told with it; None where none is told.
        n_wrong_beyond: how many of the wrong ones are; None where no covariance is told.
    """

    contestant: str
    camera: str
    sweep: str
    value: Value
    condition: str
    n: int
    bound_percent: float | None
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
    time_ratio: float | None
    storage_bytes: int | None
    beyond_bound_percent: float | None
    n_wrong_beyond: int | None


def wilson(k: int, n: int) -> tuple[float, float]:
    """Return the bounds of the 95 % Wilson score interval for k of n (n > 0), as fractions.

    E. B. Wilson, Probable inference, the law of succession, and statistical inference (1927).
    """
    p, z2 = k / n, _Z**2
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n**2))
    # At the ends the bound is exactly 0 or 1, but for rounding.
    return (0.0 if k == 0 else centre - half), (1.0 if k == n else centre + half)


def summarise(study: Study, results: dict[Chunk, list[Outcomes]]) -> list[Record]:
    """Return a study's records in the order of its places; the results in that of its plan."""
    cells: dict[tuple[str, str], dict[str, Outcomes]] = {}
    for chunk, result in results.items():
        cell = cells.setdefault(chunk.place, {})
        for contestant, one in zip(chunk.contestants, result, strict=True):
            all_ = cell.setdefault(contestant.title, Outcomes(one.storage_bytes))
            for name in ("outcomes", "error_deg", "cpu_ms", "n_true", "nees"):
                getattr(all_, name).extend(getattr(one, name))
    records = []
    for place in places(study):
        cell = cells.get((place.camera, place.condition.words), {})
        first = cell.get(study.contestants[0].title)
        records += [
            _record(place, one, cell[one.title], first)
            for one in study.contestants if one.title in cell
        ]
    return records


def _record(
    place: Place, contestant: Contestant, found: Outcomes, first: Outcomes | None
) -> Record:
    outcomes, cpu_ms = found.outcomes, found.cpu_ms
    errors = [
        error for outcome, error in zip(outcomes, found.error_deg, strict=False)
        if outcome == IDENTIFIED and error is not None
    ]
    n, right, wrong = len(outcomes), outcomes.count(IDENTIFIED), outcomes.count(WRONG)
    right_bounds, wrong_bounds = wilson(right, n), wilson(wrong, n)
    beyond = {
        at: nees > _BOUND for at, nees in enumerate(found.nees) if nees is not None
    }
    median_ms, p95_ms = np.percentile(cpu_ms, [50, 95]).tolist()
    return Record(
        contestant.title, place.camera, place.sweep, place.value, place.condition.words, n,
        100 * float(np.mean(np.array(found.n_true) >= MIN_STARS)) if found.n_true else None,
        100 * right / n, 100 * right_bounds[0], 100 * right_bounds[1],
        100 * wrong / n, 100 * wrong_bounds[0], 100 * wrong_bounds[1],
        100 * (n - right - wrong) / n, outcomes.count(Status.TIMEOUT.value),
        place.tolerance_deg,
        float(np.radians(np.median(errors))) * ARCSEC_PER_RAD if errors else None,
        median_ms, p95_ms,
        float(np.median(first.cpu_ms[:: contestant.every])) / median_ms if first else None,
        found.storage_bytes,
        100 * float(np.mean(list(beyond.values()))) if beyond else None,
        sum(outcomes[at] == WRONG for at in beyond if beyond[at]) if beyond else None,
    )


def as_csv(records: Iterable[Record]) -> str:
    """Return records as a table; what there is none of stays empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Record)])
    writer.writeheader()
    writer.writerows(asdict(record) for record in records)
    return text.getvalue()
