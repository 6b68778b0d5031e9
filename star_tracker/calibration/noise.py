"""What a stream's solved frames teach of its centroids: their noise, and how many are stars.

Both fade: a stream that changes slowly is followed, and one that changes at once is begun anew.
"""

import math

from star_tracker.identification.stream import Expectation, chi_square_bound
from star_tracker.solution import Solution, Status

#: What is remembered: squared residuals of so many degrees of freedom, so many centroids.
_MEMORY_FREEDOM, _MEMORY_CENTROIDS = 100.0, 100.0
#: What the next frame is told, at the most: the noise as sure as a told one, and a share of stars
#: as sure as that of so many centroids, as it is another one elsewhere in the sky.
_SURE_FREEDOM, _SURE_CENTROIDS = 20.0, 10.0
#: And from how many frames and degrees of freedom on: fewer say little.
_LEAST_FRAMES, _LEAST_FREEDOM = 3, 12.0
#: No noise outside of this is learnt, px, and no share of stars is quite certain.
_SIGMA_RANGE_PX = (0.02, 10.0)
_LEAST_COUNT = 0.5
#: Squared residuals above this many standard deviations of what is known surprise (99.9 %, Wilson
#: and Hilferty 1931); so many frames in a row that do so are a change.
_SURPRISING, _CHANGED = 3.09, 2
#: After so many frames in a row without a solution nothing is known any more.
_FORGOTTEN = 50


class StreamNoise:
    """Learns from one frame after the other, robustly: a single odd one teaches nothing.

    Args:
        told_sigma_px: noise of a centroid as it was told; 0 = it is learnt.

    Attributes:
        n_frames: how many frames have taught since the last change.
    """

    def __init__(self, told_sigma_px: float = 0.0) -> None:
        self._told_px = told_sigma_px
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._squares_px2 = self._freedom = self._stars = self._centroids = 0.0
        self.n_frames = self._n_surprises = self._n_unsolved = 0

    @property
    def sigma_px(self) -> float | None:
        """Noise of a centroid along each axis, as told or learnt; None = not known yet."""
        if self._told_px > 0:
            return self._told_px
        if not self._knows:
            return None
        low, high = _SIGMA_RANGE_PX
        return min(max(math.sqrt(self._squares_px2 / self._freedom), low), high)

    @property
    def false_share(self) -> float | None:
        """The share of centroids that are not recognised in solved frames; None = not known."""
        return 1.0 - self._stars / self._centroids if self._knows else None

    @property
    def expectation(self) -> Expectation | None:
        """What the next frame may use; None where little is known or the last one was odd."""
        sigma_px, share = self.sigma_px, self.false_share
        if sigma_px is None or share is None or self._n_surprises > 0:
            return None
        told = self._told_px > 0
        sure = min(self._centroids, _SURE_CENTROIDS)
        return Expectation(
            sigma_px, _SURE_FREEDOM if told else min(self._freedom, _SURE_FREEDOM),
            max(sure * (1.0 - share), _LEAST_COUNT), max(sure * share, _LEAST_COUNT),
        )

    @property
    def _knows(self) -> bool:
        return self.n_frames >= _LEAST_FRAMES and self._freedom >= _LEAST_FREEDOM

    def add(self, solution: Solution) -> None:
        """Take in what became of a frame."""
        if solution.status is not Status.SOLVED:
            self._n_unsolved += 1
            if self._n_unsolved >= _FORGOTTEN:
                self.forget()
            return
        self._n_unsolved = 0
        n = len(solution.identification.state) - solution.n_ignored - solution.n_surplus
        k = len(solution.identification.identified)
        freedom = 2 * k - (4 if solution.focal_length_error > 0 else 3)
        squares_px2 = k * solution.rms_px**2
        if freedom < 1:
            return
        if self._surprises(squares_px2, freedom):
            self._n_surprises += 1
            if self._n_surprises < _CHANGED:
                return
            self.forget()
        self._n_surprises = 0
        self._take(squares_px2, freedom, k, n)

    def _surprises(self, squares_px2: float, freedom: int) -> bool:
        """Return whether squared residuals are too large for the noise as it is known."""
        if self._told_px > 0 or not self._knows:
            return False
        sigma_px = max(math.sqrt(self._squares_px2 / self._freedom), _SIGMA_RANGE_PX[0])
        return bool(squares_px2 > chi_square_bound(freedom, _SURPRISING) * sigma_px**2)

    def _take(self, squares_px2: float, freedom: int, k: int, n: int) -> None:
        """Remember a frame, and of what was before as much as there is memory for."""
        self.n_frames += 1
        self._squares_px2 += squares_px2
        self._freedom += freedom
        self._stars += k
        self._centroids += n
        fades = min(1.0, _MEMORY_FREEDOM / self._freedom)
        self._squares_px2 *= fades
        self._freedom *= fades
        fades = min(1.0, _MEMORY_CENTROIDS / self._centroids)
        self._stars *= fades
        self._centroids *= fades
