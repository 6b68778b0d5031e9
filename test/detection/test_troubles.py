"""What troubles detectors: bleeding, clouds, blends, hot pixels, banding, the Moon, streaks."""

import numpy as np
import pytest
from drawn import draw, n_false, nearest, spread

from star_tracker.detection.centroids import DetectSettings, Flag
from star_tracker.detection.detect import detect_stars

EVERY = DetectSettings(max_stars=500)
#: A streak's length, px, over a rate about y, deg/s, for the camera of `drawn` (12 deg, 640 px)
#: and its exposure of 0.2 s.
PX_PER_DEG_S = 0.2 * np.radians(1) * 320 / np.tan(np.radians(6))


def test_saturated_stars_that_bleed_along_columns():
    """The charge that runs over is no star, and the star it comes from is flagged."""
    rng = np.random.default_rng(1)
    xy = spread(rng)
    signal = np.where(np.arange(len(xy)) % 12 == 0, 3000.0, 60.0)
    image = draw(xy, signal, full_well_e=4000.0, bleeding=True).image
    found = detect_stars(image, EVERY)
    bright = signal == 3000.0
    off, index = nearest(found, xy)
    assert np.all(off[~bright] < 0.5)
    seen = off[bright] < 1.0
    assert np.all(found.flagged(Flag.SATURATED)[index[bright][seen]])
    # Trails are left out or placed on their star: none becomes a star elsewhere.
    assert n_false(found, xy, within=6.0) <= 2


def test_clouds_are_no_stars():
    """Clouds take stars away, and glow where they are thick."""
    rng = np.random.default_rng(2)
    xy = spread(rng)
    drawn = draw(xy, 80.0, clouds_mag=2.0, seed=3)
    blobs = draw(xy, 80.0, clouds_mag=2.0, clouds_scale_px=60.0, seed=4).image.astype(float)
    y, x = np.mgrid[:480, :640]
    glow = 300 * np.exp(-((x - 400) ** 2 + (y - 200) ** 2) / (2 * 60.0**2))
    blobs += rng.poisson(glow)
    for image in (drawn.image, blobs):
        found = detect_stars(image, EVERY)
        assert n_false(found, xy) <= 3
        assert np.count_nonzero(nearest(found, xy)[0] < 0.6) > 0.6 * len(xy)


@pytest.mark.parametrize("apart_px", [4.0, 5.0, 8.0])
def test_blends_are_split(apart_px):
    """Pairs of like stars among single ones: both are found, flagged and unbiased."""
    rng = np.random.default_rng(6)
    every = spread(rng)
    middle, single = every[::3], np.delete(every, slice(None, None, 3), axis=0)
    angle = rng.uniform(0, np.pi, len(middle))
    half = apart_px / 2 * np.column_stack([np.cos(angle), np.sin(angle)])
    xy = np.vstack([middle - half, middle + half])
    found = detect_stars(draw(np.vstack([xy, single]), 60.0).image, EVERY)
    off, index = nearest(found, xy)
    assert np.count_nonzero(off < 0.5) > 0.97 * len(xy)
    assert n_false(found, np.vstack([xy, single])) <= 2
    along = np.sum((found.xy_px[index] - xy)[off < 0.5] * np.vstack([-half, half])[off < 0.5],
                   axis=1) / (apart_px / 2)
    assert abs(along.mean()) < 0.02
    if apart_px < 5.5:
        assert np.mean(found.flagged(Flag.BLEND)[index]) > 0.9


def test_hot_pixels_are_left_out():
    xy = spread(np.random.default_rng(7))
    image = draw(xy, 60.0, hot_pixels=5e-4, seed=7).image
    found = detect_stars(image, EVERY)
    off, _ = nearest(found, xy)
    assert np.count_nonzero(off < 0.5) > 0.95 * len(xy)
    # 150 hot pixels; the faintest of them are as sharp as noise allows a star to be.
    assert n_false(found, xy) <= 8


@pytest.mark.parametrize("settings", [
    {"row_banding_e": 20.0}, {"column_banding_e": 20.0},
    {"row_banding_e": 15.0, "column_banding_e": 15.0, "sky_gradient": (1.2, -0.6)},
    {"sky_gradient": (1.9, 0.0), "sky_e_per_s": 2000.0},
], ids=["rows", "columns", "both and gradient", "gradient"])
def test_banding_and_gradients_give_no_false_stars(settings):
    xy = spread(np.random.default_rng(8))
    found = detect_stars(draw(xy, 20.0, **settings, seed=8).image, EVERY)
    assert np.count_nonzero(nearest(found, xy)[0] < 0.8) > 0.97 * len(xy)
    assert n_false(found, xy) <= 3


def test_a_bright_disc_is_no_star():
    """The Moon: half a degree of saturated pixels with a halo around it."""
    xy = spread(np.random.default_rng(9))
    image = draw(xy, 60.0, seed=9).image.astype(float)
    y, x = np.mgrid[:480, :640] + 0.5
    radius = np.hypot(x - 330, y - 250)
    image += 3000 * np.exp(-np.maximum(radius - 14, 0) / 25)
    image[radius < 14] = 60_000
    found = detect_stars(np.clip(image, 0, 60_000).astype(np.uint16), EVERY)
    far = np.hypot(*(xy - (330, 250)).T) > 100
    assert np.count_nonzero(nearest(found, xy[far])[0] < 0.5) > 0.97 * np.count_nonzero(far)
    assert np.count_nonzero(np.hypot(found.x_px - 330, found.y_px - 250) < 20) == 0
    assert n_false(found, xy) <= 5


def turning(xy, length_px, seed, **settings):
    """An image whose stars move `length_px` along x in the exposure."""
    rate = (0.0, length_px / PX_PER_DEG_S, 0.0)
    return draw(xy, 150.0, rate_deg_s=rate, seed=seed, **settings)


def test_streaks_of_20_px_are_placed_at_their_middle():
    xy = spread(np.random.default_rng(10), apart=80)
    drawn = turning(xy, 20.0, 10)
    found = detect_stars(drawn.image, EVERY)
    inside = np.all((drawn.xy_px > 20) & (drawn.xy_px < (620, 460)), axis=1)
    off, index = nearest(found, drawn.xy_px[inside])
    assert np.count_nonzero(off < 1.0) > 0.9 * np.count_nonzero(inside)
    error = (found.xy_px[index] - drawn.xy_px[inside])[off < 1.0]
    assert np.all(np.abs(error.mean(axis=0)) < 0.05)
    assert np.all(found.flagged(Flag.STREAK)[index[off < 1.0]])
    assert abs(np.hypot(*found.quality.streak_px) - 20.0) < 3.0
    assert n_false(found, drawn.xy_px) <= 2


def test_streaks_of_60_px_are_placed_at_their_middle_or_left_out():
    """None is taken for several stars, and what is told as a streak is one."""
    xy = spread(np.random.default_rng(11), apart=120, jitter=10.0)
    drawn = turning(xy, 60.0, 11)
    found = detect_stars(drawn.image, EVERY)
    assert n_false(found, drawn.xy_px, within=6.0) <= 2
    assert len(found) <= len(xy) + 2


@pytest.mark.parametrize("length_px", [100.0, 200.0])
def test_streaks_too_long_to_be_told_give_no_stars(length_px):
    """A piece of each would do for a star, and put all of them off by as much."""
    xy = spread(np.random.default_rng(13), apart=120, jitter=10.0)
    found = detect_stars(turning(xy, length_px, 13, exposure_s=0.2).image, EVERY)
    assert len(found) == 0
    dx, dy = found.quality.streak_px
    assert abs(dx) > 60
    assert abs(dy) < 0.1 * abs(dx)


def test_one_streak_among_stars_is_left_out():
    """A satellite crosses the image."""
    xy = spread(np.random.default_rng(12))
    image = draw(xy, 60.0, seed=12).image.astype(float)
    y, x = np.mgrid[:480, :640] + 0.5
    off = (y - 100) - 0.4 * (x - 200)
    image += 800 * np.exp(-(off**2) / 2) * (np.abs(x - 300) < 60)
    found = detect_stars(image, EVERY)
    near = (np.abs((found.y_px - 100) - 0.4 * (found.x_px - 200)) < 4) & (
        np.abs(found.x_px - 300) < 60)
    stars = np.hypot(*np.moveaxis(found.xy_px[near][:, None] - xy[None], 2, 0))
    assert np.count_nonzero(near) - np.count_nonzero(stars.min(axis=1, initial=9) < 1) <= 2
