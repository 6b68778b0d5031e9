"""CameraInfo <-> Camera."""

import numpy as np
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from msg_adapters import MessageError
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

#: A shorter list of coefficients is completed with zeros: drivers leave out trailing ones.
_MODEL_LENGTH = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def camera_from_info(message: CameraInfo, parity: str) -> Camera:
    """Take the intrinsics K, the size and the distortion of unrectified images.

    CameraInfo says nothing of parity, so the caller does. Raises MessageError where K, the size
    or the distortion cannot belong to a camera.
    """
    fx, skew, cx, _, fy, cy, *_ = (float(value) for value in message.k)
    if skew != 0:
        raise MessageError(f"CameraInfo K has a skew of {skew:g}: calibrate without skew")
    if fx == 0 or fy == 0:
        raise MessageError("CameraInfo K is zero: the camera is not calibrated, calibrate it")
    try:
        camera = Camera(
            int(message.width), int(message.height), fx, fy, cx, cy, parity, _distortion(message)
        )
        # Found once for all frames: it fails where the distortion does not reach the corners.
        _ = camera.radius_rad
        return camera
    except ValueError as error:
        raise MessageError(f"CameraInfo: {error}") from error


def _distortion(message: CameraInfo) -> Distortion | None:
    coefficients = [float(value) for value in message.d]
    if not any(coefficients):
        return None
    model = str(message.distortion_model)
    missing = _MODEL_LENGTH.get(model, 0) - len(coefficients)
    return Distortion(model, (*coefficients, *[0.0] * max(0, missing)))


def info_from_camera(camera: Camera, header: Header) -> CameraInfo:
    """Describe a camera; its parity has no place in the message."""
    k = [camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0]
    p = np.zeros((3, 4))
    p[:, :3] = np.reshape(k, (3, 3))
    lens = camera.distortion
    return CameraInfo(
        header=header, width=int(camera.width_px), height=int(camera.height_px),
        distortion_model=lens.model if lens else "plumb_bob",
        d=list(lens.coefficients) if lens else [0.0] * 5,
        k=[float(value) for value in k], r=np.eye(3).ravel().tolist(), p=p.ravel().tolist(),
    )
