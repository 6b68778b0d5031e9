"""A camera in the YAML file of ROS's camera_calibration, as `camera_info_manager` reads it.

Parity and tolerance, which ROS has no words for, stand under a key of our own. The file counts
pixels from the middle of the first one, as all of ROS does; a camera that is read or written here
counts them from its outer corner, as images are counted in this package.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from star_tracker.optics.camera import PIXEL_ORIGINS, Camera
from star_tracker.optics.intrinsics import read_distortion, read_intrinsics
from star_tracker.resources import write_whole

_OWN = "star_tracker"
_NO_LENS = ("plumb_bob", (0.0, 0.0, 0.0, 0.0, 0.0))


def write_camera(camera: Camera, path: Path, *, name: str = "") -> None:
    """Write a camera, counted from the outer corner, as a file in one step.

    Without a name it keeps that of the file that is there. Raises OSError where the place does not
    take it.
    """
    name = name or _name_in(path) or "camera"
    camera, lens = camera.moved(-PIXEL_ORIGINS["center"]), camera.distortion
    model, coefficients = _NO_LENS if lens is None else (lens.model, lens.coefficients)
    k = (camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0)
    p = (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)
    text = "\n".join([
        f"image_width: {camera.width_px}",
        f"image_height: {camera.height_px}",
        f"camera_name: {json.dumps(name)}",  # as YAML reads it too, whatever is in it
        *_matrix("camera_matrix", 3, 3, k),
        f"distortion_model: {model}",
        *_matrix("distortion_coefficients", 1, len(coefficients), coefficients),
        *_matrix("rectification_matrix", 3, 3, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)),
        *_matrix("projection_matrix", 3, 4, p),
        f"{_OWN}:",
        f"  parity: {camera.parity}",
        f"  tolerance_percent: {float(camera.tolerance_percent)!r}",
    ])
    write_whole(path, text + "\n")


def _name_in(path: Path) -> str:
    """Return the camera's name in a file, empty where there is none."""
    try:
        content = _content(path)
    except ValueError:  # it is written anew
        return ""
    return str(content.get("camera_name", "")) if isinstance(content, dict) else ""


def read_camera(path: Path) -> Camera:
    """Return the camera of a file, counted from the outer corner.

    Without our own key the parity is `auto` and the tolerance 2 %.

    Raises ValueError with the file's name and what is wrong in it.
    """
    content = _content(path)
    try:
        return _camera(content)
    except KeyError as error:
        raise ValueError(f"camera file {path} has no {error.args[0]}") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"camera file {path}: {_line(error)}") from error


def _content(path: Path) -> Any:
    """Return what stands in a file. Raises ValueError where that cannot be read."""
    try:
        import yaml  # noqa: PLC0415  only this file needs it
    except ImportError as error:
        raise ValueError(
            f"camera file {path} needs PyYAML: apt install python3-yaml, or pip install PyYAML"
        ) from error
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"camera file {path} cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"camera file {path} is not YAML: {_line(error)}") from error


def _camera(content: Any) -> Camera:
    """Return the camera of what stands in a file. Raises KeyError for a key that is missing."""
    if not isinstance(content, dict):
        raise TypeError("it holds no camera: image_width, image_height, camera_matrix and so on")
    k = _numbers(content["camera_matrix"], "camera_matrix")
    if len(k) != 9:
        raise ValueError(f"camera_matrix has {len(k)} numbers, not 9")
    fx, fy, cx, cy = read_intrinsics("camera_matrix", np.reshape(k, (3, 3)))
    lens = read_distortion(
        str(content.get("distortion_model", "plumb_bob")),
        _numbers(content.get("distortion_coefficients"), "distortion_coefficients"),
    )
    own = content.get(_OWN) or {}
    if not isinstance(own, dict):
        raise TypeError(f"{_OWN} has parity and tolerance_percent below it, not {own!r}")
    return Camera(
        int(content["image_width"]), int(content["image_height"]), fx, fy, cx, cy,
        str(own.get("parity", "auto")), lens, float(own.get("tolerance_percent", _AGED_PERCENT)),
    ).moved(PIXEL_ORIGINS["center"])


def _numbers(matrix: Any, name: str) -> list[float]:
    """Return the numbers of a matrix with rows, cols and data, or of a plain list."""
    if matrix is None:
        return []
    data = matrix.get("data") if isinstance(matrix, dict) else matrix
    if not isinstance(data, list):
        raise TypeError(f"{name} has no list of numbers in its data")
    return [float(value) for value in data]


#: How far a calibration of unknown age may be off.
_AGED_PERCENT = 2.0


def _matrix(name: str, rows: int, columns: int, data: tuple[float, ...]) -> list[str]:
    values = ", ".join(repr(float(value)) for value in data)
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{values}]"]


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
