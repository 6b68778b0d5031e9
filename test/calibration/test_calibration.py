"""Joint least squares of attitude and camera: accuracy, stated errors, choice of terms."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, f, kstest, t

from star_tracker.calibration.lens import SIGNIFICANCE, calibrate
from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

SIZE_PX = {12: 512, 20: 1024}


def camera_of(fov_deg, **changes):
    size = SIZE_PX[fov_deg]
    return replace(Camera.from_fov(fov_deg, size, size), **changes)


def radial(k1, k2=0.0):
    return Distortion("plumb_bob", (k1, k2, 0.0, 0.0, 0.0))


def fits(catalog, camera, start, n, *, seed, noise_px, terms=None):
    """Return fits of n random fields of 5 stars or more, and the true rotations."""
    rng = np.random.default_rng(seed)
    result = []
    while len(result) < n:
        frame = synthetic_field(
            catalog, camera, random_rotation(rng), rng, Condition(noise_px=noise_px)
        )
        if len(frame.xy_px) >= 5:
            stars = catalog.vectors[frame.catalog_index]
            result.append((calibrate(start, frame.xy_px, stars, terms=terms), frame.rotation))
    return result


@pytest.fixture(scope="module", params=[pytest.param(12, marks=pytest.mark.slow), 20])
def noisy(request, catalog):
    """150 fields at 1 px, from a focal length 3 % off: (field of view, camera, fits)."""
    camera = camera_of(request.param)
    start = replace(camera, fx_px=0.97 * camera.fx_px, fy_px=0.97 * camera.fy_px)
    return request.param, camera, fits(catalog, camera, start, 150, seed=1, noise_px=1.0)


def test_the_focal_length_is_as_good_as_it_can_be(noisy):
    """1 px: 0.13 % at 12 deg with some 15 stars, 0.04 % at 20 deg with some 41."""
    fov_deg, camera, found = noisy
    relative = [fit.values[0] / camera.fx_px - 1 for fit, _ in found]
    assert math.sqrt(np.mean(np.square(relative))) <= {12: 0.0015, 20: 0.0005}[fov_deg]


def test_the_focal_length_agrees_with_its_standard_error(noisy):
    """Each is Student's t with the fit's degrees of freedom: carried over to 0..1, uniform."""
    _, camera, found = noisy
    quantile = [
        t.cdf((fit.values[0] - camera.fx_px) / fit.standard_errors[0], fit.degrees_of_freedom)
        for fit, _ in found
    ]
    assert kstest(quantile, "uniform").pvalue > 0.05


def test_the_attitude_agrees_with_its_covariance(noisy):
    """NEES / 3 is F(3, free); carried over to chi-square, the sum is within its 95 %."""
    _, _, found = noisy
    nees = []
    for fit, rotation in found:
        error = Rotation.from_matrix(rotation.T @ fit.attitude.rotation).as_rotvec()
        value = error @ np.linalg.solve(fit.attitude.covariance_rad2, error)
        nees.append(chi2.ppf(f.cdf(value / 3, 3, fit.degrees_of_freedom), 3))
    assert chi2.ppf(0.025, 3 * len(nees)) < np.sum(nees) < chi2.ppf(0.975, 3 * len(nees))


def test_the_noise_is_found(noisy):
    """sigma^2 from `free` residuals scatters by sqrt(2 / free); together by much less."""
    _, _, found = noisy
    free = sum(fit.degrees_of_freedom for fit, _ in found)
    pooled = sum(fit.sigma_px**2 * fit.degrees_of_freedom for fit, _ in found) / free
    assert pooled == pytest.approx(1.0, abs=3 * math.sqrt(2 / free))


def test_terms_that_are_not_there_are_left_out(noisy):
    """Of 150 fits with two trials each 0.3 are expected to take a term by chance."""
    _, _, found = noisy
    assert sum(fit.terms != () for fit, _ in found) <= 2
    assert SIGNIFICANCE == 0.001


@pytest.mark.parametrize("number", range(1, 9))
def test_the_maps_give_their_focal_length(catalog, number):
    """Rounding to 0.01 px is the only error, its standard deviation 0.0029 px."""
    (star_map,) = paper_maps((number,))
    known = (star_map.star_number > 0) & (star_map.displaced_px == 0)
    stars = catalog.vectors[star_map.star_number[known] - 1]
    fit = calibrate(star_map.camera, star_map.xy_px[known], stars)
    assert fit.terms == ()
    assert fit.names == ("focal_length_px",)
    error = fit.values[0] - star_map.camera.focal_length_px
    assert abs(error) < t.ppf(0.9995, fit.degrees_of_freedom) * fit.standard_errors[0]
    assert fit.values[0] == pytest.approx(star_map.camera.focal_length_px, rel=5e-5)
    assert fit.degrees_of_freedom == 2 * known.sum() - 4
    assert fit.residuals_px.shape == (known.sum(), 2)
    # The largest rounding error along each axis, and what the fit takes from others.
    assert np.abs(fit.residuals_px).max() < 0.01
    assert fit.camera.focal_length_px == pytest.approx(fit.values[0], rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "noise_px", "terms"),
    [
        ({"distortion": radial(0.3)}, 0.1, ("k1",)),
        ({"distortion": radial(0.3, 2.0)}, 0.02, ("k1", "k2")),
        ({"cx_px": 532.0, "cy_px": 500.0}, 0.1, ("principal_point",)),
        ({"cx_px": 522.0, "distortion": radial(-0.2)}, 0.02, ("principal_point", "k1")),
    ],
    ids=["k1", "k1 and k2", "principal point", "principal point and k1"],
)
def test_terms_that_the_data_support_are_found(catalog, changes, noise_px, terms):
    """Each effect is far above noise: 15 fields, of which one may take one term too many."""
    camera = camera_of(20, **changes)
    found = fits(catalog, camera, camera_of(20), 15, seed=2, noise_px=noise_px)
    assert Counter(fit.terms for fit, _ in found)[terms] >= 14
    truth = {
        "focal_length_px": camera.fx_px, "cx_px": camera.cx_px, "cy_px": camera.cy_px,
        "k1": camera.distortion.coefficients[0] if camera.distortion else 0.0,
        "k2": camera.distortion.coefficients[1] if camera.distortion else 0.0,
    }
    for fit, _ in found:
        for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True):
            assert abs(value - truth[name]) < 5 * error


def test_the_fitted_camera_predicts_the_centroids(catalog):
    camera = camera_of(20, cx_px=520.0, distortion=radial(0.3))
    rng = np.random.default_rng(3)
    frame = synthetic_field(catalog, camera, random_rotation(rng), rng, Condition(noise_px=0.02))
    stars = catalog.vectors[frame.catalog_index]
    fit = calibrate(camera_of(20), frame.xy_px, stars)
    predicted = fit.camera.pixels(stars @ fit.attitude.rotation)
    np.testing.assert_allclose(predicted + fit.residuals_px, frame.xy_px, atol=1e-9)
    assert fit.camera.distortion.coefficients[0] == fit.values[fit.names.index("k1")]
    assert fit.covariance.shape == (3 + len(fit.values),) * 2


def test_a_known_distortion_and_the_ratio_of_the_focal_lengths_are_kept(catalog):
    true = camera_of(20, distortion=radial(0.3))
    true = replace(true, fy_px=1.02 * true.fx_px)
    start = replace(true, fx_px=0.97 * true.fx_px, fy_px=0.97 * true.fy_px)
    ((fit, _),) = fits(catalog, true, start, 1, seed=4, noise_px=0.05)
    assert fit.camera.distortion == true.distortion
    assert fit.camera.fy_px / fit.camera.fx_px == pytest.approx(1.02)
    assert abs(fit.values[0] - true.focal_length_px) < 5 * fit.standard_errors[0]


def test_terms_can_be_asked_for(catalog):
    camera = camera_of(20)
    terms = ("k1", "principal_point")
    ((fit, _),) = fits(catalog, camera, camera, 1, seed=5, noise_px=0.1, terms=terms)
    assert fit.terms == ("principal_point", "k1")
    assert fit.names == ("focal_length_px", "cx_px", "cy_px", "k1")
    bent = camera_of(20, distortion=radial(0.3))
    ((fit, _),) = fits(catalog, bent, camera, 1, seed=5, noise_px=0.1, terms=())
    assert fit.terms == ()


def test_a_frame_without_any_error_has_no_terms(catalog):
    ((fit, _),) = fits(catalog, camera_of(12), camera_of(12), 1, seed=6, noise_px=0.0)
    assert fit.values[0] == pytest.approx(camera_of(12).fx_px, rel=1e-9)
    assert fit.terms == ()


# What is refused


def four_stars():
    camera = camera_of(12)
    xy = np.array([(20.0, 40.0), (450.0, 90.0), (300.0, 480.0), (120.0, 300.0)])
    return camera, xy, camera.vectors(xy)


@pytest.mark.parametrize(
    ("terms", "text"),
    [
        (("k3",), "^term 'k3' is unknown: use principal_point, k1, k2$"),
        (("k2",), "^k2 is fitted only together with k1$"),
        (
            ("principal_point", "k1", "k2"),
            "^4 stars do not determine 8 parameters: 5 or more are needed$",
        ),
    ],
)
def test_terms_that_cannot_be_fitted_are_refused(terms, text):
    with pytest.raises(ValueError, match=text):
        calibrate(*four_stars(), terms=terms)


def test_radial_terms_beside_a_known_distortion_are_refused():
    camera, xy, stars = four_stars()
    camera = replace(camera, distortion=radial(0.1))
    with pytest.raises(ValueError, match=r"^k1 and k2 are fitted to a camera without distortion"):
        calibrate(camera, xy, stars, terms=("k1",))


def test_too_few_stars_are_refused():
    camera, xy, stars = four_stars()
    with pytest.raises(ValueError, match=r"^2 stars do not determine 4 parameters: 3 or more"):
        calibrate(camera, xy[:2], stars[:2])
    with pytest.raises(ValueError, match=r"do not determine a rotation"):
        calibrate(camera, xy[:1], stars[:1])


def test_stars_in_one_place_are_refused():
    camera, xy, _ = four_stars()
    near = np.full((4, 2), 100.0) + 1e-9 * xy
    with pytest.raises(ValueError, match=r"do not determine"):
        calibrate(camera, near, camera.vectors(near))


def test_other_shapes_are_refused():
    camera, xy, stars = four_stars()
    with pytest.raises(ValueError, match=r"^centroids \(4, 2\) and star vectors \(3, 3\) must be"):
        calibrate(camera, xy, stars[:3])
