"""Merging of close stars: neighbours of a brightest star, and what images of them show."""

import numpy as np
import pytest
from scipy.ndimage import label
from scipy.spatial import cKDTree

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.depth import BLEND_PX
from star_tracker.catalogue.merging import merge_close
from star_tracker.geometry.spherical import chord, ra_dec, separation, unit_vectors


def merged_from(catalog, deg):
    return merge_close(catalog.vectors, catalog.v_mag, np.radians(deg))


@pytest.fixture(scope="module")
def bright():
    """The stars to V = 6.5 that can matter to those of V <= 4.5, unmerged."""
    return StarCatalog.hipparcos(limiting_magnitude=6.5, min_separation_deg=0.0)


@pytest.mark.parametrize("deg", [0.05, 0.3, 1.0])
def test_every_star_left_is_the_brightest_within_the_limit_of_its_own_place(bright, deg):
    """None of those that are left has a brighter one left beside it."""
    left = merged_from(bright, deg).brightest
    tree = cKDTree(bright.vectors[left])
    assert len(tree.query_pairs(float(chord(np.radians(deg))))) == 0


@pytest.mark.parametrize("deg", [0.3, 1.0])
def test_no_light_is_lost_and_none_made(bright, deg):
    merged = merged_from(bright, deg)
    assert np.sum(10 ** (-0.4 * merged.v_mag)) == pytest.approx(
        np.sum(10 ** (-0.4 * bright.v_mag))
    )


@pytest.mark.parametrize("deg", [0.05, 0.3, 0.7, 1.0])
def test_merging_moves_no_star_by_the_limit_and_makes_none_that_outshines_sirius(bright, deg):
    """Merging whole chains moved 316 stars by up to 33 deg at 1 deg, and made one of V = -3.6."""
    merged = merged_from(bright, deg)
    seen = merged.v_mag <= 4.5
    way_deg = np.degrees(
        separation(merged.vectors[seen], bright.vectors[merged.brightest[seen]])
    )
    assert np.max(way_deg) < 0.6 * deg
    assert np.median(way_deg) < 0.1 * deg
    assert bright.hip[merged.brightest[np.argmin(merged.v_mag)]] == 32349
    assert np.min(merged.v_mag) == pytest.approx(-1.44, abs=0.01)
    assert 921 <= np.count_nonzero(seen) < 1.3 * 921


SIZE_PX, SIGMA_PX = 48, 1.0


def rendered(xy_px, v_mag):
    """An image of point sources, of a star image with a standard deviation of 1 px."""
    at = np.arange(SIZE_PX) + 0.5
    spread = [np.exp(-((at - xy_px[:, [axis]]) ** 2) / (2 * SIGMA_PX**2)) for axis in (0, 1)]
    return np.einsum("k,ky,kx->yx", 10 ** (-0.4 * v_mag), spread[1], spread[0])


def brightest_centroid(image, threshold):
    """First moment of the connected pixels above a threshold about the highest."""
    blobs, _ = label(image > threshold)
    here = blobs == blobs[np.unravel_index(np.argmax(image), image.shape)]
    weight = np.where(here, image, 0.0)
    at = np.arange(SIZE_PX) + 0.5
    return np.array([weight.sum(axis=0) @ at, weight.sum(axis=1) @ at]) / weight.sum()


@pytest.mark.parametrize("apart_px", [0.5, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("fainter_mag", [0.0, 1.0, 2.0])
def test_a_blend_in_an_image_is_where_the_merged_star_is(apart_px, fainter_mag):
    """Two stars as near as `depth.BLEND_PX`, with a third star far off, in a deg of 10 px."""
    places_deg = np.array([[2.4, 2.4], [2.4 + apart_px / 10, 2.4], [4.0, 4.0]])
    v_mag = np.array([3.0, 3.0 + fainter_mag, 4.0])
    merged = merge_close(
        unit_vectors(*np.radians(places_deg).T), v_mag, np.radians(BLEND_PX / 10 + 1e-6)
    )
    assert len(merged.v_mag) == 2
    seen = brightest_centroid(rendered(10 * places_deg, v_mag), 0.1 * 10 ** (-0.4 * 3.0))
    ra, dec = ra_dec(merged.vectors[0])
    np.testing.assert_allclose(seen, 10 * np.degrees([ra, dec]), atol=0.15)


def test_the_order_of_the_stars_does_not_matter_but_for_equals():
    rng = np.random.default_rng(3)
    places = np.radians(rng.uniform(0, 3, (60, 2)))
    vectors, v_mag = unit_vectors(places[:, 0], places[:, 1]), rng.uniform(3, 6, 60)
    one = merge_close(vectors, v_mag, np.radians(0.3))
    turned = merge_close(vectors[::-1], v_mag[::-1], np.radians(0.3))
    np.testing.assert_array_equal(one.brightest, 59 - turned.brightest[::-1])
    np.testing.assert_allclose(one.vectors, turned.vectors[::-1], atol=1e-15)
