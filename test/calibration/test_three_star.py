"""Boresight from three stars: both closed forms, the unknown focal length, what is refused."""

import math
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import chi2

from star_tracker.calibration import three_star
from star_tracker.calibration.error_propagation import (
    three_star_covariance,
    unknown_focal_length_covariance,
)
from star_tracker.calibration.three_star import (
    MAX_ERROR_FACTOR,
    boresight_linear,
    boresight_spherical,
    boresight_unknown_focal_length,
    cosine_by_focal_length,
    cosine_by_radius,
    cosines,
    error_factor,
    radii_px,
    tetrahedron_volume,
)
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import separation, tangent_basis, unit_vectors
from star_tracker.maps.simulation import random_rotation
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

ARCSEC = np.pi / 180 / 3600
METHODS = pytest.mark.parametrize("method", [boresight_linear, boresight_spherical])
#: Coordinates of the maps are rounded to 0.01 px: 0.005 px at most along each axis.
ROUNDING_PX = 0.01 / math.sqrt(12)
WORST_RADIUS_ERROR_PX = 0.005 * math.sqrt(2)


class MapStars:
    """The stars of a shipped map: vectors, radii, focal length and true boresight."""

    def __init__(self, number):
        (star_map,) = paper_maps((number,))
        known = star_map.star_number > 0
        self.labels = [star_map.labels[i] for i in np.flatnonzero(known)]
        self.vectors = StarCatalog.paper().vectors[star_map.star_number[known] - 1]
        self.a = radii_px(star_map.camera, star_map.xy_px[known])
        self.f = star_map.camera.focal_length_px
        self.truth = star_map.pose.rotation[:, 2]

    def triples(self):
        index = np.array(list(combinations(range(len(self.a)), 3)))
        return index[error_factor(self.vectors[index]) <= MAX_ERROR_FACTOR]


@pytest.fixture(scope="module")
def map1():
    return MapStars(1)


@pytest.fixture(scope="module", params=[1, 2, 4, pytest.param(7, marks=pytest.mark.slow)])
def stars_of_map(request):
    return MapStars(request.param)


def exact_field(seed, fov_deg=12.0, n=3):
    """Return stars (n, 3), radii (n,), focal length and boresight of a field without noise."""
    rng = np.random.default_rng(seed)
    camera, rotation = Camera.from_fov(fov_deg, 512, 512), random_rotation(rng)
    xy = rng.random((n, 2)) * 512
    return camera.vectors(xy) @ rotation.T, radii_px(camera, xy), camera.fx_px, rotation[:, 2]


def tangential(direction, truth):
    """Return the error of a direction along east and north, rad."""
    return np.stack(tangent_basis(truth)) @ (direction - truth)


# Known focal length


@METHODS
def test_boresight_of_the_first_three_stars_of_map_1(map1, method):
    """Rounding to 0.01 px leaves 1.6"."""
    assert map1.labels[:3] == ["A01", "A02", "A03"]
    found = method(map1.vectors[:3], map1.a[:3], map1.f)
    truth = unit_vectors(math.radians(109.6), math.radians(34.5))
    assert separation(found.direction, truth) < 2 * ARCSEC
    assert found.norm == pytest.approx(1, abs=1e-5)
    assert found.iterations == 0


@METHODS
@pytest.mark.parametrize("fov_deg", [1.0, 12.0, 60.0, 110.0])
def test_the_boresight_is_exact_without_noise(method, fov_deg):
    for seed in range(40):
        stars, a, f, truth = exact_field(seed, fov_deg)
        k = error_factor(stars)
        if k > MAX_ERROR_FACTOR:
            continue
        found = method(stars, a, f)
        # Rounding errors of 1e-16 in the cosines grow by about 2 K.
        assert separation(found.direction, truth) < 2e-15 * k
        assert found.norm == pytest.approx(1, abs=2e-15 * k)


@METHODS
@pytest.mark.parametrize(("ra_deg", "dec_deg"), [(0, 0), (200, 90), (20, -90), (359.9999, 89.9)])
def test_quadrants_and_poles_need_no_special_care(method, ra_deg, dec_deg):
    """(4-11) leaves the quadrant open and (4-9) divides by sin of the first declination."""
    truth = unit_vectors(math.radians(ra_deg), math.radians(dec_deg))
    east, north = tangent_basis(truth)
    f = 1000.0
    for turn in np.radians([0, 45, 170, 290]):
        azimuth = turn + np.radians([0, 100, 220])
        a = np.array([100.0, 150.0, 200.0])
        towards = np.outer(np.cos(azimuth), north) + np.outer(np.sin(azimuth), east)
        stars = (f * truth + a[:, None] * towards) / np.hypot(f, a)[:, None]
        found = method(stars, a, f)
        assert separation(found.direction, truth) < 1e-13
        assert found.dec_rad == pytest.approx(math.radians(dec_deg), abs=1e-7)
        if abs(dec_deg) < 90:
            assert np.cos(found.ra_rad - math.radians(ra_deg)) == pytest.approx(1)


def test_a_star_at_the_celestial_pole_may_be_the_first():
    truth = unit_vectors(1.0, math.radians(88))
    stars = np.array([(0.0, 0, 1), unit_vectors(0.5, 1.45), unit_vectors(4.0, 1.5)])
    a = 1000 * np.tan(separation(stars, truth))
    for method in (boresight_linear, boresight_spherical):
        assert separation(method(stars, a, 1000).direction, truth) < 1e-13


@METHODS
def test_the_boresight_does_not_depend_on_the_order_of_the_stars(method):
    stars, a, f, truth = exact_field(2)
    for order in ([0, 1, 2], [1, 2, 0], [2, 1, 0]):
        found = method(stars[order], a[order], f).direction
        assert separation(found, truth) < 1e-13


def test_both_methods_agree_on_every_triple_and_follow_the_covariance(stars_of_map):
    """Triples share stars, so that their errors are not independent.

    Hence a hard bound for each, from the largest error of rounding, and wide ones for the share
    within the ellipse of 95 %.
    """
    nees = []
    for t in stars_of_map.triples():
        stars, a = stars_of_map.vectors[t], stars_of_map.a[t]
        found = boresight_linear(stars, a, stars_of_map.f)
        other = boresight_spherical(stars, a, stars_of_map.f)
        assert separation(found.direction, other.direction) < 1e-9
        assert found.norm == pytest.approx(other.norm, abs=1e-9)
        error = tangential(found.direction, stars_of_map.truth)
        moved = np.stack(tangent_basis(stars_of_map.truth)) @ np.linalg.inv(stars)
        reach = np.linalg.norm(moved, axis=0) * np.abs(cosine_by_radius(a, stars_of_map.f))
        assert np.linalg.norm(error) < 1.02 * WORST_RADIUS_ERROR_PX * reach.sum() + 0.01 * ARCSEC
        p = three_star_covariance(stars, a, stars_of_map.f, ROUNDING_PX)
        nees.append(error @ np.linalg.solve(p, error))
    assert 0.85 < np.mean(np.array(nees) < chi2.ppf(0.95, 2)) <= 1.0
    assert 0.5 < np.mean(nees) / 2 < 1.6


# Unknown focal length


@pytest.mark.parametrize("off", [0.95, 1.0, 1.05])
def test_focal_length_and_boresight_of_the_first_three_stars_of_map_1(map1, off):
    found = boresight_unknown_focal_length(map1.vectors[:3], map1.a[:3], off * map1.f)
    assert separation(found.direction, map1.truth) < 2 * ARCSEC
    assert found.focal_length_px == pytest.approx(map1.f, rel=1e-4)
    assert found.norm == pytest.approx(1, abs=1e-12)
    assert 1 <= found.iterations < 10


def test_where_the_start_lies_does_not_change_the_focal_length(map1):
    found = [
        boresight_unknown_focal_length(map1.vectors[:3], map1.a[:3], off * map1.f)
        for off in (0.93, 0.97, 1.08)
    ]
    values = [each.focal_length_px for each in found]
    np.testing.assert_allclose(values, values[0], rtol=1e-10)


@pytest.mark.parametrize("off", [0.95, 1.05])
def test_each_triple_gives_its_focal_length_or_is_refused(stars_of_map, off):
    """Rounding is the only error: a focal length is within six standard errors of the truth.

    The boresight too, where the first order is enough: where rounding moves f by less than 0.1 %,
    for the other focal length is then far away.
    """
    triples = stars_of_map.triples()
    given = sharp = 0
    refusals = set()
    for t in triples:
        stars, a = stars_of_map.vectors[t], stars_of_map.a[t]
        try:
            found = boresight_unknown_focal_length(stars, a, off * stars_of_map.f)
        except ValueError as error:
            refusals.add(str(error).split(" fit the radii")[0])
            continue
        given += 1
        p = unknown_focal_length_covariance(
            stars, found.direction, a, found.focal_length_px, ROUNDING_PX
        )
        error_px = found.focal_length_px - stars_of_map.f
        assert abs(error_px) < 6 * math.sqrt(p[2, 2])
        assert found.norm == pytest.approx(1, abs=1e-10)
        if p[2, 2] > (1e-3 * stars_of_map.f) ** 2:
            continue
        sharp += 1
        error = tangential(found.direction, stars_of_map.truth)
        assert error @ np.linalg.solve(p[:2, :2], error) < 36
    assert refusals == {f"no focal length or two within 10% of {off * stars_of_map.f:.6g} px"}
    assert given > 0.6 * len(triples)
    assert sharp > 0.99 * given


def planar_triple(d_over_r, f=2000.0, turn=0.3):
    """Return stars, radii and boresight that lies d_over_r circumradii from the circumcentre."""
    azimuth = turn + np.radians([0, 110, 230])
    radius = 0.05
    around = radius * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    stars = around + np.array([0, 0, 1])
    stars /= np.linalg.norm(stars, axis=1, keepdims=True)
    truth = np.array([d_over_r * radius, 0, 1]) / math.hypot(d_over_r * radius, 1)
    return stars, f * np.tan(separation(stars, truth)), f, truth


@pytest.mark.parametrize("d_over_r", [0.5, 0.7, 1.5])
def test_the_other_focal_length_is_d_over_r_times_the_true_one(d_over_r):
    """Inverse points of the circle through the stars; exact in the plane, here to 0.1^2 = 1 %."""
    stars, a, f, truth = planar_triple(d_over_r)
    found = boresight_unknown_focal_length(stars, a, 1.02 * f)
    assert found.focal_length_px == pytest.approx(f, rel=1e-9)
    assert separation(found.direction, truth) < 1e-9
    other = boresight_unknown_focal_length(stars, a, 1.02 * f * d_over_r)
    assert other.focal_length_px == pytest.approx(d_over_r * f, rel=0.01)
    assert separation(other.direction, truth) > 0.5 * abs(1 / d_over_r - d_over_r) * 0.05


@pytest.mark.parametrize("d_over_r", [0.95, 1.0, 1.05])
def test_a_boresight_near_the_circle_through_the_stars_is_refused(d_over_r):
    stars, a, f, _ = planar_triple(d_over_r)
    with pytest.raises(ValueError, match=r"two within 10% of 2000 px .* near the circle"):
        boresight_unknown_focal_length(stars, a, f)


def test_radii_that_no_focal_length_fits_are_refused(map1):
    with pytest.raises(ValueError, match=r"no focal length or two within 10%"):
        boresight_unknown_focal_length(map1.vectors[:3], 3 * map1.a[:3], map1.f)


def test_the_focal_length_must_be_within_the_deviation(map1):
    stars, a = map1.vectors[:3], map1.a[:3]
    with pytest.raises(ValueError, match=r"within 1% of"):
        boresight_unknown_focal_length(stars, a, 1.05 * map1.f, max_deviation=0.01)


def test_an_iteration_that_does_not_end_is_refused(map1, monkeypatch):
    monkeypatch.setattr(three_star, "_MAX_ITERATIONS", 2)
    with pytest.raises(ValueError, match=r"^the focal length did not converge in 2 steps$"):
        boresight_unknown_focal_length(map1.vectors[:3], map1.a[:3], 1.05 * map1.f)


@pytest.mark.parametrize("deviation", [0.0, 1.0, math.nan])
def test_a_deviation_out_of_range_is_refused(map1, deviation):
    with pytest.raises(ValueError, match=r"^max_deviation .* is outside of 0 to 1$"):
        boresight_unknown_focal_length(
            map1.vectors[:3], map1.a[:3], map1.f, max_deviation=deviation
        )


# Degenerate input, all three functions alike


def unknown(stars, a, f):
    return boresight_unknown_focal_length(stars, a, f)


EVERY = pytest.mark.parametrize("method", [boresight_linear, boresight_spherical, unknown])


@EVERY
@pytest.mark.parametrize("bend", [0.0, 1e-9, 1e-4])
def test_stars_on_one_great_circle_are_refused(method, bend):
    plane = np.array([(-0.05, 0.01, 1.0), (0.0, 0.01 + bend, 1.0), (0.07, 0.01, 1.0)])
    stars = plane / np.linalg.norm(plane, axis=1, keepdims=True)
    with pytest.raises(ValueError, match=r"^the three stars lie nearly on one great circle"):
        method(stars, [120.0, 30.0, 160.0], 2435.7)


@EVERY
def test_equal_stars_are_refused(method):
    stars, a, f, _ = exact_field(4)
    stars[2] = stars[0]
    with pytest.raises(ValueError, match=r"^stars 1 and 3 have the same direction"):
        method(stars, a, f)


@EVERY
@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_impossible_radii_are_refused(method, bad):
    stars, a, f, _ = exact_field(5)
    with pytest.raises(ValueError, match=r"0 or more: give the distance of each star from"):
        method(stars, [a[0], bad, a[2]], f)


@EVERY
@pytest.mark.parametrize("f", [0.0, -1.0, math.nan, math.inf])
def test_impossible_focal_lengths_are_refused(method, f):
    stars, a, _, _ = exact_field(6)
    with pytest.raises(ValueError, match=r"^the focal length must be a finite number"):
        method(stars, a, f)


@EVERY
def test_other_shapes_and_lengths_are_refused(method):
    stars, a, f, _ = exact_field(7, n=4)
    with pytest.raises(ValueError, match=r"not \(4, 3\) and \(4,\)$"):
        method(stars, a, f)
    for wrong in (2 * stars[:3], np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match=r"^the star vectors are not unit vectors$"):
            method(wrong, a[:3], f)


# The pieces


def test_k_of_the_unit_axes_by_hand():
    """R = I: adj(I) has trace 3, det 1, so K^2 = 3 / 2; the corner of the cube is 1/6."""
    assert error_factor(np.eye(3)) == pytest.approx(math.sqrt(1.5))
    assert tetrahedron_volume(np.eye(3)) == pytest.approx(1 / 6)


def test_k_is_the_printed_formula():
    """(4-27) with the adjugate as det(A) A^-1."""
    for seed in range(20):
        stars, *_ = exact_field(seed, 40.0)
        gram = stars.T @ stars
        determinant = np.linalg.det(gram)
        adjugate = determinant * np.linalg.inv(gram)
        expected = math.sqrt(np.trace(adjugate) / (2 * determinant))
        assert error_factor(stars) == pytest.approx(expected, rel=1e-9)
        volume = tetrahedron_volume(stars)
        assert volume == pytest.approx(math.sqrt(determinant) / 6, rel=1e-9)
        # (4-30): K^2 = tr(B) / (72 V^2).
        assert expected**2 == pytest.approx(np.trace(adjugate) / (72 * volume**2), rel=1e-9)


def test_k_of_many_triples_at_once_and_of_a_great_circle():
    many = np.stack([exact_field(seed)[0] for seed in range(5)])
    np.testing.assert_allclose(error_factor(many), [error_factor(each) for each in many])
    assert error_factor(np.array([(1.0, 0, 0), (0, 1, 0), (0.6, 0.8, 0)])) == math.inf


def test_cosines_and_their_derivatives():
    a, f, step = np.array([1.0, 50.0, 300.0]), 400.0, 1e-4
    np.testing.assert_allclose(cosines(a, f), np.cos(np.arctan(a / f)), rtol=1e-15)
    by_f = (cosines(a, f + step) - cosines(a, f - step)) / (2 * step)
    by_a = (cosines(a + step, f) - cosines(a - step, f)) / (2 * step)
    np.testing.assert_allclose(cosine_by_focal_length(a, f), by_f, atol=1e-11)
    np.testing.assert_allclose(cosine_by_radius(a, f), by_a, atol=1e-11)


def test_radii_are_those_of_a_pinhole_also_behind_a_lens():
    camera = Camera.from_fov(20.0, 1024, 1024)
    lens = Camera(
        1024, 1024, camera.fx_px, camera.fy_px, 512, 512, "mirrored",
        Distortion("plumb_bob", (0.2, 0.0, 0.0, 0.0, 0.0)),
    )
    plane = np.array([(0.1, -0.05), (0.0, 0.02), (-0.08, 0.12)])
    expected = camera.fx_px * np.hypot(*plane.T)
    np.testing.assert_allclose(radii_px(lens, lens.pixels_of_plane(plane)), expected, rtol=1e-10)
    np.testing.assert_allclose(radii_px(camera, [(512 + 3, 512 - 4)]), [5.0])


# The paper's printed solution


def test_the_printed_solution_of_the_linear_system_has_three_slips():
    """(4-8) is right; (4-7) lacks a minus, (4-9) has cot for cos in two places.

    With x, y, z the components of the star vectors, over the determinant, both sides of (4-9)
    multiplied by z_1.
    """
    stars, a, f, truth = exact_field(8)
    k1, k2, k3 = cosines(a, f)
    (x1, x2, x3), (y1, y2, y3), (z1, z2, z3) = stars.T
    dec = np.arcsin(stars[:, 2])
    determinant = np.linalg.det(stars)
    first = y3 * (k2 * z1 - k1 * z2)
    others = y2 * (k3 * z1 - k1 * z3) + y1 * (k2 * z3 - k3 * z2)
    assert -(others - first) / determinant == pytest.approx(truth[0], abs=1e-10)
    assert abs(-(others + first) / determinant - truth[0]) > 1e-3
    m32 = -x3 * (k2 * z1 - k1 * z2) + x2 * (k3 * z1 - k1 * z3) + x1 * (k2 * z3 - k3 * z2)
    assert m32 / determinant == pytest.approx(truth[1], abs=1e-10)

    def m33(cot_or_cos):
        c2, c3 = cot_or_cos(dec[1]), cot_or_cos(dec[2])
        ra = np.arctan2(stars[:, 1], stars[:, 0])
        return (
            x3 * (-k2 * y1 + k1 * c2 * np.sin(ra[1]))
            + x1 * (k2 * y3 - k3 * y2)
            + x2 * (k3 * y1 - k1 * c3 * np.sin(ra[2]))
        ) / -determinant

    assert m33(np.cos) == pytest.approx(truth[2], abs=1e-10)
    assert abs(m33(lambda angle: 1 / np.tan(angle)) - truth[2]) > 1e-3
