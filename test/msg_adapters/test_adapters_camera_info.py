"""CameraInfo <-> Camera."""

import numpy as np
import pytest
from std_msgs.msg import Header

from msg_adapters import MessageError
from msg_adapters.camera_info import camera_from_info, info_from_camera
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
    Distortion("equidistant", (0.01, -0.02, 0.003, -0.004)),
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


@pytest.mark.parametrize("model", ["plumb_bob", "", "a model of one's own"])
def test_no_or_zero_coefficients_are_no_distortion(model):
    for coefficients in ([], [0.0] * 5):
        message = info(distortion_model=model, d=coefficients)
        assert camera_from_info(message, "normal").distortion is None


def test_short_coefficient_list_is_completed_with_zeros():
    camera = camera_from_info(info(d=[-0.1, 0.02, 0.001, 0.002]), "normal")
    assert camera.distortion == Distortion("plumb_bob", (-0.1, 0.02, 0.001, 0.002, 0.0))


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
    (info(distortion_model="fisheye", d=[0.1] * 4), r"unknown distortion model 'fisheye'"),
    (info(distortion_model="", d=[0.1] * 5), r"unknown distortion model ''"),
    (info(d=[0.1] * 8), r"plumb_bob takes 5 coefficients, not 8"),
    (info(d=[float("nan")] * 5), r"distortion coefficients must be finite"),
])
def test_impossible_camera_is_refused_with_the_reason(message, text):
    with pytest.raises(MessageError, match=text):
        camera_from_info(message, "normal")
