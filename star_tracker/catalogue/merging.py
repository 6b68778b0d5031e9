"""Stars that reach the detector as one: close neighbours of a brightest star become one star."""

from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats, chord

#: So much fainter than the limiting magnitude a star still counts: two that are too faint to be
#: seen may be seen together, and a companion moves the light of a star that is seen. Fainter ones
#: drown in the noise that sets the limit (benchmark/merging.py).
MARGIN_MAG = 2.0


class Merged(NamedTuple):
    """Stars after merging, in the order of their brightest members.

    Attributes:
        brightest: (m,) index of each one's brightest member; it gives the name.
        vectors: (m, 3) centres of light, unit vectors.
        v_mag: (m,) joint magnitudes.
    """

    brightest: NDArray[np.intp]
    vectors: Floats
    v_mag: Floats


def merge_close(vectors: Floats, v_mag: Floats, limit_rad: float) -> Merged:
    """Merge stars (n, 3) with magnitudes (n,) that lie closer together than a limit.

    From the brightest star to the faintest, each that is still free takes its free neighbours
    within the limit. So every member is a neighbour of its brightest star itself, and nothing
    hangs together in chains, however wide the limit. A star without neighbours stays exactly as
    it is.
    """
    brightest = np.arange(len(v_mag))
    leader = _leaders(vectors, v_mag, limit_rad)
    flux = 10 ** (-0.4 * v_mag)
    total = np.bincount(leader, flux, len(v_mag))
    light = np.column_stack([
        np.bincount(leader, flux * vectors[:, axis], len(v_mag)) for axis in range(3)
    ])
    keep = brightest[leader == brightest]
    members = np.bincount(leader, minlength=len(v_mag))[keep]
    centre = light[keep] / np.linalg.norm(light[keep], axis=1, keepdims=True)
    return Merged(
        keep,
        np.where(members[:, None] > 1, centre, vectors[keep]),
        np.where(members > 1, -2.5 * np.log10(total[keep]), v_mag[keep]),
    )


def _leaders(vectors: Floats, v_mag: Floats, limit_rad: float) -> NDArray[np.intp]:
    """Return for each star (n,) the brightest star that it is merged with, mostly itself."""
    tree = scipy.spatial.cKDTree(vectors)
    close = tree.query_pairs(float(chord(limit_rad)), output_type="ndarray")
    # As rank in brightness, so that the brighter of a pair comes first; equals by their order.
    order = np.argsort(v_mag, kind="stable")
    rank = np.empty(len(order), np.intp)
    rank[order] = np.arange(len(order))
    pairs = np.sort(rank[close], axis=1)
    leader = np.arange(len(v_mag))
    taken = np.zeros(len(v_mag), np.bool_)
    for bright, faint in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():
        # All brighter ones have had their choice: this one leads where none has taken it.
        if not taken[bright] and not taken[faint]:
            taken[faint] = True
            leader[faint] = bright
    members = np.empty(len(order), np.intp)
    members[order] = order[leader]
    return members
