"""Between what a user gives and gets and what the searchers work with: one frame each way."""

import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.ended import MIN_STARS, Ended
from star_tracker.identification.engine import parts_of
from star_tracker.identification.escalation import Verdict
from star_tracker.identification.labels import LABEL, Identification
from star_tracker.identification.search import Limits
from star_tracker.identification.searcher import METHODS, Sample, Searcher, Task
from star_tracker.identification.setup import Setup
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status

#: Decades of evidence that end the search at once, where enough stars are matched
#: (`search.certain`). Weaker evidence that is enough has to be better than that of the next so
#: many candidates: a few true stars among 40 can carry a pose that is off by half a degree. And
#: the sky's mirror image must not fit better: a real sky seen in a mirror has look-alikes along
#: lines of stars (benchmark/wrong_solutions.py).
_CERTAIN = 8.0
_SECOND_LOOK = 10.0
#: Work, in votes, between two looks of Python at the clock: some 0.3 ms, 10 ms at the most where
#: the focal length is told (benchmark/deadline.py).
_WORK = 20_000.0
_UNKNOWN, _FLOAT64 = np.empty(0), np.dtype(np.float64)
_STATUS = {
    Ended.EXHAUSTED: Status.NO_MATCH, Ended.AMBIGUOUS: Status.AMBIGUOUS,
    Ended.MORE: Status.TIMEOUT,
}


def setup_of(settings: SolveSettings, *, both_parities: bool) -> Setup:
    """Return what the searchers are made with; either parity may be the true one, or not."""
    enough = -settings.max_log10_false_alarms
    limits = Limits(
        max(_CERTAIN, enough), enough, _SECOND_LOOK, _WORK, settings.displaced_gate_px,
        both_parities,
    )
    return Setup(
        settings.match_group if settings.method != METHODS[1] else None, limits,
        settings.centroid_sigma_px, settings.max_centroids,
    )


def received(
    xy_px: ArrayLike, intensity: ArrayLike | None, deadline_ms: float | None,
    settings: SolveSettings,
) -> Task:
    """Check what came; return it with room for its labels.

    Raises ValueError for an array of another shape, and a deadline that is not above 0.
    """
    started_s = time.perf_counter()
    xy = _plain(xy_px)
    shape = xy.shape
    if len(shape) != 2 or shape[1] != 2:
        if shape != (0,):
            raise ValueError(f"centroids have shape {shape}: give an array (n, 2) of x, y")
        xy = np.empty((0, 2))  # a list of none, as of a detector that finds nothing
    if deadline_ms is None:
        deadline_ms = settings.deadline_ms
    elif not deadline_ms > 0:
        raise ValueError(f"deadline_ms is {deadline_ms}: it must be greater than 0")
    n = len(xy)
    brightness = _UNKNOWN
    if intensity is not None:
        brightness = _plain(intensity)
        if brightness.shape != (n,):
            raise ValueError(
                f"intensities have shape {brightness.shape}: give one for each of {n} centroids"
            )
    if n <= settings.max_centroids:
        return Task(xy, brightness, np.empty(n, LABEL), started_s, deadline_ms)
    finite = np.flatnonzero(np.isfinite(xy).all(axis=1))
    rows = _taken(finite, brightness, settings.max_centroids)
    return Task(
        xy[rows], brightness[rows] if len(brightness) else brightness,
        np.empty(len(rows), LABEL), started_s, deadline_ms,
        Sample(rows, n, len(finite) - len(rows)),
    )


def _plain(values: ArrayLike) -> Floats:
    """Return an array as the path is compiled for: for others it would be compiled again.

    One that is read-only (of a message, say) or not aligned is copied. What is masked is not a
    number. Raises ValueError for complex numbers.
    """
    if type(values) is np.ndarray and values.dtype is _FLOAT64 and values.flags.carray:
        return values  # nearly always: `asarray` takes longer to find that out
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    if np.iscomplexobj(values):
        raise ValueError("centroids and intensities are real numbers, not complex ones")
    array = np.asarray(values, np.float64, order="C")
    return array if array.flags.carray else array.copy()


def _taken(rows: NDArray[np.int64], brightness: Floats, room: int) -> NDArray[np.int64]:
    """Return those rows that the brightest centroids have, or an even sample of them.

    Detectors list centroids by place or by brightness: a sample that is even in their order leaves
    no part of the image out.
    """
    if len(rows) <= room:
        return rows
    if len(brightness):
        value = np.nan_to_num(brightness[rows], nan=-np.inf)
        return np.sort(rows[np.argsort(-value, kind="stable")[:room]])
    return np.asarray(rows[np.linspace(0, len(rows) - 1, room).round().astype(np.int64)])


def refused(task: Task, searcher: Searcher) -> Solution:
    """Return the solution of a frame that a searcher could not begin."""
    n, n_given, camera = searcher.n_usable, task.n_given, searcher.camera
    status = Status.BAD_INPUT
    if n_given > 0 and n == 0:
        reason = (
            f"all {n_given} centroids are non-finite or outside of the "
            f"{camera.width_px} x {camera.height_px} px image: "
            "check the camera's size and the detector"
        )
    else:
        status = Status.TOO_FEW_STARS
        reason = f"{n} stars, at least {MIN_STARS} are needed"
    return _unsolved(task, status, reason, Verdict(searcher.ended, searcher, 0))


def judged(task: Task, verdict: Verdict) -> Solution:
    """Return the solution of a frame about which there is a verdict."""
    if verdict.ended == Ended.SOLVED:
        return labelled(task, verdict.best, verdict.n_hypotheses)
    return _unsolved(task, _STATUS[verdict.ended], verdict.reason, verdict)


def _unsolved(task: Task, status: Status, reason: str, verdict: Verdict) -> Solution:
    """Return the solution of a frame that has none."""
    return Solution(
        status, reason, Identification.empty(task.n_given),
        log10_false_alarms=-verdict.best.score, n_hypotheses=verdict.n_hypotheses,
        n_ignored=task.n_ignored(verdict.best.n_usable), n_surplus=task.n_surplus,
        solve_ms=task.ms_until(time.perf_counter()),
    )


def labelled(task: Task, searcher: Searcher, n_hypotheses: int | None = None) -> Solution:
    """Return the solution of a frame that a searcher has labelled.

    `n_hypotheses` were compared by all searchers, where it was not this one alone.
    """
    return Solution.later(
        _fields, task, searcher.camera, searcher.catalog,
        (searcher.method, searcher.mode, n_hypotheses), searcher.results.numbers.copy(),
        time.perf_counter(),
    )


def _fields(
    task: Task, camera: Camera, catalog: StarCatalog, come_by: tuple[str, str, int | None],
    numbers: Floats, ended_s: float,
) -> dict[str, Any]:
    """Return the fields of a solution, by name."""
    outcome, quaternion, covariance = parts_of(numbers)
    (
        n_usable, of_one, ra, dec, roll, rms_px, scale, variance_px2, scale_variance,
        wrong_probability, score,
    ) = outcome.item()
    method, mode, of_all = come_by
    labels = task.all_labels
    return {
        "status": Status.SOLVED, "reason": "identified", "method": method, "mode": mode,
        "identification": Identification(
            labels["catalog_index"], labels["state"], labels["residual_px"]
        ),
        "attitude": Attitude(quaternion, covariance, ra, dec, roll),
        "parity": camera.parity,
        "wrong_probability": wrong_probability, "log10_false_alarms": -score, "rms_px": rms_px,
        "n_hypotheses": of_one if of_all is None else of_all,
        "n_ignored": task.n_ignored(n_usable), "n_surplus": task.n_surplus,
        "solve_ms": task.ms_until(ended_s),
        "told_camera": camera, "scale": scale, "focal_length_error": scale_variance**0.5,
        "centroid_sigma_px": variance_px2**0.5, "catalog": catalog,
    }
