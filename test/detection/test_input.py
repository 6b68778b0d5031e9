"""What is handed to the detector: types, damaged pixels, sizes; what it may cost."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from drawn import SENSOR, draw, electrons_of, nearest, spread

from star_tracker.detection.centroids import DetectSettings, Flag
from star_tracker.detection.detect import detect_stars

EVERY = DetectSettings(max_stars=500)


def starry(signal=60.0, **settings):
    """An image, and where its stars are."""
    xy = spread(np.random.default_rng(1))
    return draw(xy, signal, **settings).image, xy


def refused(image, **more):
    """The one sentence that an image is refused with."""
    with pytest.raises(ValueError) as error:  # noqa: PT011
        detect_stars(image, **more)
    sentence = str(error.value)
    assert "\n" not in sentence
    assert ": " in sentence  # what is wrong: what to do
    return sentence


def test_all_types_give_the_same_stars():
    image, _ = starry()
    first = detect_stars(image, EVERY)
    for kind in ("<u2", ">u2", "<i4", ">i8", "<f4", ">f4", "<f8", ">f8"):
        found = detect_stars(image.astype(kind), EVERY)
        assert np.array_equal(found.xy_px, first.xy_px), kind


def test_the_image_is_not_changed_and_may_be_a_view():
    image, xy = starry()
    wide = np.zeros((image.shape[0], 2 * image.shape[1]), image.dtype)
    view = wide[:, ::2]
    view[:] = image
    before = wide.copy()
    assert np.all(nearest(detect_stars(view, EVERY), xy)[0] < 0.5)
    assert np.array_equal(wide, before)
    image.setflags(write=False)
    assert len(detect_stars(image, EVERY)) > 0


def test_a_second_image_does_not_change_the_first_one_s_stars():
    image, _ = starry()
    first = detect_stars(image, EVERY)
    kept = first.xy_px.copy()
    detect_stars(image[::-1], EVERY)
    assert np.array_equal(first.xy_px, kept)
    assert np.array_equal(detect_stars(image, EVERY).xy_px, kept)


def test_pixels_that_are_not_finite_are_left_out():
    image, xy = starry()
    damaged = image.astype(np.float32)
    rng = np.random.default_rng(2)
    for value in (np.nan, np.inf, -np.inf):
        damaged[rng.integers(0, 480, 60), rng.integers(0, 640, 60)] = value
    damaged[:40] = np.nan
    found = detect_stars(damaged, EVERY)
    off, _ = nearest(found, xy[xy[:, 1] > 50])
    assert np.count_nonzero(off < 0.5) >= 0.97 * len(off)
    assert np.all(np.isfinite(found.xy_px))
    assert len(found) <= len(xy) + 3


@pytest.mark.parametrize("image", [
    np.zeros((300, 400), np.uint8), np.full((300, 400), 255, np.uint8),
    np.full((300, 400), 65535, np.uint16), np.zeros((1, 1), np.uint8), np.ones((1, 500)),
    np.zeros((0, 0)), np.zeros((4, 0), np.uint8), np.full((60, 60), np.inf),
    np.full((60, 60), np.nan, np.float32), np.zeros((300, 400, 3), np.uint8),
], ids=["black", "white", "white 16", "1x1", "line", "none", "no columns", "inf", "nan", "rgb"])
def test_nothing_is_seen_where_nothing_is(image):
    found = detect_stars(image)
    assert len(found) == 0
    assert found.xy_px.shape == (0, 2)


def test_an_image_too_large_is_refused_before_anything_is_allocated():
    """A view of one byte stands for 20,000 x 20,000 pixels."""
    huge = np.broadcast_to(np.uint8(7), (20_000, 20_000))
    tracemalloc.start()
    sentence = refused(huge)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sentence == (
        "the image has 20000 x 20000 pixels, more than 160 million: bin or crop it"
    )
    assert peak < 1_000_000


@pytest.mark.parametrize(("image", "more", "words"), [
    (np.zeros((4, 4), complex), {}, "complex128"),
    (np.zeros((4, 4), object), {}, "object"),
    (np.zeros((4, 4), "M8[s]"), {}, "datetime64"),
    (np.zeros((4, 4, 2)), {}, "(4, 4, 2)"),
    (np.full((40, 40), 1e35, np.float32), {}, "the image holds values of 1e+35: scale them to"),
    (np.zeros((40, 40)), {"mask": np.zeros((40, 41))}, "the mask has 41 x 40 pixels"),
    (np.zeros((40, 40)), {"dark": np.zeros((20, 40))}, "the dark has 40 x 20 pixels"),
    (np.zeros((40, 40)), {"dark": np.zeros(40)}, "the dark has shape (40,)"),
    (np.zeros((40, 40)), {"bayer": "rgb"}, "bayer 'rgb' is unknown"),
    (np.zeros((40, 40, 3)), {"bayer": "rggb"}, "one plane"),
])
def test_what_cannot_be_used_is_named(image, more, words):
    assert words in refused(image, **more)


@pytest.mark.parametrize("most", [1, 150, 5000])
def test_noise_that_looks_like_stars_costs_no_more_than_the_stars_asked_for(most):
    """Every fourth pixel is a peak far above the noise: the places looked at are bounded."""
    rng = np.random.default_rng(3)
    image = rng.exponential(200.0, (600, 800)).astype(np.uint16)
    image[:, :400] = 100 + rng.integers(0, 3, (600, 400))
    image[::4, ::4] += 500
    detect_stars(image)
    tracemalloc.start()
    found = detect_stars(image, DetectSettings(max_stars=most))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found) <= most
    assert found.quality.n_peaks <= 8 * most
    assert peak < 12 * image.size + 4000 * most


def test_a_mask_leaves_its_pixels_out():
    image, xy = starry()
    mask = np.zeros(image.shape, bool)
    mask[:, 300:] = True
    found = detect_stars(image, EVERY, mask=mask)
    inside = xy[:, 0] < 290
    assert np.all(nearest(found, xy[inside])[0] < 0.5)
    assert np.all(found.x_px < 303)


def test_a_dark_frame_takes_hot_pixels_and_glow_away():
    """Hot groups of pixels that look like stars; what saturates in the image stays saturated."""
    rng = np.random.default_rng(4)
    xy = spread(rng)
    hot = spread(rng) + 32.0
    hot = hot[(hot[:, 0] < 630) & (hot[:, 1] < 470)]
    both = draw(np.vstack([xy, hot]), 60.0, seed=1).image
    in_the_dark = 60.0 * electrons_of(1.0) / electrons_of(1.0, replace(SENSOR, sky_e_per_s=0.0))
    dark = draw(hot, in_the_dark, sky_e_per_s=0.0, seed=2).image
    with_dark = detect_stars(both, EVERY, dark=dark)
    assert np.all(nearest(with_dark, xy)[0] < 0.5)
    off, _ = nearest(with_dark, hot)
    # Their noise is left: half of theirs again beyond the background's.
    assert np.count_nonzero(off < 1.0) <= 4
    assert np.count_nonzero(nearest(detect_stars(both, EVERY), hot)[0] < 1.0) > 0.9 * len(hot)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_bayer_patterns(pattern):
    """Colours of unequal response: a checkered background, stars of two pixels' width."""
    image, xy = starry(150.0, bayer=pattern, sky_e_per_s=2000.0)
    found = detect_stars(image, EVERY, bayer=pattern)
    off, index = nearest(found, xy)
    assert np.all(off < 0.4)
    assert np.sqrt(np.mean(off**2)) < 0.15
    assert len(found) <= len(xy) + 3
    assert not np.any(found.flagged(Flag.SATURATED)[index])


def test_suspects_are_kept_where_they_are_asked_for():
    rng = np.random.default_rng(5)
    image, _ = starry()
    image = image.copy()
    image[rng.integers(20, 460, 10), rng.integers(20, 620, 10)] += 3000
    assert not np.any(detect_stars(image, EVERY).flagged(Flag.HOT))
    kept = detect_stars(image, DetectSettings(max_stars=500, keep_suspects=True))
    assert np.count_nonzero(kept.flagged(Flag.HOT)) >= 8
