"""The compiled path of one frame, and what passes between it and `tracker.py`."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from star_tracker.attitude.attitude import describe, is_rotation, write_covariance
from star_tracker.catalogue.pairs import PairTable
from star_tracker.catalogue.sky_index import SkyIndex
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.evidence import Evidence
from star_tracker.identification.field import Frame, make_frame
from star_tracker.identification.judge import Matches, Sky, copy_rotation, empty_matches, judge
from star_tracker.identification.labels import Identification, label_frame
from star_tracker.identification.search import (
    CERTAIN,
    MORE,
    Progress,
    begin,
    certain,
    keep,
    search,
)
from star_tracker.optics.camera import Camera

#: What to do: begin a search, go on with it, label what it has found, try a predicted pose.
BEGIN, GO_ON, LABEL, TRACK = 0, 1, 2, 3
#: How it ended, beside the codes of `search`.
SOLVED, LENS, TOO_FEW, TOO_MANY, NO_ROTATION = 3, 4, 5, 6, 7
#: Where the numbers stand: quaternion, right ascension, declination, roll; covariance; the rest.
COVARIANCE, RMS, USABLE, NUMBERS = 7, 16, 17, 18
#: A predicted pose may be off by this many pixels, as the tolerance of a candidate.
_TRACKING_PX = 12.0
#: How a solution was come by: with no prior knowledge, or from a predicted attitude.
LOST_IN_SPACE, TRACKING = MODES = ("lost_in_space", "tracking")
#: Fewer stars than this fit some guide stars by chance too often to be told apart from truth.
MIN_STARS = 4


@dataclass(slots=True)
class Search:
    """The search of one frame under one parity.

    Attributes:
        camera: of that parity.
        optics: the same for compiled code.
        progress: what it has found.
        code: how the last step ended.
        method: the matcher whose pose is the best.
        mode: of `MODES`, how that pose was come by.
    """

    camera: Camera
    optics: Floats
    progress: Progress
    code: int = MORE
    method: str = ""
    mode: str = ""

    @property
    def score(self) -> float:
        """Decades of evidence of the best pose."""
        return float(self.progress.score[0])

    @property
    def wrong_probability(self) -> float:
        """Of the best pose, against its best rival and against no pose at all.

        Bayes' theorem for evidence 10^score and, for no pose, 1; all equally likely beforehand.
        """
        score, rival = float(self.progress.score[0]), float(self.progress.score[1])
        odds = 10.0 ** min(-score, 300.0) + 10.0 ** min(rival - score, 300.0)
        return odds / (1.0 + odds)

    @property
    def n_hypotheses(self) -> int:
        """Pairs matched with pairs so far by the primary."""
        return int(self.progress.counts[2])


@dataclass(slots=True)
class FrameResult:
    """One frame on its way: centroids, and labels and numbers that the compiled path writes.

    `started` is the `time.perf_counter` of its coming, `deadline_ms` the time that it has.
    """

    xy_px: Floats
    intensity: Floats
    identification: Identification
    numbers: Floats
    started: float
    deadline_ms: float

    @property
    def n_ignored(self) -> int:
        """Centroids that are not finite or outside of the image."""
        return len(self.xy_px) - int(self.numbers[USABLE])

    @property
    def elapsed_ms(self) -> float:
        """Wall-clock time since the frame came."""
        return 1e3 * (time.perf_counter() - self.started)


@compiled
def follow(
    xy_px: Floats,
    intensity: Floats,
    optics: Floats,
    v_mag: Floats,
    sky_vectors: Floats,
    band_start: Any,
    band_star: Any,
    band_vectors: Floats,
    band_ra: Floats,
    separation: Any,
    main_azimuth: Any,
    bin_start: Any,
    near_start: Any,
    near_separation: Any,
    near_azimuth: Any,
    near_companion: Any,
    log_factorial: Floats,
    low: Any,
    high: Any,
    near: Any,
    place: Floats,
    guide_star: Any,
    levels: Floats,
    limits: Floats,
    count: Any,
    score: Floats,
    rotation: Floats,
    catalog_index: Any,
    state: Any,
    residual_px: Floats,
    numbers: Floats,
    action: int,
) -> int:
    """Take one frame along the whole path, or one step farther on it; return how that ended.

    The arguments come one by one, as handing over a named tuple of arrays takes a microsecond:
    centroids and intensities; the camera; `SkyIndex` and `PairTable` without their numbers;
    `Evidence.log_factorial`; `vote_counts`; the room of `empty_matches`; the search's levels and
    limits; a `Progress`; the arrays of an `Identification`, numbers, and what to do.
    """
    for i in range(len(xy_px)):
        catalog_index[i], state[i], residual_px[i] = -1, 0, np.nan
    frame = make_frame(optics, xy_px, intensity)
    n = len(frame.vectors)
    numbers[USABLE] = n
    progress = Progress(count, score, rotation)
    if action in (BEGIN, TRACK):
        begin(progress)
    if action == TRACK and not is_rotation(rotation):
        return NO_ROTATION
    if n < MIN_STARS or n > limits[6] or frame.lost:
        return TOO_FEW if n < MIN_STARS else TOO_MANY if n > limits[6] else LENS
    sky = Sky(
        SkyIndex(sky_vectors, band_start, band_star, band_vectors, band_ra), v_mag, optics,
        limits[7],
        Evidence(log_factorial, limits[9], limits[10]),
    )
    pairs = PairTable(
        separation, main_azimuth, bin_start, near_start, near_separation, near_azimuth,
        near_companion, limits[8],
    )
    matches = empty_matches(near, place, guide_star, n)
    code = CERTAIN
    if action == TRACK:
        code = _track(sky, frame, matches, limits, progress)
    elif action != LABEL:
        code = search(
            sky, pairs, frame, low, high, matches, levels, limits, limits[11] != 0.0, progress
        )
    if action != LABEL and (code == MORE or score[0] <= limits[0]):
        return code
    if count[4] > 0:  # the pose judged last is not the best one
        matches.settled[1] = 0
    k, sum2 = label_frame(
        sky, frame, score[2], limits[5], rotation, matches, catalog_index, state, residual_px
    )
    describe(rotation, numbers)
    # Three of the 2 k coordinates went into the rotation.
    sigma = np.sqrt(sum2 / (2 * k - 3) / (optics[2] * optics[3]))
    covariance = numbers[COVARIANCE:RMS].reshape(3, 3)
    write_covariance(frame.vectors, matches.observed, k, sigma, covariance)
    numbers[RMS] = np.sqrt(sum2 / k)
    return SOLVED


@compiled
def _track(
    sky: Sky, frame: Frame, matches: Matches, limits: Floats, progress: Progress
) -> int:
    """Judge the predicted pose; return CERTAIN or MORE."""
    trial = np.empty((3, 3))
    copy_rotation(progress.rotation, trial)
    found = judge(sky, frame, _TRACKING_PX, trial, matches)
    keep(progress, found, matches.settled[0], _TRACKING_PX, trial)
    return CERTAIN if certain(progress, limits, len(frame.vectors)) else MORE
