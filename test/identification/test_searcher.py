"""One engine as Python sees it."""

import math

import pytest
from engines import CAMERA, catalog_of, random_sky

from star_tracker.identification.engine import Results
from star_tracker.identification.searcher import Searcher


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
    results = Results.blank(4)
    results.progress["score"], results.progress["rival_score"] = score, rival
    searcher = Searcher(CAMERA, catalog_of(random_sky(5, 1)), None, results)
    assert searcher.wrong_probability == pytest.approx(expected, rel=1e-9, abs=1e-290)
