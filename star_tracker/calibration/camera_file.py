"""A camera in the YAML file of ROS's camera_calibration, as `camera_info_manager` reads it.

Parity and tolerance, which ROS has no words for, stand under a key of our own. The file counts
pixels from the middle of the first one, as all of ROS does; a camera that is read or written here
counts them from its outer corner, as images are counted in this package.
"""

import math
from pathlib import Path
from typing import Any

from star_tracker.optics.camera import PARITIES, PIXEL_ORIGINS, Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.resources import write_whole

_OWN = "star_tracker"
_NO_LENS = ("plumb_bob", (0.0, 0.0, 0.0, 0.0, 0.0))


def write_camera(camera: Camera, path: Path, *, name: str = "camera") -> None:
    """Write a camera, counted from the outer corner, as a file in one step.

    Raises OSError where the place does not take it.
    """
    camera, lens = camera.moved(-PIXEL_ORIGINS["center"]), camera.distortion
    model, coefficients = _NO_LENS if lens is None else (lens.model, lens.coefficients)
    k = (camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0)
    p = (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)
    text = "\n".join([
        f"image_width: {camera.width_px}",
        f"image_height: {camera.height_px}",
        f"camera_name: {name}",
        *_matrix("camera_matrix", 3, 3, k),
        f"distortion_model: {model}",
        *_matrix("distortion_coefficients", 1, len(coefficients), coefficients),
        *_matrix("rectification_matrix", 3, 3, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)),
        *_matrix("projection_matrix", 3, 4, p),
        f"{_OWN}:",
        f"  parity: {camera.parity}",
        f"  tolerance_percent: {camera.tolerance_percent:.6g}",
    ])
    write_whole(path, text + "\n")


def read_camera(path: Path) -> Camera:
    """Return the camera of a file, counted from the outer corner.

    Without our own key the parity is `auto` and the tolerance 2 %.

    Raises ValueError with the file's name and what is wrong in it.
    """
    try:
        import yaml  # noqa: PLC0415  only this file needs it
    except ImportError as error:
        raise ValueError(
            f"camera file {path} needs PyYAML: apt install python3-yaml, or pip install PyYAML"
        ) from error
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"camera file {path} cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"camera file {path} is not YAML: {_line(error)}") from error
    try:
        return _camera(dict(content))
    except KeyError as error:
        raise ValueError(f"camera file {path} has no {error.args[0]}") from error
    except (TypeError, ValueError) as error:
        raise ValueError(f"camera file {path}: {_line(error)}") from error


def _camera(content: dict[str, Any]) -> Camera:
    k = [float(value) for value in content["camera_matrix"]["data"]]
    if len(k) != 9 or not all(math.isfinite(value) for value in k):
        raise ValueError("camera_matrix has not 9 finite numbers")
    coefficients = tuple(
        float(value) for value in content.get("distortion_coefficients", {}).get("data", ())
    )
    lens = None
    model = str(content.get("distortion_model", "plumb_bob"))
    if any(coefficients) or model == "equidistant":
        lens = Distortion(model, coefficients)
    own = content.get(_OWN, {})
    parity = str(own.get("parity", "auto"))
    if parity not in PARITIES:
        raise ValueError(f"parity {parity!r} is unknown: use {', '.join(PARITIES)}")
    return Camera(
        int(content["image_width"]), int(content["image_height"]), k[0], k[4], k[2], k[5],
        parity, lens, float(own.get("tolerance_percent", _AGED_PERCENT)),
    ).moved(PIXEL_ORIGINS["center"])


#: How far a calibration of unknown age may be off.
_AGED_PERCENT = 2.0


def _matrix(name: str, rows: int, columns: int, data: tuple[float, ...]) -> list[str]:
    values = ", ".join(repr(float(value)) for value in data)
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{values}]"]


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
