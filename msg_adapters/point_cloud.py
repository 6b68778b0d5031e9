"""PointCloud2 <-> arrays: centroids of a frame, and identified stars."""

import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from msg_adapters import MessageError
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import Identification

_FORMATS = {
    PointField.INT8: "i1", PointField.UINT8: "u1", PointField.INT16: "i2", PointField.UINT16: "u2",
    PointField.INT32: "i4", PointField.UINT32: "u4", PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
_COORDINATES = (PointField.FLOAT32, PointField.FLOAT64)
#: Characters of a field's name that are shown in an error.
_LONGEST_NAME = 40
#: One row of `identified_stars`; the names are those of the topic's fields.
STAR_DTYPE = np.dtype([
    ("x", "<f4"), ("y", "<f4"), ("star_number", "<u4"), ("hip", "<u4"), ("ra_deg", "<f8"),
    ("dec_deg", "<f8"), ("magnitude", "<f4"), ("residual_px", "<f4"), ("state", "<u1"),
])


@dataclass(frozen=True)
class Centroids:
    """Centroids of one frame: pixels (n, 2) and, where given, intensities (n,)."""

    xy_px: Floats
    intensity: Floats | None = None


def centroids_from_cloud(message: PointCloud2) -> Centroids:
    """Read fields x, y and, where present, intensity. Raises MessageError if malformed."""
    if message.width == 0 or message.height == 0:
        return Centroids(np.empty((0, 2)))
    points = points_from_cloud(message)
    for name in ("x", "y"):
        _require_coordinate(message, name)
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        xy = np.column_stack([points["x"].astype(float), points["y"].astype(float)])
        if "intensity" not in (points.dtype.names or ()):
            return Centroids(xy)
        _require_one_value(points, "intensity")
        return Centroids(xy, points["intensity"].astype(float))


def cloud_from_centroids(centroids: Centroids, header: Header) -> PointCloud2:
    """Write x, y (float64) and, where given, intensity (float32)."""
    fields = [("x", "<f8"), ("y", "<f8")]
    if centroids.intensity is not None:
        fields.append(("intensity", "<f4"))
    points = np.zeros(len(centroids.xy_px), fields)
    points["x"], points["y"] = centroids.xy_px[:, 0], centroids.xy_px[:, 1]
    if centroids.intensity is not None:
        points["intensity"] = centroids.intensity
    return cloud_from_points(points, header)


def cloud_from_identification(
    identification: Identification, xy_px: Floats, catalog: StarCatalog, header: Header
) -> PointCloud2:
    """Write one point for each centroid, in input order, as `STAR_DTYPE` (0 or NaN = none)."""
    stars = np.zeros(len(xy_px), STAR_DTYPE)
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite
        stars["x"], stars["y"] = xy_px[:, 0], xy_px[:, 1]
    stars["state"] = identification.state
    stars["residual_px"] = identification.residual_px
    for name in ("ra_deg", "dec_deg", "magnitude"):
        stars[name] = np.nan
    known = np.flatnonzero(identification.catalog_index >= 0)
    index = identification.catalog_index[known]
    ra, dec = catalog.ra_dec_rad
    stars["star_number"][known] = catalog.number[index]
    stars["hip"][known] = catalog.hip[index]
    stars["ra_deg"][known], stars["dec_deg"][known] = np.degrees(ra[index]), np.degrees(dec[index])
    stars["magnitude"][known] = catalog.v_mag[index]
    return cloud_from_points(stars, header)


def stars_from_cloud(message: PointCloud2) -> NDArray[np.void]:
    """Read `identified_stars` as a structured array of `STAR_DTYPE`."""
    points = points_from_cloud(message)
    missing = set(STAR_DTYPE.names or ()) - set(points.dtype.names or ())
    if missing:
        raise MessageError(f"PointCloud2 has no field {sorted(missing)[0]}")
    stars = np.zeros(len(points), STAR_DTYPE)
    for name in STAR_DTYPE.names or ():
        _require_one_value(points, name)
        stars[name] = points[name]
    return stars


def points_from_cloud(message: PointCloud2) -> NDArray[np.void]:
    """View a cloud of height 1 as a structured array (n,) with the cloud's own field names.

    Raises MessageError where sizes, offsets or data types do not agree with each other.
    """
    if message.height != 1 and message.width > 0:
        raise MessageError(f"PointCloud2 height is {message.height}: a frame has height 1")
    expected = message.width * message.point_step
    if (message.point_step == 0 and message.width > 0) or len(message.data) != expected:
        raise MessageError(
            f"PointCloud2 data has {len(message.data)} bytes, but width {message.width} x "
            f"point_step {message.point_step} is {expected}: make them agree"
        )
    return np.frombuffer(message.data, _layout(message))


def _layout(message: PointCloud2) -> np.dtype:
    """Return the structured dtype that the fields of a cloud describe."""
    names = [field.name for field in message.fields]
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise MessageError(f"PointCloud2 names a field twice: {_shown(twice)}")
    order = ">" if message.is_bigendian else "<"
    layout: dict[str, tuple[str, int]] = {}
    for field in message.fields:
        if field.datatype not in _FORMATS:
            raise MessageError(f"PointCloud2 field {_shown(field.name)} has no valid datatype")
        form = order + _FORMATS[field.datatype]
        count = max(1, field.count)  # some writers leave the count of a single value at 0
        if field.offset + count * np.dtype(form).itemsize > message.point_step:
            raise MessageError(
                f"PointCloud2 field {_shown(field.name)} at offset {field.offset} does not fit "
                f"into point_step {message.point_step}"
            )
        layout[field.name] = (form if count == 1 else f"{count}{form}", field.offset)
    return np.dtype({
        "names": list(layout),
        "formats": [form for form, _ in layout.values()],
        "offsets": [offset for _, offset in layout.values()],
        "itemsize": message.point_step,
    })


def _shown(name: str) -> str:
    """Return a field's name as it can stand in a log: printable and not too long."""
    text = name if name.isprintable() and name else ascii(name)
    return text if len(text) <= _LONGEST_NAME else f"{text[:_LONGEST_NAME]}..."


def cloud_from_points(points: NDArray[np.void], header: Header) -> PointCloud2:
    """Write a structured array (n,) of scalar fields as an unorganised cloud."""
    codes = {form: code for code, form in _FORMATS.items()}
    fields = [
        PointField(name=name, offset=int(offset), datatype=codes[dtype.str[1:]], count=1)
        for name, (dtype, offset, *_) in (points.dtype.fields or {}).items()
    ]
    step = points.dtype.itemsize
    dense = all(
        bool(np.all(np.isfinite(points[name]))) for name in (points.dtype.names or ())
    )
    return PointCloud2(
        header=header, height=1, width=len(points), fields=fields, is_bigendian=False,
        point_step=step, row_step=step * len(points), data=array.array("B", points.tobytes()),
        is_dense=dense,
    )


def _require_one_value(points: NDArray[np.void], name: str) -> None:
    if points.dtype[name].shape:
        raise MessageError(f"PointCloud2 field {name} must hold one value for each point")


def _require_coordinate(message: PointCloud2, name: str) -> None:
    field = next((field for field in message.fields if field.name == name), None)
    if field is None:
        raise MessageError(f"PointCloud2 has no field {name}: centroids need fields x and y")
    if field.datatype not in _COORDINATES or field.count not in (0, 1):
        raise MessageError(f"PointCloud2 field {name} must be one FLOAT32 or FLOAT64 value (px)")
