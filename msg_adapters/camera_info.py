"""CameraInfo <-> Camera, as the message's definition and REP 104 say; docs/camera_info.md.

K, P and the region of interest count in pixels of the full resolution, which `width` and `height`
give. The image whose centroids come is the region, binned. The distortion models work on
normalised coordinates: region and binning leave them as they are.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from star_tracker.msg_adapters import MessageError, shown
from star_tracker.msg_adapters.message_class import message_class
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import MODELS, Distortion

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

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
#: Largest element by which R may differ from the identity where it should be that: 0.2 arcsec.
_UNTURNED = 1e-6
#: Cameras that are kept, as most messages describe the same one again.
_KEPT = 64


def camera_from_info(
    message: "sensor_msgs.msg.CameraInfo", parity: str, *, rectified: bool = False
) -> Camera:
    """Return the camera of the image that a CameraInfo comes with.

    Args:
        message: intrinsics, size and distortion, region of interest and binning.
        parity: that of the image: CameraInfo says nothing of it.
        rectified: whether the centroids were found in the rectified image: P holds, and no
            distortion. Else in the raw one: K and the distortion hold, R and P do not matter.

    Equal messages give the same object. Raises MessageError for what cannot belong to a camera or
    cannot be honoured; the text names the field.
    """
    fx, fy, cx, cy = _intrinsics("P" if rectified else "K", message)
    if rectified:
        _require_unturned(message.r)
    x, y, width, height = _region(message)
    bin_x, bin_y = max(1, int(message.binning_x)), max(1, int(message.binning_y))
    if 0 < width < bin_x or 0 < height < bin_y:
        raise MessageError(
            f"CameraInfo binning of {bin_x} x {bin_y} leaves nothing of {width} x {height} px: "
            "binning_x and binning_y are numbers of pixels, 1 for none"
        )
    model = None if rectified else _model(message)
    try:
        return _usable(Camera(
            width // bin_x, height // bin_y, fx / bin_x, fy / bin_y, (cx - x) / bin_x,
            (cy - y) / bin_y, parity, Distortion(*model) if model else None,
        ))
    except ValueError as error:
        raise MessageError(f"CameraInfo: {error}") from error


@lru_cache(maxsize=_KEPT)
def _usable(camera: Camera) -> Camera:
    """Return the camera. Raises ValueError where its lens does not show the image's middle."""
    _ = camera.radius_rad
    return camera


def _intrinsics(
    name: str, message: "sensor_msgs.msg.CameraInfo"
) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of K, or of the left part of P."""
    numbers = np.asarray(message.k if name == "K" else message.p, float)
    matrix = numbers.reshape(3, 3) if name == "K" else numbers.reshape(3, 4)[:, :3]
    (fx, skew, cx), (below, fy, cy), last = matrix.tolist()
    if skew != 0:
        raise MessageError(f"CameraInfo {name} has a skew of {skew:g}: calibrate without skew")
    if fx == 0 or fy == 0:
        what = "calibrate it" if name == "K" else "rectified centroids need a calibrated one"
        raise MessageError(f"CameraInfo {name} is zero: the camera is not calibrated, {what}")
    # Some drivers leave the last 1 out.
    if below != 0 or last not in ([0, 0, 1], [0, 0, 0]):
        raise MessageError(
            f"CameraInfo {name} is not of the form fx 0 cx, 0 fy cy, 0 0 1: give it row by row"
        )
    return fx, fy, cx, cy


def _require_unturned(r: Sequence[float]) -> None:
    """Refuse rectified centroids where R, if it is given, is a rotation."""
    turn = np.asarray(r, float).reshape(3, 3)
    if turn.any() and not np.abs(turn - np.eye(3)).max() <= _UNTURNED:
        raise MessageError(
            "CameraInfo R turns the rectified image against the camera, so that its attitude "
            "would not be the camera's: send centroids of the raw image and unset rectified"
        )


def _region(message: "sensor_msgs.msg.CameraInfo") -> tuple[int, int, int, int]:
    """Return x, y, width and height of the region of interest, pixels of full resolution."""
    full_width, full_height = int(message.width), int(message.height)
    roi = message.roi
    x, y, width, height = (
        int(value) for value in (roi.x_offset, roi.y_offset, roi.width, roi.height)
    )
    if not any((x, y, width, height)):
        return 0, 0, full_width, full_height
    if width == 0 or height == 0:
        raise MessageError(
            f"CameraInfo roi is {width} x {height} px at ({x}, {y}): give its width and height, "
            "or 0 in all four for the full image"
        )
    if x + width > full_width or y + height > full_height:
        raise MessageError(
            f"CameraInfo roi of {width} x {height} px at ({x}, {y}) reaches beyond the image of "
            f"{full_width} x {full_height} px: width, height, K and roi are of full resolution"
        )
    return x, y, width, height


def _model(message: "sensor_msgs.msg.CameraInfo") -> tuple[str, tuple[float, ...]] | None:
    """Return the distortion's model and coefficients, None where there is none.

    Zeros at the end of the list change nothing, and a list may be without them.
    """
    given = [float(value) for value in message.d]
    while given and given[-1] == 0:
        given.pop()
    named = str(message.distortion_model)
    plain = named.strip().lower().replace("-", "_").replace(" ", "_")
    if plain in _NONE and not given:
        return None
    if plain not in _NAMES:
        raise MessageError(
            f"CameraInfo distortion_model {shown(named)} is not known: use "
            f"{', '.join(MODELS)}, or send rectified centroids and set rectified"
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
        raise MessageError(
            f"CameraInfo d holds {len(given)} coefficients, but {model} takes "
            f"{max(MODELS[model])} at most: those beyond must be 0"
        )
    return model, (*given, *[0.0] * (length - len(given)))


def info_from_camera(
    camera: Camera, header: "std_msgs.msg.Header"
) -> "sensor_msgs.msg.CameraInfo":
    """Describe a camera; its parity has no place in the message."""
    k = [camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0]
    p = np.zeros((3, 4))
    p[:, :3] = np.reshape(k, (3, 3))
    lens = camera.distortion
    return message_class("sensor_msgs/CameraInfo")(
        header=header, width=int(camera.width_px), height=int(camera.height_px),
        distortion_model=lens.model if lens else "plumb_bob",
        d=list(lens.coefficients) if lens else [0.0] * 5,
        k=[float(value) for value in k], r=np.eye(3).ravel().tolist(), p=p.ravel().tolist(),
    )
