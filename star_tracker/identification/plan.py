"""In which order the search looks: levels of tolerance, main stars and companions."""

import numpy as np
from numpy.typing import NDArray

from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.evidence import ScalePrior

#: One level of a search:
#:
#: - by_shape: whether triangles vote by shape, at any scale (`shapes.py`), or pairs by separation;
#: - tolerance_px: of a separation;
#: - companions: how many vote for a main star, and batch: how many at a time;
#: - mains: how many main stars there are;
#: - votes: the least votes of a cell that is looked at;
#: - cells: most cells of a main star and batch;
#: - worth: the least worth of a candidate by shape (`shapes.keep_agreeing`): false ones have 0.9
#:   to 2.7 in the median, true ones 4 to 5;
#: - pause: whether the searches of other cameras have their turn after it;
#: - least_n: for frames of at least so many centroids.
LEVEL = np.dtype([
    ("by_shape", np.bool_), ("tolerance_px", np.float64), ("companions", np.int64),
    ("mains", np.int64), ("batch", np.int64), ("votes", np.int64), ("cells", np.int64),
    ("worth", np.float64), ("pause", np.bool_), ("least_n", np.int64),
])
#: As many main stars as the frame has stars.
_ALL = np.iinfo(np.int64).max
#: Most cells of a main star in a full search by shape.
MOST_SHAPE_CELLS = 64
#: In frames of so many centroids, nearly all of them false, the nearest few companions of a star
#: hardly have a true one among them: more of them vote before the full search. With 15 times as
#: many false stars as true ones four of 64 are true, enough to stand out in every second star.
FULL_OF_FALSE, _MANY_COMPANIONS = 250, 64


def levels(settings: MatchGroupSettings, prior: ScalePrior) -> NDArray[np.void]:
    """Return the levels of a search (levels,), of `LEVEL`.

    A short search, enough for most frames, comes before the full one; it was chosen for the median
    time over noise, missing and false stars (benchmark/RESULTS.md). Where the focal length is told
    with a tolerance both ways take turns, as it is told first; where it is not told, only shapes
    are left.
    """
    by_separation = _by_separation(settings)
    if prior.log_range == 0.0:
        n_short = 3 * settings.quick
        many = _among_false(settings)
        return np.array(by_separation[:n_short] + many + by_separation[n_short:], LEVEL)
    by_shape = _by_shape(settings)
    if not prior.told:
        return np.array(by_shape, LEVEL)
    n_short = 3 * settings.quick
    turns = []
    if settings.quick:
        told, shapes = by_separation[:3], by_shape[:3]
        turns = [told[0], shapes[0], shapes[1], told[1], shapes[2], told[2]]
    for pair in zip(by_separation[n_short:], by_shape[n_short:], strict=True):
        turns += pair
    both = np.array(turns, LEVEL)
    both["pause"] = False  # one camera has nobody to wait for
    return both


def _by_separation(settings: MatchGroupSettings) -> list[tuple[float, ...]]:
    first, second = settings.pair_tolerance_px[0], settings.pair_tolerance_px[:2][-1]
    short = [(first, 6, 2, 3), (first, 16, 5, 16), (second, 12, 3, 12)]
    n = settings.companions
    full = [(t, n, _ALL, n) for t in settings.pair_tolerance_px]
    rows = short * settings.quick + full
    return [(False, *row, 0, settings.cells, 0.0, False, 0) for row in rows]


def _among_false(settings: MatchGroupSettings) -> list[tuple[float, ...]]:
    n, first = _MANY_COMPANIONS, settings.pair_tolerance_px[0]
    return [(False, first, n, _ALL, n, 0, settings.cells, 0.0, False, FULL_OF_FALSE)]


def _by_shape(settings: MatchGroupSettings) -> list[tuple[float, ...]]:
    first, second = settings.pair_tolerance_px[0], settings.pair_tolerance_px[:2][-1]
    short: list[tuple[float, ...]] = [
        (True, first, 6, 3, 6, 3, 24, 2.0, True, 0),
        (True, first, 12, 6, 12, 3, 48, 2.0, False, 0),
        (True, second, 12, 4, 12, 3, 48, 2.5, True, 0),
    ]
    n = settings.companions
    full: list[tuple[float, ...]] = [
        (True, t, n, _ALL, n, 3, MOST_SHAPE_CELLS, 1.5, True, 0)
        for t in settings.pair_tolerance_px
    ]
    return short * settings.quick + full
