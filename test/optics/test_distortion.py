"""Lens models, written out by hand for one point, and their inverse."""

import math

import numpy as np
import pytest

from star_tracker.optics.distortion import Distortion

NOT_INVERTIBLE = (
    "the distortion cannot be inverted for a point of the image: "
    "check the coefficients of the calibration"
)
#: One lens of each model as calibrations give them for fields of some 60 deg.
LENSES = (
    Distortion("plumb_bob", (-0.28, 0.09, 0.0004, -0.0003, -0.012)),
    Distortion("plumb_bob", (0.15, 0.02, -0.001, 0.002, 0.0)),
    Distortion("rational_polynomial", (0.4, 0.1, 0.0002, -0.0001, 0.01, 0.6, 0.2, 0.02)),
    Distortion("equidistant", (-0.02, 0.004, -0.001, 0.0002)),
)


def refusal(function, *arguments):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the callers compare the text
        function(*arguments)
    return str(refused.value)


def test_plumb_bob_of_one_point_by_hand():
    """OpenCV's k1 k2 p1 p2 k3 at (0.3, -0.2), where r2 = 0.13."""
    lens = Distortion("plumb_bob", (0.1, 0.01, 0.001, 0.002, 0.001))
    # radial = 1 + 0.1 * 0.13 + 0.01 * 0.0169 + 0.001 * 0.002197 = 1.013171197
    # x: 0.3 * radial + 2 * 0.001 * -0.06 + 0.002 * (0.13 + 2 * 0.09) = 0.3039513591 + 0.0005
    # y: -0.2 * radial + 0.001 * (0.13 + 2 * 0.04) + 2 * 0.002 * -0.06 = -0.2026342394 - 0.00003
    np.testing.assert_allclose(
        lens.distort(np.array([(0.3, -0.2)])), [(0.3044513591, -0.2026642394)], rtol=1e-13
    )


def test_rational_polynomial_of_one_point_by_hand():
    """OpenCV's order is k1 k2 p1 p2 k3 k4 k5 k6; the last three divide."""
    lens = Distortion("rational_polynomial", (0.1, 0.01, 0.0, 0.0, 0.001, 0.05, 0.004, 0.0003))
    # 1 + 0.05 * 0.13 + 0.004 * 0.0169 + 0.0003 * 0.002197 = 1.0065682591
    radial = 1.013171197 / 1.0065682591
    np.testing.assert_allclose(
        lens.distort(np.array([(0.3, -0.2)])), [(0.3 * radial, -0.2 * radial)], rtol=1e-13
    )


def test_equidistant_of_one_point_by_hand():
    """A ray 45 deg off the axis lands at theta (1 + k1 theta^2 + ...), theta = pi / 4."""
    theta = math.pi / 4
    straight = Distortion("equidistant", (0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(straight.distort(np.array([(1.0, 0.0)])), [(theta, 0)])
    lens = Distortion("equidistant", (0.1, 0.02, 0.003, 0.0004))
    bent = theta + 0.1 * theta**3 + 0.02 * theta**5 + 0.003 * theta**7 + 0.0004 * theta**9
    np.testing.assert_allclose(lens.distort(np.array([(0.0, -1.0)])), [(0, -bent)])


@pytest.mark.parametrize("lens", LENSES)
def test_the_centre_stays_where_it_is(lens):
    np.testing.assert_array_equal(lens.distort(np.zeros((1, 2))), np.zeros((1, 2)))
    np.testing.assert_array_equal(lens.undistort(np.zeros((1, 2))), np.zeros((1, 2)))


@pytest.mark.parametrize("lens", LENSES)
def test_undistort_inverts_distort_over_a_wide_field(lens):
    side = np.linspace(-0.45, 0.45, 19)
    ideal = np.array([(x, y) for x in side for y in side])
    np.testing.assert_allclose(lens.undistort(lens.distort(ideal)), ideal, rtol=0, atol=1e-10)


@pytest.mark.parametrize("lens", LENSES)
def test_no_points_are_no_trouble(lens):
    assert lens.undistort(np.empty((0, 2))).shape == (0, 2)
    assert lens.distort(np.empty((0, 2))).shape == (0, 2)


def test_the_argument_is_not_changed():
    points = np.array([(0.2, 0.3)])
    LENSES[0].undistort(points)
    np.testing.assert_array_equal(points, [(0.2, 0.3)])


def test_a_ray_from_behind_the_lens_is_refused():
    """An equidistant lens sees 90 deg off the axis at pi / 2; a pinhole has no place for more."""
    lens = Distortion("equidistant", (0.0, 0.0, 0.0, 0.0))
    assert refusal(lens.undistort, np.array([(0.1, 0.1), (1.6, 0.0)])) == NOT_INVERTIBLE


@pytest.mark.parametrize("distorted", [0.71, 0.75, 0.9, 1.5])
def test_a_point_beyond_the_edge_of_a_barrel_lens_is_refused(distorted):
    """r (1 - 0.3 r^2) never exceeds 0.703 on its way out: no ray of the scene lands farther out.

    The polynomial reaches such values again on the other side of the axis; that is no answer.
    """
    lens = Distortion("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0))
    assert refusal(lens.undistort, np.array([(distorted, 0.0)])) == NOT_INVERTIBLE


@pytest.mark.parametrize("distorted", [1.0, 1.5])
def test_a_pole_of_the_model_never_puts_a_point_on_the_other_side(distorted):
    """(1 + 0.1 r^2) / (1 - r^2) grows without bound towards r = 1: the ray lies within."""
    lens = Distortion("rational_polynomial", (0.1, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0))
    try:
        ((x, y),) = lens.undistort(np.array([(distorted, 0.0)]))
    except ValueError as refused:
        assert str(refused) == NOT_INVERTIBLE  # noqa: PT017 - refusing is as good
        return
    assert 0 < x < 1
    assert y == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("model", "coefficients", "text"),
    [
        (
            "fisheye",
            (0.0,) * 4,
            "unknown distortion model 'fisheye': "
            "use one of plumb_bob, rational_polynomial, equidistant",
        ),
        ("plumb_bob", (0.0,) * 4, "distortion model plumb_bob takes 5 coefficients, not 4"),
        (
            "rational_polynomial",
            (0.0,) * 14,
            "distortion model rational_polynomial takes 8 coefficients, not 14",
        ),
        ("equidistant", (), "distortion model equidistant takes 4 coefficients, not 0"),
        (
            "plumb_bob",
            (0.0, math.nan, 0.0, 0.0, 0.0),
            "distortion coefficients must be finite numbers",
        ),
        (
            "equidistant",
            (0.0, 0.0, 0.0, math.inf),
            "distortion coefficients must be finite numbers",
        ),
    ],
)
def test_wrong_models_and_coefficients_are_refused(model, coefficients, text):
    assert refusal(Distortion, model, coefficients) == text
