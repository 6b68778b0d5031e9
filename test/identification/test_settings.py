"""What the user decides: what is allowed, and what is refused in which words."""

import math
import re

import pytest

from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.ended import MIN_STARS
from star_tracker.solution import SolveSettings


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (
            {"method": "guess"},
            "method 'guess' is unknown: use auto, match_group, radial_cyclic",
        ),
        ({"centroid_sigma_px": -0.1}, "centroid_sigma_px must be from 0 to 100"),
        ({"centroid_sigma_px": math.nan}, "centroid_sigma_px must be from 0 to 100"),
        ({"centroid_sigma_px": 100.1}, "centroid_sigma_px must be from 0 to 100"),
        ({"displaced_gate_px": -1.0}, "displaced_gate_px must be from 0 to 1000"),
        ({"displaced_gate_px": math.nan}, "displaced_gate_px must be from 0 to 1000"),
        ({"max_log10_false_alarms": 0.5}, "max_log10_false_alarms must be from -100 to 0"),
        ({"max_log10_false_alarms": -math.inf}, "max_log10_false_alarms must be from -100 to 0"),
        ({"deadline_ms": 0.0}, "deadline_ms must be greater than 0"),
        ({"deadline_ms": math.nan}, "deadline_ms must be greater than 0"),
        ({"max_centroids": 3}, "max_centroids must be at least 4"),
    ],
)
def test_settings_out_of_range_are_refused(options, text):
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        SolveSettings(**options)


def test_settings_at_the_ends_of_their_ranges_are_allowed():
    SolveSettings(
        match_group=MatchGroupSettings(pair_tolerance_px=(0.01, 100.0)), displaced_gate_px=0.0,
        max_log10_false_alarms=0.0, deadline_ms=math.inf, max_centroids=MIN_STARS,
    )
