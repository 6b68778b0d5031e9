"""The engine: all that compiled code works with, made once, behind one pointer."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.attitude.pose import Pose
from star_tracker.catalogue.pairs import PairTable
from star_tracker.catalogue.triangles import TriangleTable
from star_tracker.compiled import compiled, struct
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.cells import empty_room
from star_tracker.identification.crowd import no_crowd
from star_tracker.identification.evidence import DOUBT, ScalePrior
from star_tracker.identification.judge import Sky, View, empty_matches
from star_tracker.identification.progress import PROGRESS
from star_tracker.identification.search import Limits
from star_tracker.identification.shapes import Triangles, empty_fan
from star_tracker.identification.votes import empty_votes
from star_tracker.optics.frame import empty_frame

#: What `PairTable` holds, for compiled code.
PairsType, Pairs = struct("Pairs", __name__, PairTable._fields)

#: Memory that engines of one thread can share, as it is used by one step at a time: `Votes`,
#: `Room`, `Matches` and `Fan`.
ScratchType, Scratch = struct("Scratch", __name__, ("votes", "room", "matches", "fan"))

#: - sky, pairs, triangles: the guide stars and the camera that looks at them;
#: - doubt: the same sky, and a camera whose focal length may be wrong by `DOUBT`;
#: - levels: the levels of the search (`plan.LEVEL`);
#: - limits: when it ends (`search.Limits`);
#: - votes, room, matches, fan: scratch memory;
#: - frame, crowd: the centroids, and where they crowd;
#: - progress: (1,) of `progress.PROGRESS`;
#: - proposed: (2, n) int64, matches that another matcher proposes: centroids, then guide stars;
#: - best: the best pose so far, its rotation an array that Python reads too;
#: - outcome: (1,) of `OUTCOME`;
#: - quaternion, covariance: (4,) and (3, 3) of the attitude of a labelled frame.
EngineType, Engine = struct("Engine", __name__, (
    "sky", "doubt", "pairs", "triangles", "levels", "limits", "votes", "room", "matches", "fan",
    "frame", "crowd", "progress", "proposed", "best", "outcome", "quaternion", "covariance",
))

#: What became of a frame. `n_usable` centroids are finite and in the image; the rest is that of a
#: labelled frame: how many hypotheses its engine had compared, its boresight, the root mean square
#: residual of the identified stars, its scale, the variance of a centroid along each axis, and
#: that of the log of the scale, how likely it is wrong (`progress.wrong_probability`), and its
#: log10 evidence.
OUTCOME = np.dtype([
    ("n_usable", np.int64), ("n_hypotheses", np.int64), ("ra_rad", np.float64),
    ("dec_rad", np.float64), ("roll_rad", np.float64), ("rms_px", np.float64),
    ("scale", np.float64), ("variance_px2", np.float64), ("scale_variance", np.float64),
    ("wrong_probability", np.float64), ("score", np.float64),
])
_N_OUTCOME = OUTCOME.itemsize // 8


class Sizes(NamedTuple):
    """How much memory an engine needs: numbers of guide stars, centroids, companions, cells."""

    guides: int
    centroids: int
    companions: int
    cells: int


class Results(NamedTuple):
    """The arrays that an engine and Python both read and write; see `Engine`.

    `outcome`, `quaternion` and `covariance` lie side by side in `numbers`, which keeps them of a
    frame in one copy (`parts_of`).
    """

    progress: NDArray[np.void]
    proposed: NDArray[np.int64]
    vectors: Floats
    rotation: Floats
    numbers: Floats
    outcome: NDArray[np.void]
    quaternion: Floats
    covariance: Floats

    @classmethod
    def blank(cls, n_centroids: int) -> "Results":
        """Return results of nothing, with room for so many centroids."""
        progress = np.zeros(1, PROGRESS)
        progress["stop_s"] = np.inf
        numbers = np.zeros(_N_OUTCOME + 4 + 9)
        return cls(
            progress, np.empty((2, n_centroids), np.int64), np.empty((n_centroids, 3)),
            np.eye(3), numbers, *parts_of(numbers),
        )


def parts_of(numbers: Floats) -> tuple[NDArray[np.void], Floats, Floats]:
    """Return the outcome (1,), quaternion (4,) and covariance (3, 3) that lie in `numbers`."""
    end = _N_OUTCOME + 4
    return (
        numbers[:_N_OUTCOME].view(OUTCOME), numbers[_N_OUTCOME:end], numbers[end:].reshape(3, 3)
    )


@compiled
def make_scratch(sizes: Sizes) -> Any:
    """Return memory for engines of one catalogue."""
    return Scratch(
        empty_votes(sizes.guides, sizes.companions), empty_room(sizes.cells),
        empty_matches(sizes.guides, sizes.centroids), empty_fan(sizes.companions),
    )


@compiled
def _sky(view: View, prior: ScalePrior) -> Any:
    return Sky(
        view.guides, view.v_mag, view.optics, view.focal_px, view.radius_rad, view.evidence, prior
    )


@compiled
def make_engine(
    view: View, table: PairTable, shapes: TriangleTable,
    search: tuple[NDArray[np.void], Limits], scratch: Any, results: Results,
) -> Any:
    """Put an engine together: what it sees, pairs and shapes, how it searches, and its memory."""
    pairs = Pairs(
        table.separation_rad, table.main_azimuth, table.bin_start, table.near_start,
        table.near_separation_rad, table.near_azimuth, table.near_companion,
        table.max_separation_rad,
    )
    triangles = Triangles(
        shapes.grid, shapes.cell_start, shapes.log_spacing, shapes.rows,
        shapes.fan_log_separation, shapes.fan_azimuth, shapes.fan_star,
    )
    levels, limits = search
    return Engine(
        _sky(view, view.scale_prior), _sky(view, DOUBT), pairs, triangles, levels, limits,
        scratch.votes, scratch.room, scratch.matches, scratch.fan,
        empty_frame(results.vectors), no_crowd(),
        results.progress, results.proposed, Pose(results.rotation, 1.0, False),
        results.outcome, results.quaternion, results.covariance,
    )
