"""The same out of the messages' own classes."""

import numpy as np
from geometry_msgs.msg import Point32, PolygonStamped, Pose, PoseArray

from star_tracker.msg_adapters.centroids import centroids_from_polygon, centroids_from_poses

XY = np.array([(1.5, 2.5), (300.25, 400.75)])


def test_polygon():
    message = PolygonStamped()
    message.polygon.points = [Point32(x=x, y=y) for x, y in XY]
    np.testing.assert_array_equal(centroids_from_polygon(message).xy_px, XY)


def test_poses():
    message = PoseArray()
    for x, y in XY:
        pose = Pose()
        pose.position.x, pose.position.y = x, y
        message.poses.append(pose)
    np.testing.assert_array_equal(centroids_from_poses(message).xy_px, XY)
