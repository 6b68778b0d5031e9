"""Intrinsics as ROS and OpenCV write them: K, and a distortion by its name.

`sensor_msgs/CameraInfo` and the files of `camera_calibration` have both in the same form.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.optics.distortion import MODELS, Distortion

#: Names under which the models go, compared in lower case and with `_` for `-` and blanks.
_NAMES = {
    "plumb_bob": "plumb_bob", "plumbbob": "plumb_bob", "brown": "plumb_bob",
    "brown_conrady": "plumb_bob", "radtan": "plumb_bob", "radial_tangential": "plumb_bob",
    "rational_polynomial": "rational_polynomial", "rational": "rational_polynomial",
    "full_opencv": "rational_polynomial",
    "equidistant": "equidistant", "equi": "equidistant", "fisheye": "equidistant",
    "opencv_fisheye": "equidistant", "kannala_brandt": "equidistant",
    "kannala_brandt4": "equidistant",
}
#: Names of a camera that has no distortion.
_NONE = ("", "none", "no_distortion", "undistorted", "rectified", "pinhole", "perspective")
#: Of a name that is not known, so many characters are told.
_LONGEST_NAME = 60


def read_intrinsics(name: str, matrix: ArrayLike) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a matrix (3, 3) of that name. Raises ValueError for another one."""
    (fx, skew, cx), (below, fy, cy), last = np.asarray(matrix, float).tolist()
    if skew != 0:
        raise ValueError(f"{name} has a skew of {skew:g}: calibrate without skew")
    if fx == 0 or fy == 0:
        raise ValueError(f"{name} is zero: the camera is not calibrated, calibrate it")
    # Some drivers leave the last 1 out.
    if below != 0 or last not in ([0, 0, 1], [0, 0, 0]):
        raise ValueError(
            f"{name} is not of the form fx 0 cx, 0 fy cy, 0 0 1: give it row by row"
        )
    return fx, fy, cx, cy


def read_distortion(name: str, values: Sequence[float]) -> Distortion | None:
    """Return the distortion of a model's name and coefficients, None where there is none.

    Zeros at the end of the list change nothing, and a list may be without them. Raises ValueError.
    """
    given = [float(value) for value in values]
    while given and given[-1] == 0:
        given.pop()
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    if plain in _NONE and not given:
        return None
    if plain not in _NAMES:
        more = "..." if len(name) > _LONGEST_NAME else ""
        raise ValueError(
            f"distortion_model {name[:_LONGEST_NAME]!a}{more} is not known: use "
            f"{', '.join(MODELS)}, or find the centroids in the rectified image"
        )
    model = _NAMES[plain]
    if model != "equidistant":
        if not given:
            return None
        # OpenCV, and all that builds on it, knows these two by the length of the list.
        if len(given) > max(MODELS["plumb_bob"]):
            model = "rational_polynomial"
    length = next((length for length in MODELS[model] if length >= len(given)), 0)
    if not length:
        raise ValueError(
            f"{len(given)} distortion coefficients are given, but {model} takes "
            f"{max(MODELS[model])} at most: those beyond must be 0"
        )
    return Distortion(model, (*given, *[0.0] * (length - len(given))))
