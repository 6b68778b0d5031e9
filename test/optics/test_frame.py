"""A frame: which centroids are usable, where they point at any scale, who is main star first."""

import numpy as np
import pytest
from engines import CAMERA, centroids_of, folding_lens, frame_of

from star_tracker.geometry.spherical import separation
from star_tracker.maps.simulation import uniform_noise
from star_tracker.optics.camera import PIXEL_ORIGINS, Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.optics.frame import see_at_scale

SQUARE = np.array([(0.0, 0), (1, 0), (0, 1), (1, 1)])


def shown(xy_px, camera=CAMERA, intensity=None, **options):
    return centroids_of(frame_of(xy_px, camera, intensity, **options))


# What is usable


def test_a_frame_goes_from_left_to_right_and_knows_the_rows_of_the_input():
    xy = np.random.default_rng(1).random((80, 2)) * 512
    frame = shown(xy)
    np.testing.assert_array_equal(frame.row, np.argsort(xy[:, 0]))
    np.testing.assert_allclose(frame.vectors, CAMERA.vectors(xy)[frame.row], rtol=1e-13)
    np.testing.assert_allclose(frame.plane_px, xy[frame.row] - 256, atol=1e-9)


def test_centroids_that_are_not_finite_or_far_outside_are_left_out():
    """The margin is a twentieth of the larger side, 25.6 px."""
    inf, nan = np.inf, np.nan
    xy = np.array([
        (nan, 5.0), (500, 100), (5, inf), (-25, 9), (-26, 9), (100, 537), (100, 538), (7, -inf),
    ])
    frame = shown(xy)
    assert frame.n == 3
    assert frame.row.tolist() == [3, 5, 1]


def test_a_centroid_without_a_ray_is_left_out_and_counted():
    """The lens shows nothing beyond 200 px from the middle, and the corner is 360 px away."""
    frame = shown([(300.0, 256), (1, 1), (256, 100), (511, 511)], folding_lens(200.0))
    assert frame.n == 2
    assert frame.row.tolist() == [2, 0]


LENS = Distortion("plumb_bob", (-0.05, 0.0, 0.0, 0.0, 0.0))


def test_with_a_lens_the_margin_about_the_image_is_a_pixel():
    xy = [(-1.01, 100), (-1.0, 100), (0, 100), (512, 90), (513, 90), (513.01, 90)]
    plain = Camera(512, 512, 1000.0, 1000.0, 256, 256)
    assert shown(xy, plain).row.tolist() == [0, 1, 2, 3, 4, 5]
    bent = Camera(512, 512, 1000.0, 1000.0, 256, 256, "normal", LENS)
    assert shown(xy, bent).row.tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize("lens", [None, LENS])
@pytest.mark.parametrize("origin", PIXEL_ORIGINS)
def test_a_star_in_the_outermost_half_pixel_is_inside_however_pixels_are_counted(origin, lens):
    """A fifth of a pixel from each border, with noise that puts it as far outside."""
    less = PIXEL_ORIGINS[origin]
    camera = Camera(512, 400, 1000.0, 1000.0, 256 - less, 200 - less, "normal", lens)
    for off in (0.2, -0.2):
        xy = np.array([(off, 100), (512 - off, 100), (300, off), (300, 400 - off)])
        assert frame_of(xy - less, camera).n == 4


@pytest.mark.parametrize(("n", "room"), [(11, 10), (500, 10), (10, 10)])
def test_more_centroids_than_there_is_room_for_are_left_out(n, room):
    xy = uniform_noise(CAMERA, n, np.random.default_rng(n))
    frame = frame_of(xy, room=room)
    assert frame.n == room
    assert set(centroids_of(frame).row.tolist()) == set(range(room))


def test_a_frame_that_was_too_full_leaves_nothing_in_the_next():
    frame = frame_of(uniform_noise(CAMERA, 50, np.random.default_rng(2)), room=10)
    assert frame.n == 10
    xy = uniform_noise(CAMERA, 7, np.random.default_rng(3))
    again = frame_of(xy, room=10)
    assert centroids_of(again).n == 7
    np.testing.assert_allclose(
        centroids_of(again).vectors, CAMERA.vectors(xy[np.argsort(xy[:, 0])]), rtol=1e-13
    )


def test_a_frame_keeps_undistorted_pixels_with_y_down():
    lens = Distortion("plumb_bob", (-0.2, 0.0, 0.0, 0.0, 0.0))
    camera = Camera(512, 512, 400.0, 400.0, 250, 260, "mirrored", lens)
    frame = shown([(350.0, 400.0)], camera)
    np.testing.assert_allclose(frame.vectors, camera.vectors([(350.0, 400.0)]))
    plane = frame.vectors[:, :2] / frame.vectors[:, 2:]
    np.testing.assert_allclose(frame.plane_px, 400 * plane)
    assert frame.plane_px[0, 1] < 0


@pytest.mark.parametrize("n", [0, 1, 2, 3, 40, 701, 900])
def test_a_frame_of_any_size_is_sorted(n):
    xy = uniform_noise(CAMERA, n, np.random.default_rng(n))
    frame = shown(xy)
    assert frame.n == n
    assert np.all(np.diff(frame.plane_px[:, 0]) >= 0)
    np.testing.assert_array_equal(frame.row, np.argsort(xy[:, 0]))


# The scale


@pytest.mark.parametrize("scale", [0.5, 0.97, 1.0, 1.03, 2.0])
@pytest.mark.parametrize("parity", ["normal", "mirrored"])
def test_directions_at_a_scale_are_those_of_a_camera_with_that_focal_length(scale, parity):
    """Of oblong pixels and with the principal point off the middle."""
    camera = Camera(640, 480, 2000.0, 2100.0, 300.0, 250.0, parity)
    xy = uniform_noise(camera, 30, np.random.default_rng(4))
    frame = frame_of(xy, camera)
    see_at_scale(frame, camera.focal_length_px, scale)
    seen = centroids_of(frame)
    expected = camera.scaled(scale).vectors(xy)[seen.row]
    np.testing.assert_allclose(seen.vectors, expected, rtol=0, atol=1e-15)
    assert seen.scale == scale


def test_scales_do_not_pile_up():
    xy = uniform_noise(CAMERA, 30, np.random.default_rng(5))
    frame = frame_of(xy)
    for scale in (1.1, 0.9, 1.3, 1.0):
        see_at_scale(frame, CAMERA.focal_length_px, scale)
    seen = centroids_of(frame)
    np.testing.assert_allclose(seen.vectors, CAMERA.vectors(xy)[seen.row], rtol=0, atol=1e-15)


def test_a_scale_makes_separations_smaller_by_its_tangent():
    """A star 100 px from the principal point."""
    frame = frame_of([(256.0, 256), (356, 256)])
    see_at_scale(frame, CAMERA.focal_length_px, 1.25)
    apart = separation(*centroids_of(frame).vectors)
    assert np.tan(apart) == pytest.approx(100 / (1.25 * CAMERA.focal_length_px), rel=1e-12)


def test_a_new_frame_begins_at_the_cameras_own_scale():
    frame = frame_of(uniform_noise(CAMERA, 9, np.random.default_rng(6)))
    see_at_scale(frame, CAMERA.focal_length_px, 1.2)
    assert centroids_of(frame).scale == 1.2
    assert centroids_of(frame_of([(1.0, 2.0)])).scale == 1.0


# The order of main stars


def test_main_stars_with_the_nearest_companions_are_tried_first():
    """Two groups of four on squares of 40 px and 90 px, and one star far from all."""
    frame = shown(np.concatenate([300 + 90 * SQUARE, 60 + 40 * SQUARE, [(480.0, 20)]]))
    order = frame.row[frame.mains].tolist()
    assert set(order[:4]) == {4, 5, 6, 7}
    assert set(order[4:8]) == {0, 1, 2, 3}
    assert order[8] == 8


@pytest.mark.parametrize(("side", "first"), [(1.0, False), (10.0, False), (15.5, True)])
def test_stars_too_close_together_count_as_if_they_were_15_px_apart(side, first):
    """Squares of 1 px and of 10 px, whose diagonal is 14 px, are no better than one of 15 px.

    Sums of distances to three: 45 px against 15 + 15.15 + 21.32 = 51.5 px.
    """
    frame = shown(np.concatenate([300 + side * SQUARE, 100 + 15 * SQUARE * (1, 1.01)]))
    large = frame.row[frame.mains][4:] < 4
    assert large.all() == first


def test_bright_main_stars_are_tried_before_faint_ones_of_the_same_figure():
    intensity = np.array([1.0, 40.0, 300.0, 9.0])
    frame = shown(200 + 50 * SQUARE, intensity=intensity)
    # A square's corners have the same distances.
    assert frame.row[frame.mains].tolist() == [2, 1, 3, 0]
    np.testing.assert_array_equal(frame.intensity, intensity[frame.row])


def test_intensities_that_mean_nothing_are_unknown():
    xy = np.column_stack([np.arange(6.0) * 50, np.full(6, 80.0)])
    frame = shown(xy, intensity=[100.0, 0.0, -3.0, np.nan, np.inf, 1.0])
    assert frame.has_brightness
    np.testing.assert_array_equal(frame.intensity, [100, 0, 0, 0, 0, 1])
    assert not shown(xy).has_brightness


@pytest.mark.parametrize("n", [0, 1, 2, 3, 40])
def test_each_star_is_a_main_star_once(n):
    frame = shown(np.random.default_rng(n).random((n, 2)) * 512)
    assert sorted(frame.mains.tolist()) == list(range(n))
