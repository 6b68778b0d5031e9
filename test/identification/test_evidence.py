"""The Bayes factor of a pose: against direct integration, and what chance makes of it."""

import math
from functools import cache

import numpy as np
import pytest
from engines import CAMERA, Bench, catalog_of, database_at, of_brightness, random_sky
from scipy.integrate import quad
from scipy.special import comb
from scipy.stats import betabinom, chi2, f, invgamma, norm

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.evidence import (
    EXACT,
    ScalePrior,
    evidence,
    scale_prior,
    variance,
)
from star_tracker.identification.stream import EXPECTED, Expectation, expect
from star_tracker.maps.simulation import uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

OBLONG = Camera(800, 300, 900.0, 1100.0, 400, 150)
#: Any of a range of focal lengths, of which a part is looked at; and one told with 4 %.
UNTOLD = ScalePrior(-0.2, 0.3, 1.7, told=False, sigma=math.inf)
TOLD = scale_prior(4.0)


def by_integration(
    camera, vectors, residual2, n, m, *, sigma_px=0.7, freedom=1.0, scale=1.0, prior=EXACT,
    free=False,
):
    """Log10 of B for all of the matches, sigma^2 integrated numerically.

    The pose's part is the Gaussian integral over three angles in a uniform density over all
    rotations, 1 / (8 pi^2); that of the matches a density over the image of area A. Where the
    scale is free its logarithm is a fourth dimension, of a density 1 / log_range; where the
    camera's own is told with a tolerance, each of the two has half of the belief.
    """
    k, s = len(residual2), float(np.sum(residual2))
    information = information_of(vectors)
    if not free:
        information = information[:3, :3]
    area = camera.width_px * camera.height_px
    focal = math.sqrt(camera.fx_px * camera.fy_px) * scale
    noise = invgamma(freedom / 2, scale=freedom * sigma_px**2 / 2)
    density_of_scale = 1 / prior.log_range if free else 1.0
    share = 0.5 if prior.told and prior.log_range > 0 else 1.0

    of_one = np.linalg.slogdet(np.linalg.inv(information))[1]  # of the noise 1 rad

    def log_given(variance):
        """Natural log of everything that depends on the noise."""
        density = k * (math.log(area) - math.log(2 * math.pi * variance)) - s / (2 * variance)
        scatter = of_one + len(information) * math.log(2 * math.pi * variance / focal**2)
        pose = 0.5 * scatter - math.log(8 * math.pi**2)
        return density + pose + noise.logpdf(variance) + math.log(variance)

    grid = np.linspace(-20, 15, 700)
    values = np.array([log_given(math.exp(t)) for t in grid])
    top, peak = grid[np.argmax(values)], np.max(values)
    integral = quad(
        lambda t: math.exp(log_given(math.exp(t)) - peak), top - 12, top + 12, points=[top],
        epsabs=0, epsrel=1e-9, limit=200,
    )[0]
    # (n - k)! / n! k! (m - k)! / m! is 1 / (ways to choose k of m, k of n, and to pair them).
    ways = comb(n, k, exact=True) * comb(m, k, exact=True) * math.factorial(k)
    log_b = peak + math.log(integral) - math.log(ways) - math.log(min(n, m) + 1)
    return (log_b + math.log(density_of_scale * share)) / math.log(10)


def information_of(vectors):
    """J^T J for three angles and log f: how the directions (k, 3) move with them."""
    rows = []
    for x, y, z in vectors:
        turn = -np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])  # w x b = -b x w
        towards_axis = np.array([x, y, z]) * (1 - z * z) - (x, y, 0)
        rows.append(np.column_stack([turn, towards_axis]))
    jacobian = np.concatenate(rows)
    return jacobian.T @ jacobian


def points(camera, n, seed):
    rng = np.random.default_rng(seed)
    return rng.random((n, 2)) * (camera.width_px, camera.height_px)


@cache
def bench_of(camera, sigma_px=0.0, prior=EXACT):
    """Where only the frame and the matches listed by hand count, not the guide stars."""
    places = points(camera, 5, 1)
    return Bench(database_at(places, camera), camera, sigma_px=sigma_px, prior=prior)


def chosen(camera, xy, residual2, m, sigma_px=0.0):
    """The number of matches that carry most evidence and its log10; rows 0, 1, ... match."""
    bench = bench_of(camera, sigma_px)
    bench.show(xy)
    return bench.weigh(range(len(residual2)), residual2, m)


# The formula


@pytest.mark.parametrize("camera", [
    pytest.param(CAMERA, id="square", marks=pytest.mark.slow), pytest.param(OBLONG, id="oblong"),
])
@pytest.mark.parametrize(
    ("known_px", "prior"),
    [
        (0.0, {"sigma_px": 0.7, "freedom": 1.0}), (0.2, {"sigma_px": 0.2, "freedom": 20.0}),
        (3.0, {"sigma_px": 3.0, "freedom": 20.0}),
    ],
    ids=["unknown", "0.2 px", "3 px"],
)
@pytest.mark.parametrize(
    "size", [(3, 3, 3), (4, 10, 3), (10, 4, 4), (25, 30, 12), (60, 200, 41)]
)
def test_evidence_is_the_integral_over_pose_and_noise(camera, known_px, prior, size):
    n, m, k = size
    xy = points(camera, n, n)
    vectors = camera.vectors(xy)
    residual2 = np.full(k, 0.3 if known_px == 0 else known_px**2)
    number, score = chosen(camera, xy, residual2, m, known_px)
    expected = {
        j: by_integration(camera, vectors[:j], residual2[:j], n, m, **prior)
        for j in {3, (3 + k) // 2, k, number}
    }
    assert score == pytest.approx(expected[number], abs=1e-6)
    assert score >= max(expected.values()) - 1e-6


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]
)
def test_as_many_matches_are_taken_as_carry_most_evidence(seed):
    """Some good ones and some that are off by many pixels."""
    rng = np.random.default_rng(seed)
    xy = points(CAMERA, 20, seed)
    vectors = CAMERA.vectors(xy)
    good = int(rng.integers(3, 8))
    residual2 = np.sort(np.concatenate([rng.random(good), rng.uniform(500, 5000, 4)]))
    k, score = chosen(CAMERA, xy, residual2, 25)
    expected = [
        by_integration(CAMERA, vectors[:j], residual2[:j], 20, 25)
        for j in range(3, good + 5)
    ]
    assert k == 3 + np.argmax(expected)
    assert score == pytest.approx(max(expected), abs=1e-6)
    assert k <= good or good < 5


@pytest.mark.parametrize("prior", [UNTOLD, TOLD], ids=["not told", "4 %"])
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("size", [(3, 3, 3), (10, 4, 4), (25, 30, 12)])
def test_evidence_where_the_scale_is_not_known_is_the_integral_over_it_too(prior, free, size):
    """A pose by separation has the camera's own scale; one by shape has any, which is charged."""
    if prior is UNTOLD and not free:
        return  # no such pose is ever tried
    n, m, k = size
    xy, scale = points(OBLONG, n, n), 1.04 if free else 1.0
    bench = bench_of(OBLONG, 0.0, prior)
    bench.show(xy)
    residual2 = np.full(k, 0.3)
    number, score = bench.weigh(range(k), residual2, m, scale=scale, free=free)
    vectors = OBLONG.scaled(scale).vectors(xy)
    expected = {
        j: by_integration(
            OBLONG, vectors[:j], residual2[:j], n, m, scale=scale, prior=prior, free=free
        )
        for j in {3, k, number}
    }
    assert score == pytest.approx(expected[number], abs=1e-6)
    assert score >= max(expected.values()) - 1e-6


def test_a_scale_that_is_searched_for_costs_evidence():
    """Ten times the range of focal lengths costs one decade."""
    xy, scores = points(CAMERA, 12, 7), []
    for log_range in (0.2, 2.0):
        prior = ScalePrior(-0.1, 0.1, log_range, told=False, sigma=math.inf)
        bench = bench_of(CAMERA, 0.0, prior)
        bench.show(xy)
        scores.append(bench.weigh(range(8), [0.1] * 8, 12, free=True)[1])
    assert scores[0] - scores[1] == pytest.approx(1.0, abs=1e-9)


def test_evidence_of_perfect_matches_has_a_bound_from_the_typical_noise():
    """S = 0 is no certainty: sigma is as likely as anything to be larger."""
    xy = points(CAMERA, 4, 1)
    perfect, good = (chosen(CAMERA, xy, [r] * 4, 4)[1] for r in (0.0, 0.01))
    assert good < perfect < good + 0.5
    assert math.isfinite(perfect)


def test_evidence_grows_with_matches_and_falls_with_residuals_and_with_false_stars():
    xy = points(CAMERA, 30, 2)

    def score(k, n, m, residual_px):
        return chosen(CAMERA, xy[:n], [residual_px**2] * k, m)[1]

    by_matches = [score(k, 12, 12, 0.5) for k in range(3, 13)]
    assert np.all(np.diff(by_matches) > 0)
    by_residual = [score(6, 12, 12, r) for r in (0.0, 0.3, 1.0, 3.0, 10.0)]
    assert np.all(np.diff(by_residual) < 0)
    by_false = [score(6, n, 12, 0.5) for n in (6, 8, 12, 20, 30)]
    assert np.all(np.diff(by_false) < 0)
    by_missing = [score(6, 12, m, 0.5) for m in (6, 8, 12, 50, 300)]
    assert np.all(np.diff(by_missing) < 0)


def test_stars_on_a_wide_base_say_less_than_a_cluster_because_they_fit_fewer_poses():
    """det M is larger by the square of the ratio of the spreads: half of its log10."""
    small = np.array([(250.0, 250), (262, 250), (250, 262), (262, 262)])
    wide = 256 + 12 * (small - 256)
    results = [chosen(CAMERA, xy, [0.1] * 4, 4)[1] for xy in (small, wide)]
    assert results[0] - results[1] == pytest.approx(math.log10(12), abs=0.02)


def test_known_noise_makes_the_residuals_that_belong_to_it_stronger():
    xy = points(CAMERA, 5, 3)
    small = [0.05**2] * 5
    assert chosen(CAMERA, xy, small, 5, 0.05)[1] > chosen(CAMERA, xy, small, 5)[1]
    # And those that do not belong to it far weaker.
    large = [3.0**2] * 5
    assert chosen(CAMERA, xy, large, 5, 0.05)[1] < chosen(CAMERA, xy, large, 5)[1] - 3


def test_more_matches_than_guide_stars_inside_are_possible_at_the_border():
    """A guide star just outside may match a centroid just inside: m is not less than k."""
    xy = points(CAMERA, 6, 4)
    outside, inside = (chosen(CAMERA, xy, [0.2] * 5, m) for m in (3, 5))
    assert outside == inside


# What earlier frames teach


@pytest.mark.parametrize("prior", [EXACT, UNTOLD], ids=["exact", "free"])
@pytest.mark.parametrize("size", [(3, 3, 3), (4, 10, 4), (10, 4, 4), (25, 30, 12)])
@pytest.mark.parametrize("what", [
    (0.2, 20.0, 9.5, 0.5), pytest.param((1.5, 7.0, 2.0, 8.0), marks=pytest.mark.slow),
])
def test_a_stream_is_believed_as_much_as_a_lone_frame(what, size, prior):
    """Half each: the noise of many residuals, and the beta-binomial probability of k of n."""
    (n, m, k), (sigma_px, freedom, stars, false_stars) = size, what
    xy, free = points(CAMERA, n, n), prior is UNTOLD
    residual2 = np.full(k, 0.3)
    bench = Bench(database_at(points(CAMERA, 5, 1)), prior=prior)
    expect(Expectation(*what), bench.expected)
    bench.show(xy)
    number, score = bench.weigh(range(k), residual2, m, free=free)

    def of(j, **noise):
        vectors = CAMERA.vectors(xy)[:j]
        return by_integration(
            CAMERA, vectors, residual2[:j], n, m, prior=prior, free=free, **noise
        )

    for j in {3, k, number}:
        share = (min(n, m) + 1) * betabinom.pmf(j, n, stars, false_stars)
        stream = 10 ** of(j, sigma_px=sigma_px, freedom=freedom) * share
        both = math.log10(0.5 * 10 ** of(j) + 0.5 * stream)
        assert score == pytest.approx(both, abs=1e-6) if j == number else score >= both - 1e-6


def test_a_frame_unlike_those_before_it_loses_half_of_its_evidence():
    xy, residual2 = points(CAMERA, 40, 3), [9.0] * 8
    alone = chosen(CAMERA, xy, residual2, 15)
    bench = Bench(database_at(points(CAMERA, 5, 1)))
    expect(Expectation(0.05, 20.0, 9.5, 0.5), bench.expected)
    bench.show(xy)
    assert bench.weigh(range(8), residual2, 15) == (
        alone[0], pytest.approx(alone[1] - math.log10(2), abs=1e-3)
    )
    expect(None, bench.expected)
    assert bench.weigh(range(8), residual2, 15) == alone


def test_factorials():
    np.testing.assert_allclose(np.exp(evidence(6, 0.0).log_factorial), [1, 1, 2, 6, 24, 120, 720])


# What is known of the focal length


def test_a_focal_length_without_tolerance_is_exact():
    assert scale_prior(0.0) == EXACT
    assert (EXACT.low, EXACT.high, EXACT.log_range, EXACT.sigma) == (0, 0, 0, 0)
    assert EXACT.told


@pytest.mark.parametrize("tolerance_percent", [0.5, 5.0, 30.0])
def test_a_tolerance_is_one_standard_deviation_and_a_tenth_more_is_searched(tolerance_percent):
    prior = scale_prior(tolerance_percent)
    assert math.exp(prior.sigma) == pytest.approx(1 + tolerance_percent / 100)
    assert math.exp(prior.high) == pytest.approx(1 + 1.1 * tolerance_percent / 100)
    assert prior.low == -prior.high
    assert prior.log_range == pytest.approx(prior.high - prior.low)
    assert prior.told


# The variance to be believed


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("k", [4, 6, 20, 150])
def test_a_variance_joins_what_was_told_with_the_residuals(k, free):
    """Gelman et al. (2013), 2.6: (nu s0^2 + S) / (nu + degrees of freedom), and widened."""
    known, sum2 = evidence(100, 0.2), 3.7
    degrees = 20 + 2 * k - (4 if free else 3)
    expected = (20 * 0.2**2 + sum2) / degrees
    widening = 3 * f.ppf(0.99, 3, degrees) / chi2.ppf(0.99, 3)
    assert variance(known, sum2, k, free) == pytest.approx(widening * expected, rel=1e-9)


@pytest.mark.parametrize("k", [4, 5, 8, 20, 100])
def test_a_variance_of_few_residuals_is_widened_as_students_distribution_asks(k):
    """Three angles: their error in units of a variance of d degrees is 3 F(3, d).

    So often as a chi-square of 3 stays below its 99 % bound, 3 F(3, d) stays below that of F.
    """
    unknown, sum2, degrees = evidence(100, 0.0), 3.7, 2 * k - 3
    plain = sum2 / degrees
    widening = 3 * f.ppf(0.99, 3, degrees) / chi2.ppf(0.99, 3)
    assert variance(unknown, sum2, k, False) == pytest.approx(widening * plain, rel=1e-9)


@pytest.mark.parametrize("k", [4, 6, 20])
def test_a_variance_joins_what_a_stream_taught_unless_the_residuals_are_too_large(k):
    degrees, expected = 2 * k - 3, np.zeros(1, EXPECTED)
    expect(Expectation(0.2, 15.0, 9.0, 1.0), expected)
    known, alone = evidence(100, 0.0, expected), evidence(100, 0.0)
    bound = 0.2**2 * chi2.ppf(0.99, degrees)
    widening = 3 * f.ppf(0.99, 3, degrees + 15) / chi2.ppf(0.99, 3)
    for sum2 in (0.0, 0.5 * bound, 0.97 * bound):
        joined = (15 * 0.2**2 + sum2) / (degrees + 15)
        assert variance(known, sum2, k, False) == pytest.approx(widening * joined, rel=1e-9)
    sum2 = 1.03 * bound
    assert variance(known, sum2, k, False) == variance(alone, sum2, k, False)


def test_the_widening_falls_to_one():
    widening = evidence(10, 0.0).widening
    assert np.all(np.diff(widening[1:]) < 0)
    assert 1 < widening[-1] < 1.02
    # More degrees of freedom than the table has are those of its end.
    assert variance(evidence(10, 0.0), 1e6, 5000, False) == pytest.approx(
        widening[-1] * 1e6 / 9997, rel=1e-12
    )


@pytest.mark.parametrize("sigma_px", [0.03, 0.7, 5.0])
@pytest.mark.parametrize("k", [4, 5, 8])
def test_the_bound_of_a_widened_variance_holds_as_often_as_it_says(sigma_px, k):
    """Errors of three angles and residuals of k stars, 20,000 times, whatever the noise."""
    rng, trials = np.random.default_rng(3), 20_000
    known = evidence(10, 0.0)
    sum2 = sigma_px**2 * rng.chisquare(2 * k - 3, trials)
    error2 = sigma_px**2 * rng.chisquare(3, trials)
    believed = np.array([variance(known, s, k, False) for s in sum2])
    beyond = np.mean(error2 / believed > chi2.ppf(0.99, 3))
    assert beyond == pytest.approx(0.01, abs=4 * 0.0007)


@pytest.mark.parametrize(("sigma_px", "k"), [(0.001, 50), (0.0, 100_000)])
def test_no_variance_is_below_a_hundredth_of_a_pixel(sigma_px, k):
    assert variance(evidence(10, sigma_px), 0.0, k, False) == pytest.approx(1e-4, rel=1e-12)


# Chance


@pytest.mark.parametrize(
    ("n_stars", "n_centroids", "n_frames"),
    [(120, 6, 600), (400, 8, 300), pytest.param(900, 20, 150, marks=pytest.mark.slow)],
)
def test_unrelated_frames_seldom_look_like_the_sky(n_stars, n_centroids, n_frames):
    """Markov's inequality: evidence above x in at most one unrelated frame of x.

    The best of all poses on the sky counts, and three standard deviations of luck are allowed.
    """
    rng = np.random.default_rng(n_centroids)
    catalog = catalog_of(random_sky(n_stars, n_centroids))
    camera = Camera.from_fov(20, 512, 512)
    settings = SolveSettings(
        "match_group", MatchGroupSettings(quick=False), max_log10_false_alarms=0.0,
        deadline_ms=math.inf,
    )
    database = FeatureDatabase.build(catalog, max_separation_deg=20)
    tracker = StarTracker(database, camera, settings)
    frames = [uniform_noise(camera, n_centroids, rng) for _ in range(n_frames)]
    decades = np.array([-tracker.solve(xy).log10_false_alarms for xy in frames])
    for decade in (0.5, 1.0, 2.0, 3.0):
        chance = 10.0**-decade
        bound = chance * n_frames + 3 * math.sqrt(chance * n_frames)
        assert np.count_nonzero(decades > decade) <= bound


# Brightness


def sky_of(n, seed):
    """V magnitudes of a sky, instrumental ones of a frame that shows all of it."""
    rng = np.random.default_rng(seed)
    v_mag = rng.uniform(1, 6, n)
    return v_mag, v_mag - 11.3 + rng.normal(0, 0.2, n), rng


def gain(magnitude, v_mag, catalog=None):
    k = len(v_mag)
    pairs = np.arange(k) if catalog is None else catalog
    return of_brightness(magnitude, v_mag, np.arange(k), pairs, k)


def by_formula(magnitude, difference):
    """For each match a mixture of its own magnitude and any of the frame's; half trusted."""
    known = difference[np.isfinite(difference)]
    frame = magnitude[np.isfinite(magnitude)]
    spread = max(np.std(frame), 0.3)
    zero = np.median(known)
    stars = frame[: len(known)]
    own, normal = norm.pdf(known - zero, scale=0.3), norm.pdf(stars, frame.mean(), spread)
    # Any of the frame's: half by their normal distribution, half as they are, in boxes of the area
    # of a star's own scatter.
    box = 0.3 * math.sqrt(2 * math.pi)
    alike = np.abs(stars[:, None] - frame) < box / 2
    other = 0.5 * (normal + alike.mean(axis=1) / box)
    ratio = np.prod(0.9 * own / other + 0.1)
    # The zero point: uniform over 3 magnitudes, known to 0.3 / sqrt(n).
    occam = 0.3 * math.sqrt(2 * math.pi / len(known)) / 3.0
    return math.log10(0.5 * ratio * occam + 0.5)


@pytest.mark.parametrize("n", [3, 4, 8, 30])
def test_brightness_agrees_with_the_formula(n):
    for seed in range(20):
        v_mag, magnitude, rng = sky_of(n, seed)
        assert gain(magnitude, v_mag) == pytest.approx(
            by_formula(magnitude, magnitude - v_mag), abs=1e-9
        )
        other = rng.permutation(n)
        assert gain(magnitude, v_mag, other) == pytest.approx(
            by_formula(magnitude, magnitude - v_mag[other]), abs=1e-9
        )


def test_true_magnitudes_raise_the_evidence():
    for seed in range(50):
        v_mag, magnitude, _ = sky_of(10, seed)
        # Each of ten stars is known to 0.3 mag out of a standard deviation of 1.4.
        assert gain(magnitude, v_mag) > 1
    gains = [gain(*reversed(sky_of(n, 1)[:2])) for n in (4, 8, 16, 32)]
    assert gains == sorted(gains)


@pytest.mark.parametrize("kind", ["permuted", "random", "wild", "constant", "outlier"])
def test_garbage_costs_no_more_than_half(kind):
    for seed in range(200):
        v_mag, magnitude, rng = sky_of(3 + seed % 20, seed)
        made = {
            "permuted": rng.permutation(magnitude),
            "random": rng.normal(0, 1, len(magnitude)),
            "wild": rng.normal(0, 1e3, len(magnitude)),
            "constant": np.full(len(magnitude), -7.0),
            "outlier": magnitude + 30 * (np.arange(len(magnitude)) == 1),
        }[kind]
        found = gain(made, v_mag)
        assert math.isfinite(found)
        assert found >= math.log10(0.5) - 1e-9


@pytest.mark.parametrize("n", [4, 8, 20])
def test_garbage_seldom_helps(n):
    """Unrelated magnitudes: x times the evidence in no more than one frame of x."""
    rng = np.random.default_rng(n)
    gains = np.array([
        gain(rng.uniform(-10, -5, n), rng.uniform(1, 6, n)) for _ in range(4000)
    ])
    for decade in (0.5, 1.0, 2.0):
        assert np.mean(gains > decade) <= 10.0**-decade
    assert np.mean(10.0**gains) < 1.5


def test_unknown_magnitudes_are_ignored():
    v_mag, magnitude, _ = sky_of(12, 3)
    holes = magnitude.copy()
    holes[[1, 5, 6]] = np.nan
    left = np.flatnonzero(np.isfinite(holes))
    without = of_brightness(magnitude[left], v_mag, np.arange(9), left, 9)
    assert gain(holes, v_mag) == pytest.approx(without, abs=1e-12)
    # A guide star without a magnitude too; its centroid still counts among those of the frame.
    v_mag[2] = np.nan
    assert math.isfinite(gain(holes, v_mag))
    assert gain(holes, v_mag) < without


@pytest.mark.parametrize("known", [0, 1, 2])
def test_fewer_than_three_known_magnitudes_say_nothing(known):
    v_mag, magnitude, _ = sky_of(6, 4)
    magnitude[known:] = np.nan
    assert gain(magnitude, v_mag) == 0


def test_the_zero_point_does_not_matter():
    v_mag, magnitude, _ = sky_of(9, 5)
    assert gain(magnitude + 17.0, v_mag) == pytest.approx(gain(magnitude, v_mag), abs=1e-9)


def test_only_the_matches_that_count_are_looked_at():
    v_mag, magnitude, _ = sky_of(9, 6)
    magnitude[6:] = magnitude[:3]
    catalog = np.arange(9)
    first = of_brightness(magnitude, v_mag, np.arange(9), catalog, 6)
    catalog[6:] = 0
    assert of_brightness(magnitude, v_mag, np.arange(9), catalog, 6) == first


@pytest.mark.parametrize(
    "n", [1000, 2000, 10_000],
)
def test_one_star_far_brighter_than_all_others_is_as_rare_as_one_in_all(n):
    magnitude = np.zeros(n)
    magnitude[0] = -15.0
    found = of_brightness(magnitude, np.array([-15.0, 0, 0]), np.arange(3), np.arange(3), 3)
    # Twice that for the star; the two others are like all.
    assert 0 < found < math.log10(2 * n)
