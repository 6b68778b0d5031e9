"""What solved frames teach of the centroids: noise and false stars, and how it fades."""

from types import SimpleNamespace

import numpy as np
import pytest

from star_tracker.calibration.noise import StreamNoise
from star_tracker.solution import Status


def solved(sigma_px, rng, *, stars=5, false_stars=0, fitted=False):
    """A solved frame whose residuals have a noise, as far as it is looked at."""
    freedom = 2 * stars - (4 if fitted else 3)
    state = np.zeros(stars + false_stars, np.uint8)
    state[:stars] = 1
    return SimpleNamespace(
        status=Status.SOLVED, n_ignored=0, n_surplus=0,
        focal_length_error=1e-3 if fitted else 0.0,
        rms_px=sigma_px * np.sqrt(rng.chisquare(freedom) / stars),
        identification=SimpleNamespace(state=state, identified=np.flatnonzero(state)),
    )


UNSOLVED = SimpleNamespace(status=Status.NO_MATCH)


def after(*streams, told_px=0.0, seed=0):
    """What is known after so many frames of each kind: (n, sigma, options)."""
    rng, noise = np.random.default_rng(seed), StreamNoise(told_px)
    for n, sigma_px, options in streams:
        for _ in range(n):
            noise.add(solved(sigma_px, rng, **options))
    return noise


@pytest.mark.parametrize("fitted", [False, True])
@pytest.mark.parametrize("sigma_px", [0.05, 0.3, 3.0])
def test_noise_and_share_of_false_stars_come_out(sigma_px, fitted):
    noise = after((200, sigma_px, {"stars": 6, "false_stars": 2, "fitted": fitted}))
    # 100 degrees of freedom tell a standard deviation to 7 %.
    assert noise.sigma_px == pytest.approx(sigma_px, rel=4 * 0.07)
    assert noise.false_share == pytest.approx(0.25)
    expected = noise.expectation
    assert expected.sigma_px == noise.sigma_px
    assert expected.freedom == 20
    assert expected.stars == pytest.approx(7.5)
    assert expected.false_stars == pytest.approx(2.5)


def test_few_frames_teach_nothing():
    noise = after((2, 0.3, {"stars": 20}))
    assert (noise.sigma_px, noise.false_share, noise.expectation) == (None, None, None)
    assert after((3, 0.3, {"stars": 20})).expectation is not None
    assert after((3, 0.3, {"stars": 3})).expectation is None  # of 3 degrees of freedom each


def test_no_share_is_certain_and_no_noise_is_none():
    noise = after((50, 0.0, {"stars": 8}))
    assert noise.sigma_px == 0.02
    assert noise.expectation.false_stars == 0.5
    assert after((50, 50.0, {"stars": 8})).sigma_px == 10.0


def test_a_single_odd_frame_teaches_nothing_and_what_is_known_rests_for_one_frame():
    noise, rng = after((30, 0.3, {})), np.random.default_rng(9)
    before = noise.expectation
    noise.add(solved(3.0, rng))
    assert noise.expectation is None
    assert noise.sigma_px == before.sigma_px
    noise.add(solved(0.3, rng))
    assert noise.expectation.sigma_px == pytest.approx(before.sigma_px, rel=0.2)


def test_two_odd_frames_in_a_row_are_a_change():
    noise = after((30, 0.3, {}), (2, 3.0, {"stars": 10}))
    assert noise.n_frames == 1
    assert noise.expectation is None
    noise = after((30, 0.3, {}), (12, 3.0, {}))
    assert noise.sigma_px == pytest.approx(3.0, rel=4 * 0.09)


def test_a_noise_that_falls_is_followed_by_forgetting():
    noise = after((60, 0.9, {}), (60, 0.3, {}))
    assert noise.sigma_px == pytest.approx(0.3, rel=4 * 0.07)


def test_ten_times_as_many_false_stars_are_believed_after_some_frames():
    noise = after((100, 0.3, {"stars": 10, "false_stars": 2}))
    rng = np.random.default_rng(1)
    for _ in range(5):
        noise.add(solved(0.3, rng, stars=10, false_stars=20))
    assert noise.false_share > 0.45


def test_unsolved_frames_teach_nothing_and_many_of_them_end_it():
    noise = after((30, 0.3, {}))
    for _ in range(49):
        noise.add(UNSOLVED)
    assert noise.expectation is not None
    noise.add(UNSOLVED)
    assert (noise.sigma_px, noise.expectation, noise.n_frames) == (None, None, 0)


def test_a_told_noise_is_taken_at_its_word():
    assert StreamNoise(0.5).sigma_px == 0.5
    assert StreamNoise(0.5).expectation is None  # nothing is known of the share yet
    noise = after((30, 0.3, {"false_stars": 5}), told_px=0.5)
    assert noise.expectation.sigma_px == 0.5
    assert noise.expectation.freedom == 20
    assert noise.false_share == pytest.approx(0.5)
    assert after((30, 5.0, {}), told_px=0.5).expectation is not None  # however wrong it is


def test_it_begins_anew():
    noise = after((30, 0.3, {}))
    noise.forget()
    assert (noise.sigma_px, noise.false_share, noise.expectation) == (None, None, None)
