"""A pose of the camera, for compiled code: where it points, and its scale."""

from typing import Any

import numpy as np

from star_tracker.compiled import compiled, struct
from star_tracker.geometry.rotation import copy_rotation

#: rotation: (3, 3) camera to ICRS; scale: the focal length as a multiple of the camera's own;
#: free: whether the scale is fitted together with the rotation.
PoseType, Pose = struct("Pose", __name__, ("rotation", "scale", "free"))


@compiled
def identity_pose() -> Any:
    """Return a pose that turns nothing, with the camera's own focal length."""
    return Pose(np.eye(3), 1.0, False)


@compiled
def copy_pose(source: Any, target: Any) -> None:
    """Copy a pose into another."""
    copy_rotation(source.rotation, target.rotation)
    target.scale, target.free = source.scale, source.free
