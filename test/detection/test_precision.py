"""Centroids of rendered stars against the Cramer-Rao bound, from q = 5 to saturation."""

import numpy as np
import pytest
from drawn import SENSOR, draw, electrons_of, n_false, nearest, noise_e, spread

from star_tracker.detection.bound import position_bound_px
from star_tracker.detection.centroids import DetectSettings, Flag
from star_tracker.detection.detect import detect_stars

EVERY = DetectSettings(max_stars=500)
SIGNALS = (5.0, 7.0, 10.0, 20.0, 60.0, 200.0)
FRAMES = 12


def errors_over_bound(sigma_px, seed=0, **settings):
    """Of the stars found errors (n, 2), the same over their bounds, q (n,); share found by q."""
    rng = np.random.default_rng(seed)
    errors, ratios, signals, drawn = [], [], [], []
    for frame in range(FRAMES):
        xy = spread(rng)
        signal = rng.choice(SIGNALS, len(xy))
        image = draw(xy, signal, psf_sigma_px=sigma_px, seed=frame, **settings).image
        found = detect_stars(image, EVERY)
        off, index = nearest(found, xy)
        seen = off < 2.5
        asked = SENSOR.__class__(**{**vars(SENSOR), "psf_sigma_px": sigma_px, **settings})
        bounds = np.array([
            position_bound_px(
                sigma_px, tuple(place), float(electrons_of(q, asked)), noise_e=noise_e(asked)
            ) for place, q in zip(xy[seen], signal[seen], strict=True)
        ])
        errors.append(found.xy_px[index[seen]] - xy[seen])
        ratios.append(errors[-1] / bounds)
        signals.append(signal[seen])
        drawn.append(signal)
    found_q, drawn_q = np.concatenate(signals), np.concatenate(drawn)
    share = {q: np.sum(found_q == q) / np.sum(drawn_q == q) for q in SIGNALS}
    return np.concatenate(errors), np.concatenate(ratios), found_q, share


@pytest.mark.parametrize("sigma_px", [
    pytest.param(0.6, marks=pytest.mark.slow), 1.0, pytest.param(1.6, marks=pytest.mark.slow),
])
@pytest.mark.parametrize("settings", [
    {}, {"sky_gradient": (0.8, 0.5)}, {"row_banding_e": 8.0, "column_banding_e": 4.0},
    {"bits": 8, "gain_e_per_dn": 40.0, "bias_dn": 6.0, "read_noise_e": 40.0},
], ids=["plain", "gradient", "banding", "8 bit"])
def test_errors_are_near_the_bound_and_without_bias(sigma_px, settings):
    """Isolated stars: rms within 1.15 of the bound, and what the sample's own size adds."""
    errors, ratios, signals, share = errors_over_bound(sigma_px, **settings)
    for q in SIGNALS:
        here = signals == q
        n = 2 * np.count_nonzero(here)
        if share[q] == 0:
            continue
        # The rms of n errors is known to 1 / sqrt(2 n), of which three.
        assert np.sqrt(np.mean(ratios[here] ** 2)) < 1.15 * (1 + 3 / np.sqrt(2 * n)), q
    strong = signals >= 10
    bias = errors[strong].mean(axis=0)
    spread_px = errors[strong].std(axis=0) / np.sqrt(np.count_nonzero(strong))
    assert np.all(np.abs(bias) < 0.02)
    assert np.all(np.abs(bias) < 4 * spread_px + 0.002)
    assert np.sqrt(np.mean(ratios[strong] ** 2)) < 1.15


def test_the_place_within_a_pixel_does_not_matter():
    """Undersampled stars, bright enough to tell a bias of a hundredth of a pixel."""
    rng = np.random.default_rng(1)
    errors, phases = [], []
    for frame in range(10):
        xy = spread(rng)
        found = detect_stars(draw(xy, 100.0, psf_sigma_px=0.5, seed=frame).image, EVERY)
        off, index = nearest(found, xy)
        assert np.all(off < 0.3)
        errors.append(found.xy_px[index] - xy)
        phases.append(xy % 1.0)
    errors, phases = np.concatenate(errors), np.concatenate(phases)
    for low in np.arange(0.0, 1.0, 0.2):
        here = (phases >= low) & (phases < low + 0.2)
        assert abs(errors[here].mean()) < 0.02


def test_most_stars_above_the_threshold_are_found():
    """A star of q is above 5 sigma with the probability that Gaussian noise gives it, nearly."""
    *_, share = errors_over_bound(1.0, seed=2)
    assert share[5.0] > 0.3
    assert share[7.0] > 0.85
    assert min(share[q] for q in SIGNALS if q >= 10) > 0.99


def test_noise_alone_gives_few_stars():
    rng = np.random.default_rng(3)
    for noise in (1.0, 5.0):
        image = np.rint(rng.normal(100, noise, (1000, 1000))).astype(np.uint16)
        assert len(detect_stars(image, EVERY)) <= 6


def test_saturated_stars_are_placed_by_their_wings():
    """A tenth of the stars is saturated; a clipped pixel counts for nothing, in the bound too."""
    rng = np.random.default_rng(4)
    full_well = 3000.0
    errors, bounds, flagged, false = [], [], [], 0
    for frame in range(6):
        xy = spread(rng)
        signal = np.where(np.arange(len(xy)) % 10 == 0, 4000.0, 40.0)
        image = draw(xy, signal, full_well_e=full_well, seed=frame).image
        found = detect_stars(image, EVERY)
        off, index = nearest(found, xy)
        bright = signal == 4000.0
        assert np.all(off[bright] < 0.5)
        flagged.append(found.flagged(Flag.SATURATED)[index[bright]])
        errors.append(found.xy_px[index[bright]] - xy[bright])
        bounds.append([
            position_bound_px(
                1.0, tuple(place), float(electrons_of(4000.0)), noise_e=noise_e(SENSOR),
                full_well_e=0.98 * full_well - 140,
            ) for place in xy[bright]
        ])
        false += n_false(found, xy)
    assert false <= 3 * 6  # noise may pass for a star
    errors, bounds = np.concatenate(errors), np.concatenate(bounds)
    assert np.all(np.concatenate(flagged))
    assert np.all(np.abs(errors.mean(axis=0)) < 0.02)
    assert np.sqrt(np.mean(errors**2)) < 0.1
