"""Error propagation: predicted against scattered, best triples, the optimum of table 4-1."""

import math
import time
from itertools import combinations, islice

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, spearmanr

from star_tracker.attitude.attitude import covariance
from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.error_propagation import (
    CRITERIA,
    azimuth_factor,
    best_triple,
    boresight_covariance,
    cramer_rao_covariance,
    pixel_jacobians,
    ranking,
    three_star_covariance,
    triples,
    unknown_focal_length_covariance,
    wahba_covariance,
)
from star_tracker.calibration.three_star import (
    MAX_ERROR_FACTOR,
    boresight_unknown_focal_length,
    cosines,
    error_factor,
    radii_px,
    tetrahedron_volume,
)
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import ra_dec, separation, tangent_basis
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

CAMERAS = {12: Camera.from_fov(12, 512, 512), 20: Camera.from_fov(20, 1024, 1024)}
SIGMA_PX = 0.1


class Triple:
    """Three random stars of a random field, and the scatter of their closed form."""

    def __init__(self, camera, rng):
        self.camera = camera
        self.rotation = random_rotation(rng)
        self.xy = rng.random((3, 2)) * camera.width_px
        self.stars = camera.vectors(self.xy) @ self.rotation.T
        self.a = radii_px(camera, self.xy)
        self.k = float(error_factor(self.stars))

    def noisy_radii(self, n, rng):
        noisy = self.xy + rng.normal(0, SIGMA_PX, (n, 3, 2))
        return np.hypot(*np.moveaxis(noisy - self.camera.cx_px, -1, 0))

    def scattered(self, n, rng):
        """Return boresights (n, 3) of noisy frames by the linear system."""
        k = cosines(self.noisy_radii(n, rng), self.camera.fx_px)
        m = np.linalg.solve(self.stars, k.T).T
        return m / np.linalg.norm(m, axis=1, keepdims=True)

    def covariance(self):
        return three_star_covariance(self.stars, self.a, self.camera.fx_px, SIGMA_PX)


def usable_triples(camera, n, seed):
    rng = np.random.default_rng(seed)
    every = (Triple(camera, rng) for _ in range(10 * n))
    return list(islice((t for t in every if t.k <= MAX_ERROR_FACTOR), n))


def whitened(errors, predicted):
    """Return the scatter of errors (n, d) in units of a predicted covariance (d, d)."""
    whiten = np.linalg.inv(np.linalg.cholesky(predicted))
    return whiten @ np.cov(errors.T) @ whiten.T


# Three stars


@pytest.mark.parametrize("fov_deg", [12, 20])
def test_the_covariance_of_the_closed_form_is_its_scatter(fov_deg):
    """20,000 trials: a variance scatters by 1 %, and each must be within 5 %."""
    rng = np.random.default_rng(1)
    for triple in usable_triples(CAMERAS[fov_deg], 12, 2):
        east_north = np.stack(tangent_basis(triple.rotation[:, 2]))
        errors = triple.scattered(20_000, rng) @ east_north.T
        np.testing.assert_allclose(
            whitened(errors, triple.covariance()), np.eye(2), atol=0.05
        )


def test_the_covariance_with_unknown_focal_length_is_its_scatter():
    """3000 trials: a variance scatters by 2.6 %, and each must be within 4 times that.

    Stars on a circle about a point 2 deg from the boresight, far from the turning point.
    """
    rng = np.random.default_rng(3)
    camera, rotation = CAMERAS[12], random_rotation(np.random.default_rng(4))
    azimuth = np.radians([10, 130, 245])
    xy = 256 + np.column_stack([90 + 180 * np.cos(azimuth), 180 * np.sin(azimuth)])
    stars = camera.vectors(xy) @ rotation.T
    predicted = unknown_focal_length_covariance(
        stars, rotation[:, 2], radii_px(camera, xy), camera.fx_px, SIGMA_PX
    )
    east_north = np.stack(tangent_basis(rotation[:, 2]))
    errors = []
    for _ in range(3000):
        a = radii_px(camera, xy + rng.normal(0, SIGMA_PX, (3, 2)))
        found = boresight_unknown_focal_length(stars, a, camera.fx_px)
        errors.append([*(east_north @ found.direction), found.focal_length_px])
    np.testing.assert_allclose(whitened(np.array(errors), predicted), np.eye(3), atol=0.1)


@pytest.mark.parametrize("fov_deg", [12, 20])
def test_k_and_volume_rank_triples_as_their_errors_do(fov_deg):
    """600 random triples, each with the scatter of 300 noisy frames, which is known to 4 %."""
    rng = np.random.default_rng(5)
    chosen = usable_triples(CAMERAS[fov_deg], 600, 6)
    error = [
        np.sqrt(np.mean(separation(t.scattered(300, rng), t.rotation[:, 2]) ** 2)) for t in chosen
    ]
    volume = [float(tetrahedron_volume(t.stars)) for t in chosen]
    predicted = [math.sqrt(np.trace(t.covariance())) for t in chosen]
    assert spearmanr([t.k for t in chosen], error).statistic >= 0.9
    assert spearmanr(volume, error).statistic <= -0.8
    assert spearmanr(predicted, error).statistic >= 0.99


# All triples of a field


@pytest.fixture(scope="module")
def field45():
    rng = np.random.default_rng(7)
    camera, rotation = CAMERAS[12], random_rotation(rng)
    xy = rng.random((45, 2)) * 512
    return camera.vectors(xy) @ rotation.T, radii_px(camera, xy), camera.fx_px


def test_all_triples_at_once_take_a_tenth_of_the_time_that_they_take_one_by_one(field45):
    stars, a, focal = field45

    def cpu_s(work):
        started = time.process_time()
        work()
        return time.process_time() - started

    chosen = list(combinations(range(45), 3))[:: 14190 // 200]
    one_by_one = cpu_s(lambda: [
        three_star_covariance(stars[list(t)], a[list(t)], focal, 1.0) for t in chosen
    ]) * 14190 / len(chosen)
    at_once = min(cpu_s(lambda: best_triple(triples(*field45))) for _ in range(3))
    assert at_once < 0.1 * one_by_one


def test_all_triples_are_there_with_the_values_of_each(field45):
    stars, a, focal = field45
    every = triples(stars, a, focal)
    assert every.index.shape == (45 * 44 * 43 // 6, 3)
    assert every.index.tolist() == [list(t) for t in combinations(range(45), 3)]
    for row in range(0, len(every.k), 400):
        t = every.index[row]
        p = three_star_covariance(stars[t], a[t], focal, 1.0)
        assert every.boresight_rad_per_px[row] == pytest.approx(math.sqrt(np.trace(p)), rel=1e-6)
        assert every.k[row] == pytest.approx(float(error_factor(stars[t])), rel=1e-9)
        volume = float(tetrahedron_volume(stars[t]))
        assert every.volume[row] == pytest.approx(volume, rel=1e-9)


@pytest.mark.parametrize("by", CRITERIA)
def test_the_best_triple_is_the_first_of_the_ranking(field45, by):
    every = triples(*field45)
    order = ranking(every, by=by)
    assert tuple(every.index[order[0]]) == best_triple(every, by=by)
    values = {"error": every.boresight_rad_per_px, "k": every.k, "volume": -every.volume}[by]
    assert np.all(np.diff(values[order]) >= 0)
    assert values[order[0]] == values.min()


def test_a_triple_on_a_great_circle_comes_last():
    stars = np.array([(1.0, 0, 0), (0, 1, 0), (0.6, 0.8, 0), (0, 0, 1)])
    every = triples(stars, np.full(4, 100.0), 1000.0)
    assert every.boresight_rad_per_px[0] == math.inf
    assert ranking(every)[-1] == 0
    assert ranking(every, by="k")[-1] == 0


def test_too_few_stars_and_unknown_criteria_are_refused(field45):
    stars, a, focal = field45
    with pytest.raises(ValueError, match=r"^2 stars with 2 radii: give one .* 3 to 150"):
        triples(stars[:2], a[:2], focal)
    with pytest.raises(ValueError, match=r"^5 stars with 4 radii"):
        triples(stars[:5], a[:4], focal)
    with pytest.raises(ValueError, match=r"^151 stars with 151 radii"):
        triples(np.tile(stars[0], (151, 1)), np.ones(151), focal)
    with pytest.raises(ValueError, match=r"^criterion 'size' is unknown: use error, k, volume$"):
        ranking(triples(stars[:5], a[:5], focal), by="size")


# The attitude of all stars


def field(n, fov_deg, seed):
    """Return camera, centroids (n, 2) and a rotation."""
    rng = np.random.default_rng(seed)
    return CAMERAS[fov_deg], rng.random((n, 2)) * CAMERAS[fov_deg].width_px, random_rotation(rng)


def attitude_errors(camera, xy, rotation, trials, rng):
    """Return the small rotations (trials, 3), camera axes, of Wahba's solution under noise."""
    stars = camera.vectors(xy) @ rotation.T
    found = [
        wahba(camera.vectors(xy + rng.normal(0, SIGMA_PX, xy.shape)), stars) for _ in range(trials)
    ]
    return Rotation.from_matrix(rotation.T @ np.array(found)).as_rotvec()


@pytest.mark.parametrize(("n", "fov_deg"), [(3, 12), (8, 20)])
def test_the_covariance_of_wahbas_solution_is_its_scatter(n, fov_deg):
    """10,000 trials: a variance scatters by 1.4 %, and each must be within 5 %."""
    camera, xy, rotation = field(n, fov_deg, n)
    errors = attitude_errors(camera, xy, rotation, 10_000, np.random.default_rng(8))
    predicted = wahba_covariance(camera.vectors(xy), SIGMA_PX / camera.fx_px)
    np.testing.assert_allclose(whitened(errors, predicted), np.eye(3), atol=0.05)


@pytest.mark.parametrize("n", [5, 10, 20, 40])
def test_the_attitude_reaches_the_cramer_rao_bound(n):
    """1500 trials of three axes: their mean square is known to 2.1 %, the ratio to 1 %."""
    camera, xy, rotation = field(n, 12 if n < 20 else 20, 20 + n)
    errors = attitude_errors(camera, xy, rotation, 1500, np.random.default_rng(n))
    bound = cramer_rao_covariance(camera.vectors(xy), SIGMA_PX / camera.fx_px)
    nees = np.einsum("ij,jk,ik->i", errors, np.linalg.inv(bound), errors)
    assert 0.9 < math.sqrt(np.mean(nees) / 3) < 1.1


def test_the_covariances_of_an_attitude_are_in_their_order():
    """No estimator beats the bound; the isotropic form differs by the square of the field."""
    for seed in range(10):
        camera, xy, _ = field(10, 20, seed)
        vectors, sigma = camera.vectors(xy), 1e-4
        exact = wahba_covariance(vectors, sigma)
        gap = exact - cramer_rao_covariance(vectors, sigma)
        assert np.linalg.eigvalsh(gap).min() > -1e-6 * np.trace(exact)
        np.testing.assert_allclose(
            np.diag(exact), np.diag(covariance(vectors, sigma)), rtol=0.17**2 * 3
        )


def test_pixel_jacobians_are_the_motion_of_pixels():
    camera, xy, _ = field(6, 20, 3)
    vectors, step = camera.vectors(xy), 1e-6
    for axis in range(3):
        turn = Rotation.from_rotvec(step * np.eye(3)[axis])
        # The camera turns forward, so the stars turn back in its frame.
        moved = (camera.pixels(turn.inv().apply(vectors)) - xy) / (step * camera.fx_px)
        np.testing.assert_allclose(pixel_jacobians(vectors)[:, :, axis], moved, atol=1e-5)


def test_the_boresight_of_an_attitude_scatters_along_east_and_north():
    camera, xy, rotation = field(6, 12, 5)
    rotation = rotation_from_boresight(1.0, 0.9, 0.7)
    p = wahba_covariance(camera.vectors(xy), SIGMA_PX / camera.fx_px)
    turns = np.random.default_rng(9).multivariate_normal(np.zeros(3), p, 20_000)
    ra, dec = ra_dec((rotation @ Rotation.from_rotvec(turns).as_matrix())[:, :, 2])
    errors = np.column_stack([(ra - 1.0) * math.cos(0.9), dec - 0.9])
    predicted = boresight_covariance(rotation, p)
    np.testing.assert_allclose(whitened(errors, predicted), np.eye(2), atol=0.05)


@pytest.mark.slow
def test_a_filter_can_believe_the_published_covariance():
    """Of 300 solved frames the squared error exceeds the 99 % bound of chi-square in few.

    The noise of few stars is known badly: the covariance is widened so far that the bound holds.
    Ten frames or more beyond it would be a chance of 1 in 1000; none at all would be too cautious
    a covariance, with a mean far below the 3 that it should have.
    """
    rng = np.random.default_rng(10)
    catalog, camera = StarCatalog.paper(), CAMERAS[12]
    tracker = StarTracker(
        FeatureDatabase.build(catalog), camera, SolveSettings(deadline_ms=math.inf)
    )
    nees = []
    while len(nees) < 300:
        frame = synthetic_field(
            catalog, camera, random_rotation(rng), rng, Condition(noise_px=0.5)
        )
        attitude = tracker.solve(frame.xy_px).attitude
        if attitude is None:
            continue
        error = Rotation.from_matrix(frame.rotation.T @ attitude.rotation).as_rotvec()
        nees.append(error @ np.linalg.solve(attitude.covariance_rad2, error))
    assert np.count_nonzero(np.array(nees) > chi2.ppf(0.99, 3)) < 10
    assert 1.5 < np.mean(nees) < 3.2



# Table 4-1

#: Its eight rows as printed: the azimuths of the second and third star from the first, degrees.
TABLE_4_1 = {
    (60, 120), (300, 60), (120, 60), (300, 240), (240, 300), (60, 300), (240, 120), (120, 240)
}


def azimuths():
    second, third = np.meshgrid(np.arange(360), np.arange(360), indexing="ij")
    return np.radians(np.stack([0 * second, second, third], axis=-1))


def best_azimuths(factor):
    return {tuple(map(int, row)) for row in np.argwhere(factor < factor.min() * (1 + 1e-9))}


def test_table_4_1_is_the_least_squares_optimum_over_azimuths():
    """On a grid of one degree exactly its rows are best, with an error of 2 / sqrt(3) sigma."""
    factor = azimuth_factor(azimuths())
    assert best_azimuths(factor) == TABLE_4_1
    assert factor.min() == pytest.approx(2 / math.sqrt(3))


def test_for_the_closed_form_only_the_rows_beyond_180_deg_are_best():
    factor = azimuth_factor(azimuths(), fit_norm=True)
    assert best_azimuths(factor) == {(240, 120), (120, 240)}
    assert factor.min() == pytest.approx(2 / math.sqrt(3))
    assert factor[60, 120] == pytest.approx(math.sqrt(20 / 3))


def test_the_azimuth_factor_with_free_norm_is_the_closed_form():
    """Stars at equal radii about the boresight, in a field of 4 deg: equal to 0.2 %."""
    camera = Camera.from_fov(4, 512, 512)
    for azimuth_deg in ([0, 120, 240], [0, 60, 120], [0, 60, 300], [10, 80, 200]):
        azimuth = np.radians(azimuth_deg)
        xy = 256 + 200 * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        p = three_star_covariance(camera.vectors(xy), np.full(3, 200.0), camera.fx_px, 1.0)
        error = math.sqrt(np.trace(p)) * camera.fx_px
        assert error == pytest.approx(float(azimuth_factor(azimuth, fit_norm=True)), rel=2e-3)


def test_stars_in_one_direction_have_an_infinite_factor():
    assert azimuth_factor(np.radians([10, 190, 10])) == math.inf
    assert azimuth_factor(np.radians([10, 10, 120]), fit_norm=True) == math.inf


def test_k_is_least_for_perpendicular_stars_and_not_for_those_of_table_4_1():
    """tr(R^T R) = 3 for unit vectors, so the trace of its inverse is least for R^T R = I."""
    rng = np.random.default_rng(11)
    some = rng.normal(size=(5000, 3, 3))
    some /= np.linalg.norm(some, axis=-1, keepdims=True)
    assert error_factor(some).min() >= math.sqrt(1.5)
    turned = random_rotation(rng)
    assert error_factor(turned) == pytest.approx(math.sqrt(1.5))
    # Separations of 60, 60 and 120 deg lie on one great circle.
    angle = np.radians([0, 60, 120])
    in_plane = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    assert error_factor(in_plane) > 1e15
