"""sky_image_node: its images are those of the attitude and the camera that it tells."""

import numpy as np
import pytest
from geometry_msgs.msg import QuaternionStamped
from processes import assert_ended_well, ended, running
from ros_helpers import open_bench, stamp_ns
from sensor_msgs.msg import CameraInfo, Image

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.detect import detect_stars
from star_tracker.geometry.rotation import boresight_of, rotation_matrix
from star_tracker.msg_adapters.attitude import array_from_quaternion
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.msg_adapters.image import picture_from_image
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.sky_image_node import SkyImageNode
from star_tracker.nodes.sky_parameters import (
    SIDEREAL_DEG_S,
    SKY_IMAGE_PARAMETERS,
    SkyImageParameters,
)

SKY = "star_tracker.nodes.sky_image_node"
SMALL = {"width_px": 320, "height_px": 240, "rate_hz": 50.0}


def frames(parameters, n=1):
    """The first images with their camera and truth: (image, info, truth) by stamp."""
    with open_bench() as bench:
        inboxes = [
            bench.inbox(Image, "image"), bench.inbox(CameraInfo, "camera_info"),
            bench.inbox(QuaternionStamped, "truth/attitude"),
        ]
        bench.start(SkyImageNode, {**SMALL, **parameters})

        def whole():
            return [
                tuple(inbox.at(stamp_ns(image.header))[0] for inbox in inboxes)
                for image in inboxes[0].messages
                if all(inbox.at(stamp_ns(image.header)) for inbox in inboxes)
            ]

        bench.until(lambda: len(whole()) >= n, "images with camera and truth")
        return whole()


@pytest.mark.parametrize("parameters", [
    {}, {"parity": "mirrored"}, {"encoding": "mono8"}, {"distortion": [-0.3, 0.1]},
    {"rate_deg_s": [0.0, 0.2, 0.0], "exposure_s": 0.1},
])
def test_the_stars_are_where_truth_and_camera_info_say(parameters):
    image, info, truth = frames(parameters)[0]
    assert (image.header, truth.header.frame_id) == (info.header, "icrs")
    picture = picture_from_image(image)
    assert image.encoding == parameters.get("encoding", "mono16")
    found = detect_stars(picture.pixels).xy_px - 0.5  # as CameraInfo counts
    camera = camera_from_info(info, parameters.get("parity", "normal"))
    assert (camera.distortion is None) == ("distortion" not in parameters)
    rotation = rotation_matrix(array_from_quaternion(truth))
    catalog = StarCatalog.hipparcos(limiting_magnitude=4.0, min_separation_deg=0.5)
    near = catalog.vectors[catalog.vectors @ rotation[:, 2] > np.cos(np.radians(9))]
    places = camera.pixels(near @ rotation)
    places = places[np.all((places > 5) & (places < (315, 235)), axis=1)]
    assert len(places) >= 5
    offsets = found[None] - places[:, None]
    nearest = np.argmin(np.sum(offsets**2, axis=2), axis=1)
    off = offsets[np.arange(len(places)), nearest]
    # A star is a few hundredths of a pixel off; half a pixel would be the wrong way of counting.
    assert np.abs(np.median(off, axis=0)).max() < 0.1


def test_the_sky_turns_with_the_earth():
    told = SkyImageParameters(ra_deg=350.0, dec_deg=20.0, roll_deg=30.0)
    for hours in (0.0, 6.0):
        rotation, rate = told.rotation_at(3600 * hours)
        turned = SIDEREAL_DEG_S * 3600 * hours
        ra, dec, roll = np.degrees(boresight_of(rotation))
        assert (ra, dec, roll) == pytest.approx(((350.0 + turned) % 360, 20.0, 30.0), abs=1e-9)
        # As seen from the camera the pole's direction stays where it is.
        np.testing.assert_allclose(rotation @ rate, [0, 0, SIDEREAL_DEG_S], atol=1e-12)


def test_a_positive_rate_about_the_boresight_lowers_the_roll():
    told = SkyImageParameters(
        ra_deg=10.0, dec_deg=-40.0, roll_deg=100.0, sidereal=False, rate_deg_s=(0.0, 0.0, 2.0)
    )
    rotation, rate = told.rotation_at(5.0)
    assert np.degrees(boresight_of(rotation)) == pytest.approx((10.0, -40.0, 90.0), abs=1e-9)
    assert rate.tolist() == [0.0, 0.0, 2.0]


def test_the_truth_moves_as_the_rate_says():
    some = frames({"rate_deg_s": [0.0, 0.0, 30.0], "sidereal": False}, n=3)
    (first, *_), last = some[0], some[-1]
    seconds = (stamp_ns(last[0].header) - stamp_ns(first.header)) / 1e9
    rolls = [
        np.degrees(boresight_of(rotation_matrix(array_from_quaternion(truth)))[2])
        for truth in (some[0][2], last[2])
    ]
    turned = (rolls[0] - rolls[1] + 180.0) % 360.0 - 180.0
    assert turned == pytest.approx(30.0 * seconds, abs=1e-6)


def test_equal_seeds_give_equal_noise_and_each_image_has_its_own():
    pixels = [
        picture_from_image(image).pixels for image, *_ in frames({"sidereal": False}, n=2)
    ]
    (again, *_), *_ = frames({"sidereal": False})
    np.testing.assert_array_equal(picture_from_image(again).pixels, pixels[0])
    assert not np.array_equal(pixels[0], pixels[1])


@pytest.mark.slow
@pytest.mark.parametrize("listens", [True, False])
def test_the_node_ends_after_the_last_of_count_images(listens):
    """Without a listener to camera_info it begins all the same, some seconds later."""
    with open_bench() as bench:
        inbox = bench.inbox(Image, "image")
        if listens:
            bench.inbox(CameraInfo, "camera_info")
        arguments = [
            "-p", "count:=3", "-p", "rate_hz:=50.0", "-p", "width_px:=64", "-p", "height_px:=48",
        ]
        with running(SKY, bench.namespace, arguments) as process:
            bench.until(lambda: len(inbox.messages) >= 3, "third image")
            code, messages = ended(process)
    assert_ended_well(code, messages)
    assert "3 images sent" in messages
    assert ("nobody listens to camera_info" in messages) is not listens
    assert len(inbox.messages) == 3


@pytest.mark.parametrize(("parameters", "text"), [
    ({"rate_deg_s": [1.0]}, "parameter rate_deg_s has 1 numbers: it must be 3"),
    ({"distortion": [1.0, 2.0, 3.0]}, "parameter distortion has 3 numbers: it must be 2"),
    ({"encoding": "rgb8"}, "parameter encoding is 'rgb8': it must be one of mono8, mono16"),
])
def test_what_cannot_be_used_is_refused_in_one_line(parameters, text):
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(SkyImageNode, parameters)
    assert str(caught.value) == text


def test_parameters_are_described_and_fixed():
    assert all(parameter.fixed and parameter.description for parameter in SKY_IMAGE_PARAMETERS)
