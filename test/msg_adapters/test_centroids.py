"""Centroids out of messages that are known by their fields alone."""

from types import SimpleNamespace as Fields

import numpy as np
import pytest

from star_tracker.msg_adapters.centroids import (
    centroids_from_detections,
    centroids_from_polygon,
    centroids_from_poses,
)

XY = np.array([(1.5, 2.5), (300.25, 400.75), (511.0, 0.125)])


def polygon(xy):
    """A geometry_msgs/PolygonStamped."""
    return Fields(polygon=Fields(points=[Fields(x=x, y=y, z=7.0) for x, y in xy]))


def poses(xy):
    """A geometry_msgs/PoseArray."""
    return Fields(poses=[Fields(position=Fields(x=x, y=y, z=7.0)) for x, y in xy])


def detections(xy):
    """A vision_msgs/Detection2DArray as vision_msgs 4 has it: the middle is a pose of its own."""
    return Fields(detections=[
        Fields(bbox=Fields(center=Fields(position=Fields(x=x, y=y), theta=0.1), size_x=3.0))
        for x, y in xy
    ])


def older_detections(xy):
    """A vision_msgs/Detection2DArray up to version 3: the middle is a geometry_msgs/Pose2D."""
    return Fields(detections=[
        Fields(bbox=Fields(center=Fields(x=x, y=y, theta=0.1), size_x=3.0)) for x, y in xy
    ])


MESSAGES = [
    (centroids_from_polygon, polygon), (centroids_from_poses, poses),
    (centroids_from_detections, detections), (centroids_from_detections, older_detections),
]


@pytest.mark.parametrize(("read", "message"), MESSAGES)
@pytest.mark.parametrize("xy", [XY, XY[:1], XY[:0], XY * np.nan, XY * np.inf])
def test_each_point_is_a_centroid(read, message, xy):
    found = read(message(xy))
    np.testing.assert_array_equal(found.xy_px, xy)
    assert found.xy_px.shape == xy.shape
    assert found.xy_px.dtype == np.float64
    assert found.intensity is None


@pytest.mark.parametrize(("read", "message"), MESSAGES)
def test_integers_become_float64(read, message):
    assert read(message([(1, 2)])).xy_px.dtype == np.float64
