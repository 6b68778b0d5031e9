"""How far a search has come: one record, which compiled code and Python share."""

from typing import Any

import numpy as np

from star_tracker.compiled import clock_s, compiled

#: How far a search has come, and the best that it has found.
#: `n_hypotheses` pairs were compared with pairs, `n_since_best` candidates judged since the best
#: pose was found, which `n_matched` matches carry, of `n_in_view` guide stars; `score` and
#: `rival_score` are the log10 evidence of the best pose and of the best other pose. Python writes
#: the last four: at `stop_s` of `time.monotonic` the search makes way; `n_proposed` matches stand
#: in `engine.proposed`, with the tolerance with which they were found; `predicted_scale` goes
#: with a predicted rotation.
PROGRESS = np.dtype([
    ("level", np.int64), ("next_main", np.int64), ("n_hypotheses", np.int64),
    ("n_judged", np.int64), ("n_since_best", np.int64), ("n_matched", np.int64),
    ("n_in_view", np.int64),
    ("score", np.float64), ("rival_score", np.float64), ("tolerance_px", np.float64),
    ("stop_s", np.float64), ("n_proposed", np.int64), ("proposed_tolerance_px", np.float64),
    ("predicted_scale", np.float64),
])


@compiled
def forget(progress: Any) -> None:
    """Begin a search anew: nothing is found yet."""
    progress.level = progress.next_main = progress.n_hypotheses = progress.n_judged = 0
    progress.n_since_best = progress.n_matched = progress.n_in_view = 0
    progress.score = progress.rival_score = -np.inf
    progress.tolerance_px = 0.0


@compiled
def wrong_probability(progress: Any) -> float:
    """Return that of the best pose, against its best rival and against no pose at all.

    Bayes' theorem for evidence 10^score and, for no pose, 1; all equally likely beforehand.
    """
    score = progress.score
    odds = 10.0 ** min(-score, 300.0) + 10.0 ** min(progress.rival_score - score, 300.0)
    return odds / (1.0 + odds)


@compiled
def late(progress: Any) -> bool:
    """Return whether the time is up."""
    return progress.stop_s < np.inf and clock_s() > progress.stop_s
