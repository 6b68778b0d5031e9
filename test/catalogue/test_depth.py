"""Depth that suits the camera: magnitudes from star counts, and a ladder for unknown fields."""

import re
from itertools import pairwise

import numpy as np
import pytest

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.depth import (
    Depth,
    blend_separation_deg,
    limiting_magnitude_for,
    pattern_settings_for,
    separation_for,
    solid_angle_sr,
    stars_in_view,
)
from star_tracker.catalogue.ladder import STEP_FACTOR, ladder
from star_tracker.catalogue.triangles import TriangleTable
from star_tracker.maps.simulation import random_rotation, visible_stars
from star_tracker.optics.camera import Camera

HD = (1024, 768)


def stars_a_field(fov_deg, n_fields=300):
    camera = Camera.from_fov(fov_deg, *HD)
    catalog = Depth().stars_for(camera, "hipparcos", 2000.0)
    rng = np.random.default_rng(7)
    return np.array([
        len(visible_stars(catalog, camera, random_rotation(rng))[0]) for _ in range(n_fields)
    ])


def test_the_solid_angle_of_a_face_of_a_cube_is_a_sixth_of_the_sphere():
    assert solid_angle_sr(Camera.from_fov(90, 700, 700)) == pytest.approx(4 * np.pi / 6)


def test_the_solid_angle_of_a_small_field_is_its_area():
    camera = Camera.from_fov(2, 2000, 500)
    assert solid_angle_sr(camera) == pytest.approx(np.radians(2) * np.radians(0.5), rel=1e-3)


def test_a_face_of_a_cube_shows_a_sixth_of_the_stars():
    assert stars_in_view(600, Camera.from_fov(90, 700, 700)) == pytest.approx(100)


@pytest.mark.parametrize("fov_deg", [8, 12, 20, 30, 45, 70])
def test_a_field_has_some_forty_guide_stars_wherever_it_looks(fov_deg):
    """25 to 60 is what suits; half of all fields are in it, and hardly any is far from it."""
    n = stars_a_field(fov_deg)
    assert 32 < np.mean(n) < 50
    assert np.percentile(n, 5) > 18
    assert np.percentile(n, 95) < 90


def test_a_narrow_field_gets_all_that_the_catalogue_has():
    camera = Camera.from_fov(4, *HD)
    assert limiting_magnitude_for("hipparcos", solid_angle_sr(camera)) == 8.0


def test_a_field_wider_than_any_keeps_the_naked_eyes_bright_stars():
    assert limiting_magnitude_for("hipparcos", 2 * np.pi) == 4.0


def test_magnitudes_come_in_steps_so_that_near_fields_share_a_database():
    fields = [
        limiting_magnitude_for("hipparcos", solid_angle_sr(Camera.from_fov(fov_deg, *HD)))
        for fov_deg in np.linspace(10, 11, 12)
    ]
    assert len(set(fields)) <= 4
    assert all(10 * one == pytest.approx(round(10 * one)) for one in fields)
    assert fields == sorted(fields, reverse=True)


def test_the_magnitude_is_that_of_the_star_counts():
    """40 of the 15,600 stars to V = 7 lie in 1/390 of the sphere."""
    n = len(StarCatalog.hipparcos(limiting_magnitude=7.0, min_separation_deg=0.0))
    assert limiting_magnitude_for("hipparcos", 4 * np.pi * 40 / (n - 1)) == pytest.approx(7.0)


def test_pairs_and_patterns_reach_as_many_stars_in_every_catalogue():
    for n in (1500, 5000, 40_000):
        cap = (1 - np.cos(separation_for(n))) / 2
        assert n * cap == pytest.approx(54)
        cap = (1 - np.cos(pattern_settings_for(n).radius_rad)) / 2
        assert n * cap == pytest.approx(13.5)


@pytest.mark.parametrize(("n_stars", "deg"), [(3, 30.0), (482_000, 0.568), (10_000_000, 0.5)])
def test_pairs_stay_within_what_is_allowed(n_stars, deg):
    assert np.degrees(separation_for(n_stars)) == pytest.approx(deg, abs=0.01)


@pytest.mark.parametrize(
    ("fov_deg", "deg"), [(12, 0.0221), (50, 0.0884), (4, 0.0078)]
)
def test_stars_that_two_pixels_hold_are_one(fov_deg, deg):
    """Two pixels of 1024 across the field, to the nearest step of 2^(1/2)."""
    found = blend_separation_deg(Camera.from_fov(fov_deg, *HD))
    assert found == pytest.approx(deg, rel=0.01)
    assert found == pytest.approx(2 * fov_deg / 1024, rel=0.2)


# The ladder


def test_the_ladder_covers_its_range_without_gaps():
    steps = ladder((4.0, 70.0), HD)
    assert (steps[0].fov_min_deg, steps[-1].fov_max_deg) == (4.0, 70.0)
    for one, following in pairwise(steps):
        assert one.fov_max_deg == following.fov_min_deg
        assert one.fov_max_deg / one.fov_min_deg <= STEP_FACTOR
    assert len(steps) == 6


def test_a_narrow_range_is_one_step():
    (step,) = ladder((11.4, 12.6), HD)
    assert step.camera.fov_deg == pytest.approx(np.sqrt(11.4 * 12.6))
    (step,) = ladder((12, 12), HD)
    assert step.camera.fov_deg == pytest.approx(12)


def test_steps_that_the_catalogue_serves_with_one_depth_are_one():
    steps = ladder((1.0, 6.0), HD)
    assert [(step.fov_min_deg, step.fov_max_deg) for step in steps] == [(1.0, 6.0)]


@pytest.mark.parametrize(
    "choice", [{"catalog": "paper"}, {"depth": Depth(limiting_magnitude=5.0)}]
)
def test_a_depth_that_is_chosen_is_one_step(choice):
    assert len(ladder((4.0, 70.0), HD, **choice)) == 1


def test_databases_of_the_ladder_are_made_when_used_and_once(monkeypatch):
    made = []
    build = FeatureDatabase.build

    def counted(*args, **options):
        made.append(1)
        return build(*args, **options)

    monkeypatch.setattr(FeatureDatabase, "build", counted)
    steps = ladder((30.0, 70.0), HD, epoch=2026.9)
    assert made == []
    widest = steps[-1].database
    assert widest is steps[-1].database
    assert made == [1]
    assert widest.catalog.epoch == 2026.9
    assert len(widest.catalog) == pytest.approx(700, abs=150)


@pytest.mark.slow
def test_the_whole_ladder_fits_a_small_computer():
    databases = [step.database for step in ladder((4.0, 70.0), HD)]
    without = sum(database.nbytes for database in databases)
    triangles = sum(sum(
        part.nbytes for part in database.triangles if isinstance(part, np.ndarray)
    ) for database in databases)
    total = sum(database.nbytes for database in databases)
    assert total == without + triangles
    assert total < 150e6


def test_size_is_that_of_all_columns():
    database = FeatureDatabase.build(StarCatalog.hipparcos(limiting_magnitude=3.0))
    n = len(database.catalog)
    # Stars 48 bytes (vector, magnitude, two numbers), sky index 28, and its 45 bands of 128 cells.
    assert database.nbytes == database.pairs.nbytes + n * (48 + 28) + 4 * (45 * 128 + 1)


def test_stars_at_one_place_make_no_triangle_with_each_other():
    """A ratio of nothing is no shape."""
    stars = StarCatalog.hipparcos(limiting_magnitude=2.5)
    vectors = np.concatenate([stars.vectors, stars.vectors[:1]])
    table = TriangleTable.build(vectors, np.zeros(len(vectors)), 4)
    assert table.fan_log_separation[-1, 0] == -np.inf
    assert len(table.rows) == table.cell_start[-1] > 0


@pytest.mark.parametrize(
    ("fov_range", "shown"), [((20.0, 10.0), "20 is not below fov_max_deg 10"),
                             ((0.0, 10.0), "0 is not below fov_max_deg 10"),
                             ((float("nan"), 10.0), "nan is not below fov_max_deg 10")],
)
def test_a_range_that_is_none_is_refused(fov_range, shown):
    text = f"fov_min_deg {shown}: give the narrowest and the widest field of view in question"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        ladder(fov_range, HD)
