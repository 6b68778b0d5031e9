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
    Distortion("rational_polynomial", (
        0.1, 0.02, 0.001, -0.002, 0.003, 0.05, 0.004, 0.0003, 0.01, -0.02, 0.015, 0.005,
    )),
    Distortion("rational_polynomial", (
        0.1, 0.02, 0.001, -0.002, 0.003, 0.05, 0.004, 0.0003, 0.01, -0.02, 0.015, 0.005, 0.1,
        -0.06,
    )),
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


def test_thin_prism_of_one_point_by_hand():
    """OpenCV's s1 s2 s3 s4 add s1 r^2 + s2 r^4 to x and s3 r^2 + s4 r^4 to y; r2 = 0.13."""
    lens = Distortion("rational_polynomial", (*(0.0,) * 8, 0.1, 0.2, 0.3, 0.4))
    expected = [(0.3 + 0.013 + 0.2 * 0.0169, -0.2 + 0.039 + 0.4 * 0.0169)]
    np.testing.assert_allclose(lens.distort(np.array([(0.3, -0.2)])), expected, rtol=1e-14)


@pytest.mark.parametrize(("tau", "expected"), [
    # x' = x cos(t) / (1 + x sin(t)) and y' = y / (1 + x sin(t)), divided as the axis stays sharp.
    ((0.0, 0.2), lambda x, y, s, c: (x / (c + x * s), y * c / (c + x * s))),
    ((0.2, 0.0), lambda x, y, s, c: (x * c / (c - y * s), y / (c - y * s))),
])
def test_a_tilted_sensor_by_hand(tau, expected):
    """Rays (x, y, 1) meet a plane through (0, 0, 1) that is turned about one axis."""
    lens = Distortion("rational_polynomial", (*(0.0,) * 12, *tau))
    s, c = math.sin(0.2), math.cos(0.2)
    np.testing.assert_allclose(
        lens.distort(np.array([(0.3, -0.2)])), [expected(0.3, -0.2, s, c)], rtol=1e-14
    )


#: Ideal points, and where OpenCV 4.14.0 puts them with the first 12 and all 14 of these
#: coefficients: cv2.projectPoints([(x, y, 1)], zeros(3), zeros(3), eye(3), coefficients).
OPENCV = (
    0.1, 0.02, 0.001, -0.002, 0.003, 0.05, 0.004, 0.0003, 0.01, -0.02, 0.015, 0.005, 0.1, -0.06,
)
OPENCV_IDEAL = [(0.3, -0.2), (-0.4, 0.1), (0.05, 0.45)]
OPENCV_POINTS = {
    12: [
        (0.30224163409001, -0.198861922726673), (-0.403497592766081, 0.10393439819152),
        (0.05137613879486, 0.458679874153744),
    ],
    14: [
        (0.302271025396714, -0.19770154751857), (-0.398670531274672, 0.100622324078919),
        (0.054127683204735, 0.485123371724347),
    ],
}


@pytest.mark.parametrize("n", [12, 14])
def test_thin_prism_and_tilt_are_those_of_opencv(n):
    lens = Distortion("rational_polynomial", OPENCV[:n])
    np.testing.assert_allclose(
        lens.distort(np.array(OPENCV_IDEAL)), OPENCV_POINTS[n], rtol=0, atol=1e-14
    )


def test_prism_and_tilt_of_zero_change_nothing():
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (50, 2))
    plain = Distortion("rational_polynomial", OPENCV[:8])
    for zeros in (4, 6):
        lens = Distortion("rational_polynomial", (*OPENCV[:8], *(0.0,) * zeros))
        np.testing.assert_array_equal(lens.distort(points), plain.distort(points))


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


def turning_point(*coefficients):
    """Where r (1 + k1 r^2 + k2 r^4 + k3 r^6) first stops to rise: the root of its derivative."""
    k1, k2, k3 = coefficients
    squares = np.roots([7 * k3, 5 * k2, 3 * k1, 1])
    return math.sqrt(min(u.real for u in squares if abs(u.imag) < 1e-12 and u.real > 0))


@pytest.mark.parametrize("radial", [
    (-0.3, 0.0, 0.0), (-0.405, 0.267, -0.130), (-5.0, 0.0, 0.0), (0.3, -0.4, 0.0),
    (-1e6, 0.0, 0.0),
])
def test_the_limit_of_a_radial_lens_is_where_its_polynomial_turns(radial):
    k1, k2, k3 = radial
    lens = Distortion("plumb_bob", (k1, k2, 0.0, 0.0, k3))
    assert lens.limit == pytest.approx(turning_point(*radial), rel=1e-6)


@pytest.mark.parametrize("lens", [
    Distortion("plumb_bob", (0.1, 0.0, 0.0, 0.0, 0.0)),
    Distortion("equidistant", (0.0, 0.0, 0.0, 0.0)),
    # A calibration that somebody uses (basler/pylon-ros-camera #143): wild, but it never turns.
    Distortion("rational_polynomial", (
        -13.238113, -98.012135, 0.001444, 0.002849, 1357.782415, -13.050801, -102.363353,
        1383.055291,
    )),
])
def test_a_lens_that_never_turns_is_followed_to_89_degrees(lens):
    assert math.degrees(math.atan(lens.limit)) == pytest.approx(88.8, abs=0.1)


def test_the_limit_of_a_pole_is_the_pole():
    """(1 + 0.1 r^2) / (1 - r^2) rises to infinity and comes back from the other side."""
    lens = Distortion("rational_polynomial", (0.1, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0))
    assert lens.limit == pytest.approx(1.0, rel=1e-6)


def test_a_lens_that_is_not_round_ends_where_its_first_direction_turns():
    """Tangential terms put off the turning point on one side and bring it nearer on the other."""
    round_lens = Distortion("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0))
    lens = Distortion("plumb_bob", (-0.3, 0.0, 0.0, 0.02, 0.0))
    # Along -x: d/dr [r (1 - 0.3 r^2) - 3 p2 r^2] = 1 - 0.9 r^2 - 6 p2 r = 0.
    first = (-0.12 + math.sqrt(0.12**2 + 4 * 0.9)) / 1.8
    assert lens.limit == pytest.approx(first, rel=1e-6)
    assert lens.limit < round_lens.limit


@pytest.mark.parametrize("coefficients", [(1e30,) * 5, (1e300,) * 5, (-1e300,) * 5])
def test_a_lens_of_absurd_coefficients_shows_nothing(coefficients):
    assert Distortion("plumb_bob", coefficients).limit < 1e-6


def test_all_within_the_limit_comes_back_and_nothing_beyond_does():
    lens = Distortion("plumb_bob", (-0.405, 0.267, 0.0, 0.0, -0.130))
    # (r + d) and (r - d) of the turning point lie at the same place, by its square.
    edge = lens.distort(np.array([(lens.limit, 0.0)]))[0, 0]
    for azimuth in np.linspace(0, 2 * np.pi, 12):
        ray = np.array([(np.cos(azimuth), np.sin(azimuth))])
        ideal = np.linspace(0, 0.999 * lens.limit, 200)[:, None] * ray
        np.testing.assert_allclose(lens.undistort(lens.distort(ideal)), ideal, rtol=0, atol=1e-9)
        assert refusal(lens.undistort, 1.00001 * edge * ray) == NOT_INVERTIBLE


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
        (
            "rational_polynomial",
            (*(0.0,) * 12, 0.0, -1.6),
            "the sensor's tilt, coefficients 13 and 14, must be below 90 deg",
        ),
        ("plumb_bob", (0.0,) * 4, "distortion model plumb_bob takes 5 coefficients, not 4"),
        (
            "rational_polynomial",
            (0.0,) * 9,
            "distortion model rational_polynomial takes 8 or 12 or 14 coefficients, not 9",
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
