"""Detected stars <-> PointCloud2: what centroid_node publishes as `centroids`."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.centroids import Centroids
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.point_cloud import cloud_from_points, points_from_cloud
from star_tracker.optics.camera import PIXEL_ORIGINS

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

#: One point of `centroids`; the names are those of the topic's fields.
DETECTED_DTYPE = np.dtype([
    ("x", "<f8"), ("y", "<f8"), ("intensity", "<f4"), ("snr", "<f4"), ("peak", "<f4"),
    ("flags", "u1"),
], align=True)


def cloud_from_detected(
    stars: Centroids, header: "std_msgs.msg.Header", *, pixel_origin: str
) -> "sensor_msgs.msg.PointCloud2":
    """Write stars, the brightest first, as `DETECTED_DTYPE`.

    Args:
        stars: what was detected.
        header: that of the image.
        pixel_origin: where the message counts pixels from, of `PIXEL_ORIGINS`; the detector counts
            from the outer corner of the first one.
    """
    points = np.zeros(len(stars), DETECTED_DTYPE)
    points["x"] = stars.x_px - PIXEL_ORIGINS[pixel_origin]
    points["y"] = stars.y_px - PIXEL_ORIGINS[pixel_origin]
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite
        points["intensity"], points["snr"], points["peak"] = stars.flux, stars.snr, stars.peak
    points["flags"] = stars.flags
    return cloud_from_points(points, header)


def detected_from_cloud(message: "sensor_msgs.msg.PointCloud2") -> NDArray[np.void]:
    """Read the points of `centroids` as a structured array (n,) of `DETECTED_DTYPE`.

    Coordinates are as the message has them. Raises MessageError for another cloud.
    """
    points = points_from_cloud(message)
    stars = np.zeros(len(points), DETECTED_DTYPE)
    for name in DETECTED_DTYPE.names or ():
        if name not in (points.dtype.names or ()):
            raise MessageError(f"PointCloud2 has no field {name}")
        stars[name] = points[name]
    return stars
