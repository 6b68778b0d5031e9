"""How sure a search is of its best pose."""

import math

import numpy as np
import pytest

from star_tracker.compiled import compiled
from star_tracker.identification.search import PROGRESS, wrong_probability


@pytest.mark.parametrize(
    ("score", "rival", "expected"),
    [
        (3.5, -math.inf, 10**-3.5 / (1 + 10**-3.5)),
        (3.5, -2.0, (10**-3.5 + 10**-5.5) / (1 + 10**-3.5 + 10**-5.5)),
        (3.5, 3.5, (1 + 10**-3.5) / (2 + 10**-3.5)),
        (0.0, -math.inf, 0.5),
        (-400.0, -math.inf, 1.0),
        (400.0, 380.0, 1e-20),
        (400.0, -math.inf, 0.0),
    ],
    ids=[
        "enough", "with a weak rival", "with an equal rival", "as likely as not", "hopeless",
        "beyond doubt, with a rival", "beyond doubt",
    ],
)
def test_probability_of_being_wrong(score, rival, expected):
    """Bayes' theorem for three explanations: this pose, its best rival and none."""
    progress = np.zeros(1, PROGRESS)
    progress["score"], progress["rival_score"] = score, rival
    found = of_record(progress)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-290)


@compiled
def of_record(progress):
    return wrong_probability(progress[0])
