"""The survey of the whole sky: where its fields lie and what it counts."""

import numpy as np
import pytest

from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import Condition
from star_tracker.optics.camera import Camera
from star_tracker.study.sky_survey import fibonacci_lattice, survey
from star_tracker.tracker import StarTracker


@pytest.mark.parametrize("n", [1, 2, 500, 2501])
def test_the_lattice_is_even(n):
    """Its points are unit vectors whose mean vanishes, and none is far nearer than its share."""
    points = fibonacci_lattice(n)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, atol=1e-12)
    if n < 500:
        return
    assert np.linalg.norm(points.mean(axis=0)) < 2 / n
    nearest = np.sort(separation(points[:, None][::50], points[None]), axis=1)[:, 1]
    spacing = np.sqrt(4 * np.pi / n)
    assert nearest.min() > 0.8 * spacing
    assert nearest.max() < 1.2 * spacing
    # As many in each octant as its share.
    octant = (points > 0) @ [1, 2, 4]
    assert np.bincount(octant, minlength=8) == pytest.approx(n / 8, abs=0.03 * n)


def test_a_lattice_without_points_is_refused():
    with pytest.raises(ValueError, match="at least one point"):
        fibonacci_lattice(0)


def test_the_survey_counts_frames(database):
    tracker = StarTracker(database, Camera.from_fov(12, 512, 512))
    clean = survey(tracker, Condition("clean", 0.0), 40, 2, 7)
    bare = survey(tracker, Condition("bare", 0.0, missing=1.0), 40, 2, 7)
    again = survey(tracker, Condition("clean", 0.0), 40, 2, 7)
    assert clean.boresights.shape == (40, 3)
    assert np.all(clean.right <= clean.possible)
    assert np.all(clean.possible <= 2)
    assert clean.rate_percent.mean() > 95
    assert not clean.wrong.any()
    assert not bare.right.any()
    assert not bare.possible.any()
    np.testing.assert_array_equal(clean.right, again.right)
    # 4908 stars over the whole sky, 144 square degrees of it in a field.
    share = 4908 * 144 / (4 * np.pi * np.degrees(1) ** 2)
    assert clean.guide_stars.mean() == pytest.approx(share, rel=0.1)
