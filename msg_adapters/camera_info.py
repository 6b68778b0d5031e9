"""CameraInfo <-> Camera, as the message's definition and REP 104 say; docs/camera_info.md.

K, P and the region of interest count in pixels of the full resolution, which `width` and `height`
give. The image whose centroids come is the region, binned. The distortion models work on
normalised coordinates: region and binning leave them as they are.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.message_class import message_class
from star_tracker.optics.camera import Camera
from star_tracker.optics.intrinsics import read_distortion, read_intrinsics

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

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
    if rectified:
        name, matrix = "P", np.reshape(message.p, (3, 4))[:, :3]
    else:
        name, matrix = "K", np.reshape(message.k, (3, 3))
    try:
        fx, fy, cx, cy = read_intrinsics(name, matrix)
        lens = None if rectified else read_distortion(message.distortion_model, message.d)
    except ValueError as error:
        raise MessageError(f"CameraInfo: {error}") from error
    if rectified:
        _require_unturned(message.r)
    x, y, width, height = _region(message)
    bin_x, bin_y = max(1, int(message.binning_x)), max(1, int(message.binning_y))
    if 0 < width < bin_x or 0 < height < bin_y:
        raise MessageError(
            f"CameraInfo binning of {bin_x} x {bin_y} leaves nothing of {width} x {height} px: "
            "binning_x and binning_y are numbers of pixels, 1 for none"
        )
    try:
        return _usable(Camera(
            width // bin_x, height // bin_y, fx / bin_x, fy / bin_y, (cx - x) / bin_x,
            (cy - y) / bin_y, parity, lens,
        ))
    except ValueError as error:
        raise MessageError(f"CameraInfo: {error}") from error


@lru_cache(maxsize=_KEPT)
def _usable(camera: Camera) -> Camera:
    """Return the camera. Raises ValueError where its lens does not show the image's middle."""
    _ = camera.radius_rad
    return camera


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
