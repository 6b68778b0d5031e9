"""Detected stars <-> the cloud of `centroids`, and where its pixels are counted from."""

import numpy as np
import pytest
from ros_helpers import new_header

from star_tracker.detection.centroids import Centroids, Flag, ImageQuality
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.detected_stars import cloud_from_detected, detected_from_cloud
from star_tracker.msg_adapters.point_cloud import Centroids as Points
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud, cloud_from_centroids

STARS = Centroids(
    np.array([0.5, 10.25]), np.array([0.5, 20.75]), np.array([900.0, 100.0]),
    np.array([80.0, 6.5]), np.array([200.0, 30.0]), np.array([1.0, 1.1]),
    np.array([Flag.SATURATED | Flag.EDGE, 0], np.uint8), ImageQuality(),
)


@pytest.mark.parametrize(("origin", "less"), [("center", 0.5), ("corner", 0.0)])
def test_there_and_back(origin, less):
    header = new_header("eye")
    cloud = cloud_from_detected(STARS, header, pixel_origin=origin)
    assert (cloud.header, cloud.height, cloud.width) == (header, 1, 2)
    stars = detected_from_cloud(cloud)
    np.testing.assert_array_equal(stars["x"], STARS.x_px - less)
    np.testing.assert_array_equal(stars["y"], STARS.y_px - less)
    for name, values in (("intensity", STARS.flux), ("snr", STARS.snr), ("peak", STARS.peak),
                         ("flags", STARS.flags)):
        np.testing.assert_array_equal(stars[name], values)


def test_a_star_on_the_middle_of_the_first_pixel_is_at_zero_as_camera_info_counts():
    read = centroids_from_cloud(cloud_from_detected(STARS, new_header(), pixel_origin="center"))
    assert read.xy_px[0].tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(read.intensity, STARS.flux)


def test_no_stars_are_a_cloud_without_points():
    none = Centroids.none(ImageQuality())
    cloud = cloud_from_detected(none, new_header(), pixel_origin="center")
    assert len(detected_from_cloud(cloud)) == 0


def test_a_cloud_of_another_detector_is_refused():
    with pytest.raises(MessageError, match="PointCloud2 has no field intensity"):
        detected_from_cloud(cloud_from_centroids(Points(np.ones((1, 2))), new_header()))
