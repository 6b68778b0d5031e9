"""The camera's conventions, pinned with numbers: pixel origin, parity, field of view."""

import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from star_tracker.geometry.spherical import separation
from star_tracker.optics.camera import Camera, outside_px
from star_tracker.optics.distortion import Distortion

#: 256 / tan(6 deg) and 512 / tan(10 deg), from a table of tangents.
FOCAL_12_512 = 256 / 0.10510423526567646
FOCAL_20_1024 = 512 / 0.17632698070846498
BARREL = Distortion("plumb_bob", (-0.2, 0.05, 0.001, -0.0005, 0.0))


def camera_of(**changes):
    """A camera with every parameter different from every other."""
    values = {
        "width_px": 800, "height_px": 600, "fx_px": 2000.0, "fy_px": 2100.0, "cx_px": 410.0,
        "cy_px": 290.0,
    }
    return Camera(**(values | changes))


@pytest.mark.parametrize(
    ("fov_deg", "width", "focal"), [(12, 512, FOCAL_12_512), (20, 1024, FOCAL_20_1024)]
)
def test_focal_length_of_the_papers_cameras(fov_deg, width, focal):
    camera = Camera.from_fov(fov_deg, width, width)
    assert (camera.fx_px, camera.fy_px) == pytest.approx((focal, focal), rel=1e-14)
    assert camera.focal_length_px == pytest.approx(focal, rel=1e-14)


@pytest.mark.parametrize("fov_deg", [0.5, 3.7, 12.0, 90.0, 120.0])
def test_field_of_view_comes_back_from_the_focal_length(fov_deg):
    assert Camera.from_fov(fov_deg, 640, 480).fov_deg == pytest.approx(fov_deg, rel=1e-14)


def test_field_of_view_is_across_the_width_not_the_height():
    camera = Camera.from_fov(12, 512, 256)
    assert camera.fov_deg == pytest.approx(12)
    left, right = camera.vectors([(0, 128), (512, 128)])
    assert np.degrees(separation(left, right)) == pytest.approx(12)


def test_centre_of_the_image_is_the_boresight_by_default():
    np.testing.assert_array_equal(Camera.from_fov(12, 512, 400).vectors([(256, 200)]), [(0, 0, 1)])


def test_origin_is_the_outer_corner_of_the_first_pixel():
    """The corners (0, 0) and (512, 512) are equally far from the boresight."""
    corners = Camera.from_fov(12, 512, 512).vectors([(0, 0), (512, 512)])
    np.testing.assert_allclose(corners[0] * (-1, -1, 1), corners[1], rtol=1e-15)


def test_a_detector_that_counts_from_pixel_centres_differs_by_half_a_pixel():
    """OpenCV's (0, 0) is the centre of the first pixel, (0.5, 0.5) in our coordinates."""
    ours = Camera.from_fov(12, 512, 512)
    opencv = Camera.from_fov(12, 512, 512, principal_point_px=(255.5, 255.5))
    np.testing.assert_allclose(opencv.vectors([(0, 0)]), ours.vectors([(0.5, 0.5)]), rtol=1e-15)


def test_normal_parity_is_the_optical_frame_x_right_y_down():
    camera = Camera.from_fov(12, 512, 512)
    s, c = math.sin(math.radians(6)), math.cos(math.radians(6))
    np.testing.assert_allclose(
        camera.vectors([(512, 256), (256, 512)]), [(s, 0, c), (0, s, c)], atol=1e-15
    )


def test_mirrored_parity_has_pixels_whose_y_axis_points_up():
    camera = Camera.from_fov(12, 512, 512, parity="mirrored")
    s, c = math.sin(math.radians(6)), math.cos(math.radians(6))
    np.testing.assert_allclose(
        camera.vectors([(512, 256), (256, 512)]), [(s, 0, c), (0, -s, c)], atol=1e-15
    )


def test_one_direction_has_mirror_images_in_the_two_parities():
    normal = Camera.from_fov(12, 512, 512)
    directions = normal.vectors([(100, 50), (300, 400)])
    pixels = normal.with_parity("mirrored").pixels(directions)
    np.testing.assert_allclose(pixels, [(100, 462), (300, 112)], atol=1e-10)


def test_a_direction_by_hand_with_unequal_focal_lengths():
    camera = camera_of(parity="normal")
    # (610 - 410) / 2000 = 0.1 and (500 - 290) / 2100 = 0.1
    np.testing.assert_allclose(camera.plane([(610, 500)]), [(0.1, 0.1)], rtol=1e-14)
    np.testing.assert_allclose(
        camera.vectors([(610, 500)]), [np.array([0.1, 0.1, 1]) / math.sqrt(1.02)], rtol=1e-14
    )


def test_vectors_have_unit_length():
    xy = np.random.default_rng(0).random((50, 2)) * (800, 600)
    np.testing.assert_allclose(np.linalg.norm(camera_of().vectors(xy), axis=1), 1, rtol=1e-15)


@pytest.mark.parametrize("distortion", [None, BARREL])
@pytest.mark.parametrize("parity", ["normal", "mirrored"])
def test_pixels_come_back_from_their_directions(parity, distortion):
    camera = camera_of(parity=parity, distortion=distortion)
    xy = np.random.default_rng(1).random((200, 2)) * (800, 600)
    np.testing.assert_allclose(camera.pixels(camera.vectors(xy)), xy, rtol=0, atol=1e-8)
    np.testing.assert_allclose(camera.pixels_of_plane(camera.plane(xy)), xy, rtol=0, atol=1e-8)


def test_the_lens_bends_raw_pixels_so_a_mirrored_image_mirrors_the_lens_too():
    """Tangential distortion has a direction: flipping y of the pixels must flip the result."""
    lens = Distortion("plumb_bob", (0.0, 0.0, 0.01, 0.0, 0.0))
    normal = Camera.from_fov(40, 512, 512, parity="normal")
    raw = Camera(512, 512, normal.fx_px, normal.fx_px, 256, 256, "normal", lens)
    np.testing.assert_allclose(
        raw.with_parity("mirrored").plane([(400, 300)]), raw.plane([(400, 300)]) * (1, -1)
    )


def test_radius_reaches_the_corner_of_a_square_image():
    radius = Camera.from_fov(12, 512, 512).radius_rad
    assert math.tan(radius) == pytest.approx(math.sqrt(2) * math.tan(math.radians(6)))


def test_radius_reaches_the_farthest_corner_from_an_excentric_principal_point():
    camera = camera_of()
    # The farthest corner of 800 x 600 from (410, 290) is (0, 600).
    assert math.tan(camera.radius_rad) == pytest.approx(math.hypot(410 / 2000, 310 / 2100))


def test_radius_is_the_same_in_both_parities_and_where_the_parity_is_unknown():
    radii = [camera_of(parity=p).radius_rad for p in ("normal", "mirrored", "auto")]
    assert radii == pytest.approx([radii[0]] * 3)


@pytest.mark.parametrize("k1", [-0.2, 0.2])
def test_no_pixel_of_a_distorted_image_lies_beyond_the_radius(k1):
    camera = camera_of(fx_px=500.0, fy_px=500.0, distortion=Distortion(
        "plumb_bob", (k1, 0.02, 0.0, 0.0, 0.0)
    ))
    xy = np.random.default_rng(2).random((2000, 2)) * (800, 600)
    xy = np.concatenate([xy, [(0, 0), (0, 600), (800, 0), (800, 600)]])
    assert np.max(separation(camera.vectors(xy), (0.0, 0.0, 1.0))) <= camera.radius_rad + 1e-12


def test_mean_focal_length():
    camera = camera_of()
    assert camera.focal_length_px == pytest.approx(math.sqrt(2000 * 2100))


def test_image_contains_its_border_but_nothing_beyond():
    camera = camera_of()
    xy = np.array([(0, 0), (800, 600), (-0.01, 5), (5, 600.01), (400, 300)])
    np.testing.assert_array_equal(camera.contains(xy), (True, True, False, False, True))


def test_a_margin_widens_the_image_on_all_sides():
    xy = np.array([(-5, 0), (805, 605), (-5.01, 0), (0, 605.01)])
    np.testing.assert_array_equal(camera_of().contains(xy, 5.0), (True, True, False, False))


def test_image_contains_nothing_that_is_not_finite():
    xy = np.array([(np.nan, 5), (5, np.nan), (np.inf, 5), (5, -np.inf)])
    assert not camera_of().contains(xy, 1e9).any()


def test_the_border_is_the_same_where_the_parity_is_unknown():
    xy = np.array([(0, 0), (800, 600), (-0.01, 5), (5, 600.01)])
    inside = camera_of().contains(xy)
    np.testing.assert_array_equal(camera_of(parity="auto").contains(xy), inside)


@pytest.mark.parametrize("distortion", [None, BARREL])
@pytest.mark.parametrize("parity", ["normal", "mirrored"])
def test_what_is_outside_and_how_far_agrees_with_what_the_image_contains(parity, distortion):
    camera = camera_of(parity=parity, distortion=distortion)
    xy = np.array([(0, 0), (800, 600), (400, 300), (-30, 5), (810, 700), (5, -2), (5, 601.5)])
    points = np.column_stack([camera.plane(xy), np.empty(len(xy))])
    outside_px(camera.optics, points, len(xy))
    np.testing.assert_allclose(points[:, 2], [0, 0, -300, 30, 100, 2, 1.5], atol=1e-9)
    np.testing.assert_array_equal(camera.contains(xy, 1e-6), points[:, 2] < 1e-6)


@pytest.mark.parametrize("parity", ["normal", "mirrored"])
def test_a_definite_parity_has_one_camera(parity):
    camera = camera_of(parity=parity)
    assert camera.definite() == (camera,)


def test_parity_auto_has_one_camera_for_each_parity():
    cameras = camera_of(parity="auto").definite()
    assert cameras == (camera_of(parity="normal"), camera_of(parity="mirrored"))


def test_a_camera_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        camera_of().parity = "mirrored"


@pytest.mark.parametrize("use", ["plane", "vectors", "pixels", "pixels_of_plane"])
def test_parity_auto_has_no_pixels(use):
    camera = camera_of(parity="auto")
    argument = np.array([(0.0, 0.0, 1.0)]) if use == "pixels" else np.array([(0.0, 0.0)])
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - compared below
        getattr(camera, use)(argument)
    assert str(refused.value) == (
        "parity auto has no pixels of its own: use one of the cameras of definite()"
    )


@pytest.mark.parametrize("vector", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_a_direction_behind_the_camera_has_no_pixel(vector):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - compared below
        camera_of().pixels([(0.0, 0.0, 1.0), vector])
    assert str(refused.value) == (
        "a direction behind the camera has no pixel: drop those with z <= 0"
    )


# A lens that has no ray for the corners


#: K and D of a calibration that somebody uses (ros-perception/image_pipeline #154).
BLIND_CORNERS = Distortion("plumb_bob", (-0.405, 0.267, 0.0, 0.0, -0.130))


def blind_camera(**changes):
    values = {
        "width_px": 752, "height_px": 480, "fx_px": 531.4, "fy_px": 531.4, "cx_px": 376.0,
        "cy_px": 240.0, "distortion": BLIND_CORNERS,
    }
    return Camera(**(values | changes))


def bent_radius(r):
    """Its polynomial, by hand."""
    return r * (1 - 0.405 * r**2 + 0.267 * r**4 - 0.130 * r**6)


def test_a_pixel_has_a_ray_up_to_where_the_polynomial_turns():
    camera, turn = blind_camera(), 1.06816
    x, y = np.meshgrid(np.linspace(0, 752, 95), np.linspace(0, 480, 61))
    xy = np.column_stack([x.ravel(), y.ravel()])
    radius = np.hypot(*(xy - (376, 240)).T) / 531.4
    np.testing.assert_array_equal(camera.has_ray(xy), radius < bent_radius(turn))
    assert 0.9 < camera.has_ray(xy).mean() < 0.99


def test_without_distortion_each_pixel_has_a_ray():
    assert blind_camera(distortion=None).has_ray([(0, 0), (-1e5, 9e5)]).all()


def test_a_pixel_without_a_ray_has_no_direction():
    with pytest.raises(ValueError, match=r"^the distortion cannot be inverted for a point"):
        blind_camera().vectors([(376, 240), (0, 0)])


@pytest.mark.parametrize("parity", ["normal", "mirrored", "auto"])
def test_a_camera_with_blind_corners_sees_as_far_as_its_lens(parity):
    radius = blind_camera(parity=parity).radius_rad
    assert math.tan(radius) == pytest.approx(1.06816, rel=1e-5)


def test_the_outline_goes_along_the_border_and_round_the_blind_corners():
    camera = blind_camera()
    outline = camera.outline
    np.testing.assert_array_equal(outline[0], outline[-1])
    np.testing.assert_allclose(np.linalg.norm(outline, axis=1), 1.0)
    xy = camera.pixels(outline)
    assert camera.contains(xy, 1e-6).all()
    on_border = ~camera.contains(xy, -1e-6)
    assert 8 < on_border.sum() < len(xy)
    radius = np.hypot(*(xy[~on_border] - (376, 240)).T) / 531.4
    np.testing.assert_allclose(radius, bent_radius(1.06816), rtol=1e-4)


def test_the_outline_of_a_mirrored_image_is_the_same_upside_down():
    normal, mirrored = blind_camera(), blind_camera(parity="mirrored")
    np.testing.assert_allclose(mirrored.outline, normal.outline * (1, -1, 1), atol=1e-15)


@pytest.mark.parametrize("parity", ["normal", "mirrored"])
def test_no_direction_from_beyond_the_limit_folds_back_into_the_image(parity):
    """At 52 deg the polynomial has come back to 312 px from the middle, well in the image."""
    camera = blind_camera(parity=parity)
    beyond = math.tan(math.radians(52.4))
    assert 531.4 * abs(bent_radius(beyond)) < 320
    angles = np.linspace(0, 2 * np.pi, 9)
    points = beyond * np.column_stack([np.cos(angles), np.sin(angles)])
    assert np.isnan(camera.pixels_of_plane(points)).all()
    assert np.isnan(camera.pixels(np.column_stack([points, np.ones(9)]))).all()
    assert not camera.contains(camera.pixels_of_plane(points), 1e6).any()
    written = np.column_stack([points, np.zeros(9)])
    outside_px(camera.optics, written, 9)
    assert np.isposinf(written[:, 2]).all()


@pytest.mark.parametrize("changes", [
    {"distortion": Distortion("plumb_bob", (1e30,) * 5)},
    {"distortion": Distortion("plumb_bob", (-50.0, 0.0, 0.0, 0.0, 0.0))},
    {"cx_px": 900.0, "cy_px": -300.0},
])
def test_a_camera_whose_lens_does_not_show_the_middle_is_refused(changes):
    for used in ("radius_rad", "outline"):
        with pytest.raises(ValueError, match=r"^the distortion has no ray") as refused:
            getattr(blind_camera(**changes), used)
        assert str(refused.value) == (
            "the distortion has no ray for the middle of the image: "
            "check its coefficients and the principal point"
        )


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"parity": "flipped"},
            "parity 'flipped' is unknown: use normal, mirrored, auto",
        ),
        (
            {"width_px": 0},
            "image size 0 x 600 px is impossible: give the width and height of the image",
        ),
        (
            {"height_px": -1},
            "image size 800 x -1 px is impossible: give the width and height of the image",
        ),
        (
            {"width_px": math.nan},
            "image size nan x 600 px is impossible: give the width and height of the image",
        ),
        ({"fx_px": math.nan}, "camera fx_px is not a finite number"),
        ({"fy_px": math.inf}, "camera fy_px is not a finite number"),
        ({"cx_px": math.nan}, "camera cx_px is not a finite number"),
        ({"cy_px": -math.inf}, "camera cy_px is not a finite number"),
        ({"fx_px": 0.0}, "the focal length must be greater than 0 px"),
        ({"fy_px": -2100.0}, "the focal length must be greater than 0 px"),
        (
            {"fx_px": 1e6},
            "field of view 0.04584 deg is outside of 0.5 to 120 deg: "
            "check the focal length and the width of the image",
        ),
        (
            {"fx_px": 100.0},
            "field of view 151.9 deg is outside of 0.5 to 120 deg: "
            "check the focal length and the width of the image",
        ),
        ({"fy_px": 1e-300}, "fx 2000 px and fy 1e-300 px belong to no image sensor"),
        (
            {"cx_px": 8e156},
            "principal point (8e+156, 290) px is impossible: it lies near the middle of the image",
        ),
    ],
)
def test_impossible_cameras_are_refused(changes, text):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - compared below
        camera_of(**changes)
    assert str(refused.value) == text


@pytest.mark.parametrize(
    ("fov_deg", "shown"), [(0.4, "0.4"), (121, "121"), (-12, "-12"), (math.nan, "nan")]
)
def test_a_field_of_view_out_of_range_is_refused(fov_deg, shown):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - compared below
        Camera.from_fov(fov_deg, 512, 512)
    assert str(refused.value) == (
        f"fov_deg {shown} is outside of 0.5 to 120: "
        "give the full angle across the width of the image in degrees"
    )
