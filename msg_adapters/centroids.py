"""Messages of detectors other than PointCloud2 -> the centroids of a frame.

Each is known by its fields alone: no class is imported, vision_msgs need not be installed.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from star_tracker.geometry.spherical import Floats

if TYPE_CHECKING:
    import geometry_msgs.msg
    import vision_msgs.msg


@dataclass(frozen=True)
class Centroids:
    """Centroids of one frame: pixels (n, 2) and, where given, intensities (n,)."""

    xy_px: Floats
    intensity: Floats | None = None


def centroids_from_detections(message: "vision_msgs.msg.Detection2DArray") -> Centroids:
    """Read the middles of the bounding boxes of a Detection2DArray, pixels.

    The score of a detection says how sure it is, not how bright: there is no intensity.
    """
    centers = [detection.bbox.center for detection in message.detections]
    # Up to vision_msgs 3 the middle was a Pose2D, which has the coordinates itself.
    return _of_points(getattr(center, "position", center) for center in centers)


def centroids_from_polygon(message: "geometry_msgs.msg.PolygonStamped") -> Centroids:
    """Read x and y of the points of a PolygonStamped, pixels; z does not count."""
    return _of_points(message.polygon.points)


def centroids_from_poses(message: "geometry_msgs.msg.PoseArray") -> Centroids:
    """Read x and y of the positions of a PoseArray, pixels; z and the orientation do not count."""
    return _of_points(pose.position for pose in message.poses)


def _of_points(points: Iterable[Any]) -> Centroids:
    pairs = [(float(point.x), float(point.y)) for point in points]
    return Centroids(np.array(pairs, float).reshape(-1, 2))
