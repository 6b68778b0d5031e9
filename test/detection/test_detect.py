"""Stars of rendered images: found where they were drawn, as well as the photons allow."""

import numpy as np
import pytest

from star_tracker.detection.centroids import DetectSettings, Flag
from star_tracker.detection.detect import detect_stars

NOISE, LEVEL, SIGMA_PX = 5.0, 100.0, 1.3


def image_of(stars, shape=(240, 320), *, noise=NOISE, rng=None, sigma_px=SIGMA_PX):
    """Gaussian stars (x, y, flux) on a flat noisy background; the first pixel's middle is 0.5."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    image = np.full(shape, LEVEL)
    for x, y, flux in stars:
        r2 = (columns - x) ** 2 + (rows - y) ** 2
        image += flux / (2 * np.pi * sigma_px**2) * np.exp(-r2 / (2 * sigma_px**2))
    return image + (rng or np.random.default_rng(1)).normal(0, noise, shape)


def scattered(n, rng, shape=(240, 320), flux=3000.0):
    """Stars far from each other and from the border."""
    xs = np.linspace(20, shape[1] - 20, 8)
    ys = np.linspace(20, shape[0] - 20, 6)
    grid = np.array([(x, y) for x in xs for y in ys])[rng.permutation(48)[:n]]
    return np.column_stack([grid + rng.uniform(-4, 4, (n, 2)), np.full(n, flux)])


def errors(found, stars):
    """The offset (n, 2) of each drawn star's nearest centroid."""
    offsets = found.xy_px[None] - stars[:, None, :2]
    nearest = np.argmin(np.sum(offsets**2, axis=2), axis=1)
    return offsets[np.arange(len(stars)), nearest]


def test_the_stars_are_found_where_they_were_drawn():
    rng = np.random.default_rng(2)
    stars = scattered(40, rng)
    found = detect_stars(image_of(stars, rng=rng))
    assert len(found) == 40
    assert np.max(np.abs(errors(found, stars))) < 0.3


def test_centroids_are_near_the_bound_and_unbiased():
    """Over 20 frames: rms at most 1.15 times the bound, bias below its own uncertainty."""
    rng = np.random.default_rng(3)
    all_errors = []
    for _ in range(20):
        stars = scattered(40, rng)
        all_errors.append(errors(detect_stars(image_of(stars, rng=rng)), stars))
    off = np.concatenate(all_errors)
    # Of a Gaussian on a flat background: sqrt(2) s / q, q^2 = F^2 / (4 pi s^2 noise^2).
    bound = SIGMA_PX**2 * np.sqrt(8 * np.pi) * NOISE / 3000.0
    assert np.sqrt(np.mean(off**2)) < 1.15 * bound
    assert np.all(np.abs(off.mean(axis=0)) < 4 * bound / np.sqrt(len(off)) + 0.005)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32, np.float32, ">u2", ">f4"])
def test_pixel_types_and_byte_orders_are_alike(kind):
    rng = np.random.default_rng(4)
    stars = scattered(20, rng, flux=900.0)
    image = np.clip(np.round(image_of(stars, noise=3.0, rng=rng)), 0, 255)
    found = detect_stars(image.astype(kind))
    assert len(found) == 20
    assert np.max(np.abs(errors(found, stars))) < 0.5


def test_a_colour_image_is_as_good_as_its_mean():
    rng = np.random.default_rng(5)
    stars = scattered(20, rng)
    grey = image_of(stars, rng=rng)
    found = detect_stars(np.stack([grey, grey, grey], axis=2))
    assert len(found) == 20


def test_a_gradient_and_banding_of_the_background_do_not_matter():
    rng = np.random.default_rng(6)
    stars = scattered(30, rng)
    image = image_of(stars, rng=rng)
    image += np.linspace(0, 400, image.shape[1]) + rng.normal(0, 8, (image.shape[0], 1))
    found = detect_stars(image)
    off = errors(found, stars)
    assert np.count_nonzero(np.hypot(*off.T) < 0.5) >= 29
    assert len(found) <= 33


def test_hot_pixels_are_no_stars():
    rng = np.random.default_rng(7)
    stars = scattered(20, rng)
    image = image_of(stars, rng=rng)
    hot = rng.integers(10, 230, (30, 2))
    image[hot[:, 0], hot[:, 1]] += 1500.0
    found = detect_stars(image)
    assert np.count_nonzero(np.hypot(*errors(found, stars).T) < 0.5) >= 19
    assert len(found) <= 23


@pytest.mark.parametrize("image", [
    np.zeros((100, 120)), np.full((100, 120), 255, np.uint8), np.full((50, 50), np.nan),
    np.ones((1, 1)), np.zeros((0, 10)), np.random.default_rng(8).normal(100, 5, (200, 200)),
])
def test_an_image_without_stars_gives_hardly_any(image):
    assert len(detect_stars(image)) <= 2


@pytest.mark.parametrize(("image", "word"), [
    (np.zeros(10), "shape"), (np.zeros((4, 5, 6, 7)), "shape"),
    (np.array([["a", "b"], ["c", "d"]]), "number"),
])
def test_what_is_no_image_is_refused_in_a_sentence(image, word):
    with pytest.raises(ValueError, match=word):
        detect_stars(image)


def test_the_brightest_are_kept():
    rng = np.random.default_rng(9)
    stars = scattered(40, rng)
    stars[:10, 2] *= 10
    found = detect_stars(image_of(stars, rng=rng), DetectSettings(max_stars=10))
    assert len(found) == 10
    assert np.max(np.abs(errors(found, stars[:10]))) < 0.2
    assert np.all(np.diff(found.flux) <= 0)


def test_saturated_stars_are_flagged():
    rng = np.random.default_rng(10)
    stars = scattered(20, rng)
    stars[:4, 2] = 60_000.0
    image = np.clip(image_of(stars, rng=rng), 0, 2000).astype(np.uint16)
    found = detect_stars(image, DetectSettings(saturation_level=2000))
    near = np.argmin(np.sum((found.xy_px[None] - stars[:4, None, :2]) ** 2, axis=2), axis=1)
    assert np.all(found.flagged(Flag.SATURATED)[near])
    assert np.max(np.abs(errors(found, stars[:4]))) < 0.3


def test_masked_pixels_are_not_used():
    rng = np.random.default_rng(11)
    stars = scattered(30, rng)
    mask = np.zeros((240, 320), bool)
    mask[:, :160] = True
    found = detect_stars(image_of(stars, rng=rng), mask=mask)
    assert np.all(found.x_px > 158)
    right = stars[stars[:, 0] > 165]
    assert np.max(np.abs(errors(found, right))) < 0.3
    assert len(found) <= len(right) + 1  # noise may pass for one


@pytest.mark.parametrize(("settings", "sentence"), [
    ({"threshold_sigma": 1.0}, "threshold_sigma must be from 3 to 100"),
    ({"max_stars": 0}, "max_stars must be from 1 to 5000"),
    ({"psf_sigma_px": 50.0}, "psf_sigma_px must be from"),
])
def test_settings_out_of_range_are_named(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        DetectSettings(**settings)
