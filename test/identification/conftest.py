"""The tracker and the frame that the tests of whole frames share."""

import numpy as np
import pytest
from engines import CAMERA

from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.maps.simulation import Condition, synthetic_field


@pytest.fixture
def tracker(trackers):
    return trackers["12 deg"]


@pytest.fixture(scope="session")
def frame(catalog):
    """A frame of 0.2 px noise with more than ten stars, and the truth."""
    rng = np.random.default_rng(1)
    rotation = rotation_from_boresight(1.9, 0.6, 0.3)
    return synthetic_field(catalog, CAMERA, rotation, rng, Condition(noise_px=0.2))
