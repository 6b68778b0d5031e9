"""CameraInfo <-> Camera."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import Header

from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.camera_info import camera_from_info, info_from_camera
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

HEADER = Header(frame_id="camera")
HEADER.stamp.sec = 42
#: A narrow camera with different focal lengths and a principal point off the middle.
CAMERA = Camera(640, 480, 2400.0, 2410.0, 321.5, 238.25, "normal")


def info(**changes):
    message = info_from_camera(CAMERA, HEADER)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def info_with_k(index, value):
    message = info()
    message.k[index] = value
    return message


@pytest.mark.parametrize("parity", ["normal", "mirrored", "auto"])
def test_round_trip_with_the_callers_parity(parity):
    camera = CAMERA.with_parity(parity)
    assert camera_from_info(info_from_camera(camera, HEADER), parity) == camera


@pytest.mark.parametrize("lens", [
    Distortion("plumb_bob", (-0.1, 0.02, 1e-3, -2e-3, 0.003)),
    Distortion("rational_polynomial", (0.1, 0.2, 1e-3, 2e-3, 0.3, 0.4, 0.5, 0.6)),
    Distortion("rational_polynomial", (*(0.1,) * 8, 0.01, -0.02, 0.015, 0.005)),
    Distortion("rational_polynomial", (*(0.1,) * 8, 0.01, -0.02, 0.015, 0.005, 0.1, -0.06)),
    Distortion("equidistant", (0.01, -0.02, 0.003, -0.004)),
    Distortion("equidistant", (0.0, 0.0, 0.0, 0.0)),
])
def test_round_trip_of_distortion(lens):
    camera = Camera(640, 480, 2400.0, 2400.0, 320.0, 240.0, "normal", lens)
    assert camera_from_info(info_from_camera(camera, HEADER), "normal") == camera


def test_message_describes_an_unrectified_camera():
    message = info()
    assert message.header == HEADER
    np.testing.assert_array_equal(message.k, [2400, 0, 321.5, 0, 2410, 238.25, 0, 0, 1])
    np.testing.assert_array_equal(message.r, np.eye(3).ravel())
    np.testing.assert_array_equal(message.p, [2400, 0, 321.5, 0, 0, 2410, 238.25, 0, 0, 0, 1, 0])


def lens_of(model, coefficients):
    message = info(distortion_model=model, d=coefficients)
    return camera_from_info(message, "normal").distortion


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "", "none", "pinhole"])
def test_no_or_zero_coefficients_are_no_distortion(model):
    for coefficients in ([], [0.0] * 5, [0.0] * 14):
        assert lens_of(model, coefficients) is None


@pytest.mark.parametrize("coefficients", [[], [0.0], [0.0] * 4, [0.0] * 5])
def test_a_fisheye_without_coefficients_is_still_a_fisheye(coefficients):
    assert lens_of("equidistant", coefficients) == Distortion("equidistant", (0.0,) * 4)


@pytest.mark.parametrize(("names", "model"), [
    (("plumb_bob", "Plumb Bob", "brown_conrady", "Brown-Conrady", "radtan"), "plumb_bob"),
    (("rational_polynomial", "rational", "RATIONAL_POLYNOMIAL"), "rational_polynomial"),
    (("equidistant", "fisheye", "kannala_brandt", "equi", "opencv_fisheye"), "equidistant"),
])
def test_a_model_may_go_by_another_name(names, model):
    assert {lens_of(name, [0.01] * 4).model for name in names} == {model}


def test_short_coefficient_list_is_completed_with_zeros():
    given = [-0.1, 0.02, 0.001, 0.002]
    assert lens_of("plumb_bob", given) == Distortion("plumb_bob", (*given, 0.0))
    assert lens_of("rational_polynomial", given).coefficients == (*given, *[0.0] * 4)
    assert lens_of("equidistant", given[:2]).coefficients == (*given[:2], 0.0, 0.0)


@pytest.mark.parametrize(("model", "n", "zeros"), [
    ("plumb_bob", 5, 3), ("plumb_bob", 5, 9), ("rational_polynomial", 8, 4),
    ("rational_polynomial", 8, 6), ("rational_polynomial", 12, 2), ("rational_polynomial", 14, 6),
    ("equidistant", 4, 1), ("equidistant", 4, 10),
])
def test_zeros_at_the_end_of_the_list_change_nothing(model, n, zeros):
    assert lens_of(model, [0.01] * n + [0.0] * zeros) == Distortion(model, (0.01,) * n)


@pytest.mark.parametrize(("n", "length"), [(6, 8), (8, 8), (10, 12), (14, 14)])
def test_more_coefficients_than_plumb_bob_has_are_read_by_their_number(n, length):
    """As OpenCV does, so that whoever wrote the message has seen them work like that."""
    lens = lens_of("plumb_bob", [0.01] * n)
    expected = (*(0.01,) * n, *(0.0,) * (length - n))
    assert lens == Distortion("rational_polynomial", expected)


def test_equal_messages_give_the_same_camera():
    """What is found out about a camera is found out once, not with each message."""
    first, again = (camera_from_info(info(d=[-0.2]), "normal") for _ in range(2))
    assert again is first
    assert camera_from_info(info(d=[-0.3]), "normal") is not first


def test_a_region_of_interest_moves_the_principal_point():
    roi = RegionOfInterest(x_offset=100, y_offset=50, width=400, height=300)
    assert camera_from_info(info(roi=roi), "normal") == Camera(
        400, 300, 2400.0, 2410.0, 221.5, 188.25, "normal"
    )


def test_the_whole_image_may_be_given_as_the_region():
    roi = RegionOfInterest(width=640, height=480)
    assert camera_from_info(info(roi=roi), "normal") == CAMERA


def test_binning_scales_the_axes_each_by_its_own():
    message = info(binning_x=2, binning_y=4)
    assert camera_from_info(message, "normal") == Camera(
        320, 120, 1200.0, 602.5, 160.75, 59.5625, "normal"
    )


@pytest.mark.parametrize("n", [0, 1])
def test_binning_of_zero_or_one_is_none(n):
    assert camera_from_info(info(binning_x=n, binning_y=n), "normal") == CAMERA


def test_the_region_counts_in_pixels_before_binning():
    """REP 104's own numbers: 100 x 150 px at (25, 35) of a 2 x 2 binned image."""
    roi = RegionOfInterest(x_offset=50, y_offset=70, width=200, height=300)
    assert camera_from_info(info(roi=roi, binning_x=2, binning_y=2), "normal") == Camera(
        100, 150, 1200.0, 1205.0, (321.5 - 50) / 2, (238.25 - 70) / 2, "normal"
    )


def test_a_binned_image_has_no_part_of_a_pixel():
    camera = camera_from_info(info(binning_x=3, binning_y=7), "normal")
    assert (camera.width_px, camera.height_px) == (213, 68)


def projection(**changes):
    """A message whose P differs from K in all that counts."""
    p = [2000.0, 0.0, 300.5, -70.0, 0.0, 2010.0, 250.25, 0.0, 0.0, 0.0, 1.0, 0.0]
    return info(**{"p": p, "d": [-0.2, 0.1, 0.0, 0.0, 0.0], **changes})


def test_rectified_centroids_are_those_of_p_without_distortion():
    camera = camera_from_info(projection(), "normal", rectified=True)
    assert camera == Camera(640, 480, 2000.0, 2010.0, 300.5, 250.25, "normal")


def test_region_and_binning_hold_for_rectified_centroids_too():
    roi = RegionOfInterest(x_offset=100, y_offset=50, width=400, height=300)
    message = projection(roi=roi, binning_x=2, binning_y=2)
    camera = camera_from_info(message, "normal", rectified=True)
    assert camera == Camera(200, 150, 1000.0, 1005.0, 100.25, 100.125, "normal")


def test_the_fourth_column_of_p_does_not_matter():
    """Stars are too far away for the shift of a second camera, whatever its number."""
    p = projection().p
    p[3], p[7], p[11] = -300.0, float("nan"), 5.0
    plain = camera_from_info(projection(), "normal", rectified=True)
    assert camera_from_info(projection(p=p), "normal", rectified=True) == plain


def test_a_model_that_nobody_knows_does_not_matter_to_rectified_centroids():
    message = projection(distortion_model="fov")
    assert camera_from_info(message, "normal", rectified=True).distortion is None


TURN = Rotation.from_euler("xyz", (1.0, -2.0, 0.5), degrees=True).as_matrix().ravel()


def test_rectification_does_not_matter_to_raw_centroids():
    plain = camera_from_info(projection(), "normal")
    assert camera_from_info(projection(r=TURN), "normal") == plain


def test_rectified_centroids_of_a_camera_without_r_are_taken():
    camera = camera_from_info(projection(r=np.zeros(9)), "normal", rectified=True)
    assert camera.fx_px == 2000.0


@pytest.mark.parametrize("r", [TURN, np.full(9, np.nan), 2 * np.eye(3).ravel()])
def test_rectified_centroids_of_a_camera_that_is_turned_are_refused(r):
    with pytest.raises(MessageError) as refused:
        camera_from_info(projection(r=r), "normal", rectified=True)
    assert str(refused.value) == (
        "CameraInfo R turns the rectified image against the camera, so that its attitude would "
        "not be the camera's: send centroids of the raw image and unset rectified"
    )


@pytest.mark.parametrize(("p", "text"), [
    (np.zeros(12), (
        "CameraInfo: P is zero: the camera is not calibrated, calibrate it"
    )),
    (
        [2000.0, 0.1, 300.0, 0.0, 0.0, 2000.0, 200.0, *[0.0] * 3, 1.0, 0.0],
        "CameraInfo: P has a skew of 0.1: calibrate without skew",
    ),
    (
        [2000.0, *[0.0] * 4, 2000.0, 0.0, 0.0, 300.0, 200.0, 1.0, 0.0],
        "CameraInfo: P is not of the form fx 0 cx, 0 fy cy, 0 0 1: give it row by row",
    ),
])
def test_a_projection_that_cannot_be_used_is_refused(p, text):
    with pytest.raises(MessageError) as refused:
        camera_from_info(info(p=p), "normal", rectified=True)
    assert str(refused.value) == text
    assert camera_from_info(info(p=p), "normal") == CAMERA


@pytest.mark.parametrize(("last", "taken"), [
    ((0, 0, 1), True), ((0, 0, 0), True), ((0, 0, 2), False), ((321.5, 238.25, 1), False),
    ((float("nan"), 0, 1), False),
])
def test_k_is_given_row_by_row(last, taken):
    k = [2400.0, 0.0, 321.5, 0.0, 2410.0, 238.25, *map(float, last)]
    if taken:
        assert camera_from_info(info(k=k), "normal") == CAMERA
        return
    with pytest.raises(MessageError, match="K is not of the form fx 0 cx, 0 fy cy, 0 0 1: give"):
        camera_from_info(info(k=k), "normal")


def roi_of(x, y, width, height):
    return RegionOfInterest(x_offset=x, y_offset=y, width=width, height=height)


REACHES = "of 640 x 480 px: width, height, K and roi are of full resolution"


@pytest.mark.parametrize(("message", "text"), [
    (info(roi=roi_of(100, 50, 0, 0)), (
        "CameraInfo roi is 0 x 0 px at (100, 50): give its width and height, or 0 in all four for "
        "the full image"
    )),
    (info(roi=roi_of(0, 0, 640, 0)), (
        "CameraInfo roi is 640 x 0 px at (0, 0): give its width and height, or 0 in all four for "
        "the full image"
    )),
    (info(roi=roi_of(241, 0, 400, 300)), (
        f"CameraInfo roi of 400 x 300 px at (241, 0) reaches beyond the image {REACHES}"
    )),
    (info(roi=roi_of(0, 181, 400, 300)), (
        f"CameraInfo roi of 400 x 300 px at (0, 181) reaches beyond the image {REACHES}"
    )),
    (info(width=0, height=0, roi=roi_of(0, 0, 640, 480)), (
        "CameraInfo roi of 640 x 480 px at (0, 0) reaches beyond the image of 0 x 0 px: width, "
        "height, K and roi are of full resolution"
    )),
    (info(binning_x=641), (
        "CameraInfo binning of 641 x 1 leaves nothing of 640 x 480 px: "
        "binning_x and binning_y are numbers of pixels, 1 for none"
    )),
    (info(binning_y=2**32 - 1), (
        "CameraInfo binning of 1 x 4294967295 leaves nothing of 640 x 480 px: "
        "binning_x and binning_y are numbers of pixels, 1 for none"
    )),
    (info(distortion_model="fov", d=[0.0] * 5), (
        "CameraInfo: distortion_model 'fov' is not known: use plumb_bob, rational_polynomial, "
        "equidistant, or find the centroids in the rectified image"
    )),
    (info(distortion_model="none", d=[0.1]), (
        "CameraInfo: distortion_model 'none' is not known: use plumb_bob, rational_polynomial, "
        "equidistant, or find the centroids in the rectified image"
    )),
    (info(d=[0.1] * 15), (
        "CameraInfo: 15 distortion coefficients are given, but rational_polynomial takes 14 at "
        "most: "
        "those beyond must be 0"
    )),
    (info(distortion_model="fisheye", d=[0.1] * 5), (
        "CameraInfo: 5 distortion coefficients are given, but equidistant takes 4 at most: "
        "those beyond must be 0"
    )),
    (info(d=[*[0.0] * 12, 0.0, 2.0]), (
        "CameraInfo: the sensor's tilt, coefficients 13 and 14, must be below 90 deg"
    )),
    (info(d=[1e30] * 5), (
        "CameraInfo: the distortion has no ray for the middle of the image: "
        "check its coefficients and the principal point"
    )),
])
def test_what_cannot_be_honoured_is_refused_by_name(message, text):
    with pytest.raises(MessageError) as refused:
        camera_from_info(message, "normal")
    assert str(refused.value) == text


@pytest.mark.parametrize(("message", "text"), [
    (info(k=np.zeros(9)), r"K is zero: the camera is not calibrated"),
    (info_with_k(0, 0.0), r"K is zero"),
    (info_with_k(4, 0.0), r"K is zero"),
    (info_with_k(0, float("nan")), r"fx_px is not a finite number"),
    (info_with_k(4, float("inf")), r"fy_px is not a finite number"),
    (info_with_k(2, float("nan")), r"cx_px is not a finite number"),
    (info_with_k(5, float("-inf")), r"cy_px is not a finite number"),
    (info_with_k(1, 0.5), r"K has a skew of 0\.5"),
    (info_with_k(1, float("nan")), r"K has a skew of nan"),
    (info_with_k(0, -2400.0), r"focal length must be greater than 0"),
    (info_with_k(0, 10.0), r"field of view 176\.4 deg is outside of 0\.5 to 120 deg"),
    (info_with_k(0, 1e6), r"field of view 0\.03\d+ deg is outside of 0\.5 to 120 deg"),
    (info(width=0), r"image size 0 x 480 px is impossible"),
    (info(height=0), r"image size 640 x 0 px is impossible"),
    (info(distortion_model="", d=[0.1] * 5), r"distortion_model '' is not known"),
    (info(distortion_model="\x00" * 99), r"distortion_model '\\x00\\x00.*\.\.\. is not known"),
    (info(d=[float("nan")] * 5), r"distortion coefficients must be finite"),
    (info(d=[0.0, 0.0, 0.0, float("nan"), 0.0]), r"distortion coefficients must be finite"),
    (info(d=[0.1, float("inf")], distortion_model="fisheye"), r"coefficients must be finite"),
])
def test_impossible_camera_is_refused_with_the_reason(message, text):
    with pytest.raises(MessageError, match=text):
        camera_from_info(message, "normal")
