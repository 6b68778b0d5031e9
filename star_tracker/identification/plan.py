"""In which order the search looks: levels of tolerance, main stars and companions."""

from typing import NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.evidence import ScalePrior

#: As many as there are.
_ALL = np.iinfo(np.int64).max


class Level(NamedTuple):
    """One level of a search.

    Attributes:
        by_shape: whether triangles vote, by shape and size (`shapes.py`), or pairs by separation.
        tolerance_px: of a separation.
        companions: how many vote for a main star.
        mains: how many main stars there are.
        batch: by shape, how many companions at a time, before the cells are looked at; pairs vote
            all at once.
        votes: by shape, the least votes of a cell that is looked at, however few there are in all.
        cells: most cells that are looked at, of a batch or of a main star whose pairs vote.
        worth: by shape, the least worth of a candidate (`shapes.keep_agreeing`): false ones have
            0.9 to 2.7 in the median, true ones 4 to 5.
        in_order: by shape, whether only triangles vote whose stars have the frame's order of
            brightness, where that is known: a third of them. Intensities may mean nothing, so that
            a full search has to do without.
        pause: whether the searches of other cameras have their turn after it.
        least_n, most_n: for frames of so many centroids.
    """

    by_shape: bool
    tolerance_px: float
    companions: int
    mains: int
    batch: int
    votes: int
    cells: int
    worth: float
    in_order: bool = False
    pause: bool = False
    least_n: int = 0
    most_n: int = _ALL


#: The same, for compiled code.
LEVEL = np.dtype(list(get_type_hints(Level).items()))
#: Most cells of a main star in a full search by shape.
MOST_SHAPE_CELLS = 64
#: In frames of so many times the centroids that a field shows, nearly all of them false, the
#: nearest few companions of a star hardly have a true one among them: more of them vote before the
#: full search. With 15 times as many false stars as true ones four of 64 are true, enough to stand
#: out in every second star.
FULL_OF_FALSE, _MANY_COMPANIONS = 4.0, 64
#: Frames with so many times the centroids that an average field shows have false ones: noise can
#: wait then.
_MORE_THAN_EXPECTED = 1.4


def levels(
    settings: MatchGroupSettings, prior: ScalePrior, n_expected: float
) -> NDArray[np.void]:
    """Return the levels of a search (levels,), of `LEVEL`.

    A quick search, enough for most frames, comes before the full one. It goes by shape, also where
    the focal length is known: the triangles of the right shape and size that four companions make
    are a twentieth of the pairs of their separations, of twelve a tenth. Where the focal length is
    told with a tolerance the full search goes both ways in turn, as it is told first; where it is
    not told, only shapes are left.
    """
    if not prior.told:
        return np.array(_quick_of_any_scale(settings) + _full_by_shape(settings), LEVEL)
    quick, full = _quick(settings, n_expected), _full_by_separation(settings)
    if prior.log_range > 0.0:
        turns = zip(full, _full_by_shape(settings), strict=True)
        full = [level for turn in turns for level in turn]
    else:
        full = [_among_false(settings, n_expected), *full]
    told = np.array(quick + full, LEVEL)
    told["pause"] = False  # one camera has nobody to wait for
    return told


def _quick(settings: MatchGroupSettings, n_expected: float) -> list[Level]:
    """Return the levels of a quick search at a told scale.

    Chosen for the median time over noise, missing and false stars (benchmark/RESULTS.md): the six
    triangles of four companions first; then patience for noise, or twice the companions where
    there are more centroids than stars to be expected; then still more of both in turn. What a
    main star costs is mostly how far apart in memory its triangles lie, so that few of them for
    three stars are better than many for one.
    """
    first, second = _tolerances(settings)
    few = round(_MORE_THAN_EXPECTED * n_expected)
    noisy = _short(0.5 * (first + second), companions=8, mains=4, batch=4, cells=6)
    crowded = _short(first, companions=8, mains=6, batch=8, cells=12)
    return [
        _short(first, companions=4, mains=3, batch=4, cells=8),
        noisy._replace(most_n=few),
        crowded._replace(least_n=few + 1),
        _short(first, companions=12, mains=6, batch=12, cells=24),
        _short(second, companions=8, mains=6, batch=4, cells=12),
    ] * settings.quick


def _quick_of_any_scale(settings: MatchGroupSettings) -> list[Level]:
    """Return the levels of a quick search at a scale that is not told.

    There the triangles of all sizes vote, in proportion to the square of the tolerance: half of it
    comes first, which is that of centroids good to half a pixel, and with it many companions, as
    there may be false ones among them.
    """
    first, second = _tolerances(settings)
    tight = 0.5 * first
    return [
        _short(tight, companions=6, mains=2, batch=6, cells=8),
        _short(tight, companions=14, mains=4, batch=14, cells=24)._replace(pause=True),
        _short(first, companions=12, mains=6, batch=12, cells=24),
        _short(second, companions=12, mains=4, batch=12, cells=48)._replace(worth=2.5, pause=True),
    ] * settings.quick


def _short(tolerance_px: float, companions: int, mains: int, batch: int, cells: int) -> Level:
    """Return a level of a quick search."""
    return Level(
        True, tolerance_px, companions, mains, batch, votes=3, cells=cells, worth=2.0,
        in_order=True,
    )


def _among_false(settings: MatchGroupSettings, n_expected: float) -> Level:
    """Return the level of frames that are full of false stars."""
    first, least_n = settings.pair_tolerance_px[0], round(FULL_OF_FALSE * n_expected)
    return _by_separation(first, _MANY_COMPANIONS, settings)._replace(least_n=least_n)


def _full_by_separation(settings: MatchGroupSettings) -> list[Level]:
    return [
        _by_separation(t, settings.companions, settings) for t in settings.pair_tolerance_px
    ]


def _by_separation(tolerance_px: float, companions: int, settings: MatchGroupSettings) -> Level:
    """Return a level whose pairs vote: of each star, without a least number of votes or worth."""
    return Level(
        False, tolerance_px, companions, _ALL, batch=companions, votes=0, cells=settings.cells,
        worth=0.0,
    )


def _full_by_shape(settings: MatchGroupSettings) -> list[Level]:
    n = settings.companions
    return [
        Level(True, t, n, _ALL, n, votes=3, cells=MOST_SHAPE_CELLS, worth=1.5, pause=True)
        for t in settings.pair_tolerance_px
    ]


def _tolerances(settings: MatchGroupSettings) -> tuple[float, float]:
    """Return the first two tolerances, px, the only one twice."""
    return settings.pair_tolerance_px[0], settings.pair_tolerance_px[:2][-1]
