"""In which order the search looks: levels of tolerance, main stars and companions."""

import numpy as np
from numpy.typing import NDArray

from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.evidence import ScalePrior

#: One level of a search:
#:
#: - by_shape: whether triangles vote, by shape and size (`shapes.py`), or pairs by separation;
#: - tolerance_px: of a separation;
#: - companions: how many vote for a main star;
#: - mains: how many main stars there are;
#: - batch: by shape, how many at a time, before the cells are looked at; pairs vote all at once;
#: - votes: by shape, the least votes of a cell that is looked at, however few there are in all;
#: - cells: most cells that are looked at, of a batch or of a main star whose pairs vote;
#: - worth: by shape, the least worth of a candidate (`shapes.keep_agreeing`): false ones have 0.9
#:   to 2.7 in the median, true ones 4 to 5;
#: - pause: whether the searches of other cameras have their turn after it;
#: - least_n: for frames of at least so many centroids.
LEVEL = np.dtype([
    ("by_shape", np.bool_), ("tolerance_px", np.float64), ("companions", np.int64),
    ("mains", np.int64), ("batch", np.int64), ("votes", np.int64), ("cells", np.int64),
    ("worth", np.float64), ("pause", np.bool_), ("least_n", np.int64),
])
Level = tuple[bool, float, int, int, int, int, int, float, bool, int]
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

    A quick search, enough for most frames, comes before the full one. It goes by shape, also where
    the focal length is known: the triangles of the right shape and size that four companions make
    are a twentieth of the pairs of their separations, of twelve a tenth. Where the focal length is
    told with a tolerance the full search goes both ways in turn, as it is told first; where it is
    not told, only shapes are left.
    """
    if not prior.told:
        return np.array(_quick_of_any_scale(settings) + _full_by_shape(settings), LEVEL)
    quick, full = _quick(settings), _full_by_separation(settings)
    if prior.log_range > 0.0:
        turns = zip(full, _full_by_shape(settings), strict=True)
        full = [level for turn in turns for level in turn]
    else:
        full = [_among_false(settings), *full]
    told = np.array(quick + full, LEVEL)
    told["pause"] = False  # one camera has nobody to wait for
    return told


def _quick(settings: MatchGroupSettings) -> list[Level]:
    """Return the levels of a quick search at a told scale.

    Chosen for the median time over noise, missing and false stars (benchmark/RESULTS.md): the six
    triangles of four companions first, then patience for noise, then more companions for false
    stars, then more patience. What a main star costs is mostly how far apart in memory its
    triangles lie, so that few of them for three stars are better than many for one.
    """
    first, second = _tolerances(settings)
    between = 0.5 * (first + second)
    return [
        (True, first, 4, 3, 4, 3, 8, 2.0, False, 0),
        (True, between, 8, 4, 4, 3, 6, 2.0, False, 0),
        (True, first, 12, 6, 12, 3, 24, 2.0, False, 0),
        (True, second, 8, 6, 4, 3, 12, 2.0, False, 0),
    ] * settings.quick


def _quick_of_any_scale(settings: MatchGroupSettings) -> list[Level]:
    """Return the levels of a quick search at a scale that is not told."""
    first, second = _tolerances(settings)
    return [
        (True, first, 6, 3, 6, 3, 8, 2.0, True, 0),
        (True, first, 12, 6, 12, 3, 24, 2.0, False, 0),
        (True, second, 12, 4, 12, 3, 48, 2.5, True, 0),
    ] * settings.quick


def _among_false(settings: MatchGroupSettings) -> Level:
    """Return the level of frames that are full of false stars."""
    n, first = _MANY_COMPANIONS, settings.pair_tolerance_px[0]
    return (False, first, n, _ALL, n, 0, settings.cells, 0.0, False, FULL_OF_FALSE)


def _full_by_separation(settings: MatchGroupSettings) -> list[Level]:
    n = settings.companions
    return [
        (False, t, n, _ALL, n, 0, settings.cells, 0.0, False, 0)
        for t in settings.pair_tolerance_px
    ]


def _full_by_shape(settings: MatchGroupSettings) -> list[Level]:
    n = settings.companions
    return [
        (True, t, n, _ALL, n, 3, MOST_SHAPE_CELLS, 1.5, True, 0)
        for t in settings.pair_tolerance_px
    ]


def _tolerances(settings: MatchGroupSettings) -> tuple[float, float]:
    """Return the first two tolerances, px, the only one twice."""
    return settings.pair_tolerance_px[0], settings.pair_tolerance_px[:2][-1]
