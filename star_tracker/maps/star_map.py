"""Star maps: files of labelled centroids with their camera.

The file format is CSV under a head of `# key: value` lines; `data/README.md` describes it. The
eight maps of the paper are shipped in it.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.resources import resource_path

STAR_MAPS_FOLDER = "data/star_maps"
PAPER_MAPS = (1, 2, 3, 4, 5, 6, 7, 8)
_COLUMNS = ("label", "x_px", "y_px", "star_number", "displaced_px")
_CAMERA_KEYS = ("width_px", "height_px", "fov_deg", "cx_px", "cy_px", "parity")
_POSE_KEYS = ("ra_deg", "dec_deg", "roll_deg")


@dataclass(frozen=True)
class Pose:
    """Boresight (ICRS) and roll, the position angle of the image's up direction; degrees."""

    ra_deg: float
    dec_deg: float
    roll_deg: float

    @property
    def rotation(self) -> Floats:
        """The rotation matrix (3, 3), camera to ICRS."""
        return rotation_from_boresight(*np.radians([self.ra_deg, self.dec_deg, self.roll_deg]))


@dataclass(frozen=True)
class StarMap:
    """One frame with what is known about it.

    Attributes:
        name: what reports call it.
        camera: its camera, of definite parity.
        labels: (n,) the centroids' names.
        xy_px: (n, 2) centroids.
        star_number: (n,) true star numbers, 0 = not known or none.
        displaced_px: (n,) how far a centroid was moved from its true place on purpose.
        pose: the true pose, where known.
    """

    name: str
    camera: Camera
    labels: tuple[str, ...]
    xy_px: Floats
    star_number: NDArray[np.int64]
    displaced_px: Floats
    pose: Pose | None = None


def paper_maps(numbers: tuple[int, ...] = PAPER_MAPS, folder: Path | None = None) -> list[StarMap]:
    """Return the paper's maps with these numbers from `folder`, by default the shipped ones.

    Raises ValueError for an unknown number or a damaged file.
    """
    unknown = [str(n) for n in numbers if n not in PAPER_MAPS]
    if unknown:
        raise ValueError(f"there is no map {', '.join(unknown)}: the maps are numbered 1 to 8")
    where = resource_path(STAR_MAPS_FOLDER) if folder is None else folder
    return [read_star_map(where / f"map{n}.csv") for n in numbers]


def read_star_map(path: Path) -> StarMap:
    """Read a star map file. Raises ValueError with the file's name and what is wrong in it."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"star map {path} cannot be read: {error}") from error
    keys = dict(_key_value(line[1:]) for line in lines if line.startswith("#") and ":" in line)
    try:
        body = list(
            csv.reader(line for line in lines if line.strip() and not line.startswith("#"))
        )
    except csv.Error as error:
        raise ValueError(f"star map {path}: not a table of numbers ({error})") from error
    if not body or tuple(body[0]) != _COLUMNS:
        raise ValueError(f"star map {path}: the columns must be {','.join(_COLUMNS)}")
    if any(len(row) != len(_COLUMNS) for row in body):
        raise ValueError(
            f"star map {path}: not a table of numbers (each row needs {len(_COLUMNS)} columns)"
        )
    try:
        values = np.array([row[1:] for row in body[1:]], float).reshape(-1, len(_COLUMNS) - 1)
    except ValueError as error:
        raise ValueError(f"star map {path}: not a table of numbers ({error})") from error
    if not np.all(np.isfinite(values)):
        raise ValueError(f"star map {path}: a value is not a finite number")
    if np.any(values[:, 2] != np.floor(values[:, 2])):
        raise ValueError(f"star map {path}: a star number is not a whole number")
    return StarMap(
        keys.get("name", path.stem), _camera(path, keys), tuple(row[0] for row in body[1:]),
        values[:, :2], values[:, 2].astype(np.int64), values[:, 3], _pose(path, keys),
    )


def write_star_map(star_map: StarMap, path: Path) -> None:
    """Write a star map file; coordinates are rounded to 0.01 px.

    Raises ValueError for a camera that the format has no words for.
    """
    camera = star_map.camera
    if camera.distortion is not None or camera.fx_px != camera.fy_px:
        raise ValueError("a star map's camera has square pixels and no distortion")
    lines = [
        "# star map, format 1",
        f"# name: {star_map.name}",
        f"# width_px: {camera.width_px}",
        f"# height_px: {camera.height_px}",
        f"# fov_deg: {camera.fov_deg:.10g}",
        f"# cx_px: {camera.cx_px:.10g}",
        f"# cy_px: {camera.cy_px:.10g}",
        f"# parity: {camera.parity}",
    ]
    if star_map.pose is not None:
        lines += [f"# {key}: {getattr(star_map.pose, key):.10g}" for key in _POSE_KEYS]
    lines.append(",".join(_COLUMNS))
    rows = zip(
        star_map.labels, star_map.xy_px, star_map.star_number, star_map.displaced_px, strict=True
    )
    for name, (x, y), number, displaced in rows:
        # Quoted where it must be; a # in front would make a remark of the row.
        plain = not set(name) & set(',"#\n')
        label = name if plain else '"' + name.replace('"', '""') + '"'
        lines.append(f"{label},{x:.2f},{y:.2f},{number},{displaced:.2f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _key_value(line: str) -> tuple[str, str]:
    key, _, value = line.partition(":")
    return key.strip(), value.strip()


def _numbers(path: Path, keys: dict[str, str], names: tuple[str, ...]) -> dict[str, float]:
    try:
        return {name: float(keys[name]) for name in names if name in keys}
    except ValueError as error:
        raise ValueError(f"star map {path}: a head line holds no number ({error})") from error


def _camera(path: Path, keys: dict[str, str]) -> Camera:
    missing = [name for name in ("width_px", "height_px", "fov_deg", "parity") if name not in keys]
    if missing:
        raise ValueError(f"star map {path}: the head has no line '# {missing[0]}: ...'")
    number = _numbers(path, keys, _CAMERA_KEYS[:-1])
    if keys["parity"] == "auto":
        raise ValueError(f"star map {path}: parity must be normal or mirrored, not auto")
    for name in ("width_px", "height_px"):
        if number[name] != np.floor(number[name]):
            raise ValueError(f"star map {path}: {name} must be a whole number")
    try:
        return Camera.from_fov(
            number["fov_deg"], int(number["width_px"]), int(number["height_px"]),
            parity=keys["parity"],
            principal_point_px=(number.get("cx_px"), number.get("cy_px")),
        )
    except (ValueError, OverflowError) as error:
        raise ValueError(f"star map {path}: {error}") from error


def _pose(path: Path, keys: dict[str, str]) -> Pose | None:
    number = _numbers(path, keys, _POSE_KEYS)
    if not number:
        return None
    if len(number) != len(_POSE_KEYS) or not np.all(np.isfinite(list(number.values()))):
        raise ValueError(f"star map {path}: a pose needs finite {', '.join(_POSE_KEYS)}")
    return Pose(**number)
