"""PointCloud2 <-> arrays: centroids of a frame, and identified stars."""

import array
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters import MessageError, shown
from star_tracker.msg_adapters.centroids import Centroids
from star_tracker.msg_adapters.message_class import message_class

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

    from star_tracker.catalogue.catalog import StarCatalog
    from star_tracker.identification.labels import Identification

#: The data types of PointField, INT8 to FLOAT64, as numpy names them.
_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
#: Fields that an error names as those there are.
_MOST_NAMED = 4
#: One row of `identified_stars`; the names are those of the topic's fields.
STAR_DTYPE = np.dtype([
    ("x", "<f4"), ("y", "<f4"), ("star_number", "<u4"), ("hip", "<u4"), ("ra_deg", "<f8"),
    ("dec_deg", "<f8"), ("magnitude", "<f4"), ("residual_px", "<f4"), ("state", "<u1"),
])


def centroids_from_cloud(
    message: "sensor_msgs.msg.PointCloud2", *, x: str = "x", y: str = "y",
    intensity: str | None = None,
) -> Centroids:
    """Read the coordinates of a cloud's points, pixels, and their intensity where it has one.

    Args:
        message: the cloud, of any height: its points are taken row by row. NaN passes.
        x, y: the fields of the coordinates, of any data type.
        intensity: the field of the brightness, larger = brighter. None for the field `intensity`,
            if there is one.

    Raises MessageError for a malformed cloud or one without the coordinates.
    """
    if message.width == 0 or message.height == 0:
        return Centroids(np.empty((0, 2)))
    points = points_from_cloud(message)
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        xy = np.column_stack([_column(points, x), _column(points, y)])
        if intensity is None and "intensity" not in (points.dtype.names or ()):
            return Centroids(xy)
        return Centroids(xy, _column(points, intensity or "intensity"))


def cloud_from_centroids(
    centroids: Centroids, header: "std_msgs.msg.Header"
) -> "sensor_msgs.msg.PointCloud2":
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
    identification: "Identification", xy_px: Floats, catalog: "StarCatalog",
    header: "std_msgs.msg.Header",
) -> "sensor_msgs.msg.PointCloud2":
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


def stars_from_cloud(message: "sensor_msgs.msg.PointCloud2") -> NDArray[np.void]:
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


def points_from_cloud(message: "sensor_msgs.msg.PointCloud2") -> NDArray[np.void]:
    """View a cloud, row by row, as a structured array (n,) with the cloud's own field names.

    Raises MessageError where sizes, offsets or data types do not agree with each other.
    """
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    row, n_bytes = width * step, len(message.data)
    row_step, text = row, f"width {width} x point_step {step} is {row}"
    if height != 1:
        # Some drivers leave the row's step at 0. Of a single row it tells nothing.
        row_step = int(message.row_step) or row
        text = f"height {height} x row_step {row_step} is {height * row_step}"
        if row_step < row:
            raise MessageError(
                f"PointCloud2 row_step {row_step} is less than width {width} x point_step {step}: "
                "make them agree"
            )
    if n_bytes != height * row_step:
        raise MessageError(f"PointCloud2 data has {n_bytes} bytes, but {text}: make them agree")
    if step == 0 and height * width > 0:
        raise MessageError("PointCloud2 has points, but point_step is 0: give their size in bytes")
    dtype = _layout(message)
    if n_bytes == 0:
        return np.empty(0, dtype)
    rows = np.ndarray((height, width), dtype, message.data, strides=(row_step, step))
    return rows.reshape(-1)


def _layout(message: "sensor_msgs.msg.PointCloud2") -> np.dtype:
    """Return the structured dtype that the fields of a cloud describe."""
    names = [field.name for field in message.fields]
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise MessageError(f"PointCloud2 names a field twice: {shown(twice)}")
    order = ">" if message.is_bigendian else "<"
    layout: dict[str, tuple[str, int]] = {}
    for field in message.fields:
        if field.datatype not in _FORMATS:
            raise MessageError(f"PointCloud2 field {shown(field.name)} has no valid datatype")
        form = order + _FORMATS[field.datatype]
        count = max(1, field.count)  # some writers leave the count of a single value at 0
        if field.offset + count * np.dtype(form).itemsize > message.point_step:
            raise MessageError(
                f"PointCloud2 field {shown(field.name)} at offset {field.offset} does not fit "
                f"into point_step {message.point_step}"
            )
        layout[field.name] = (form if count == 1 else f"{count}{form}", field.offset)
    return np.dtype({
        "names": list(layout),
        "formats": [form for form, _ in layout.values()],
        "offsets": [offset for _, offset in layout.values()],
        "itemsize": message.point_step,
    })


def cloud_from_points(
    points: NDArray[np.void], header: "std_msgs.msg.Header"
) -> "sensor_msgs.msg.PointCloud2":
    """Write a structured array (n,) of scalar fields as an unorganised cloud."""
    field_class = message_class("sensor_msgs/PointField")

    codes = {form: code for code, form in _FORMATS.items()}
    fields = [
        field_class(name=name, offset=int(offset), datatype=codes[dtype.str[1:]], count=1)
        for name, (dtype, offset, *_) in (points.dtype.fields or {}).items()
    ]
    step = points.dtype.itemsize
    dense = all(
        bool(np.all(np.isfinite(points[name]))) for name in (points.dtype.names or ())
    )
    return message_class("sensor_msgs/PointCloud2")(
        header=header, height=1, width=len(points), fields=fields, is_bigendian=False,
        point_step=step, row_step=step * len(points), data=array.array("B", points.tobytes()),
        is_dense=dense,
    )


def _require_one_value(points: NDArray[np.void], name: str) -> None:
    if points.dtype[name].shape:
        raise MessageError(f"PointCloud2 field {name} must hold one value for each point")


def _column(points: NDArray[np.void], name: str) -> Floats:
    """Return a field of one value for each point (n,) as float64."""
    names = points.dtype.names or ()
    if name not in names:
        others = ", ".join(map(shown, names[:_MOST_NAMED])) or "none"
        raise MessageError(
            f"PointCloud2 has no field {shown(name)}, its fields are {others}: "
            "rename it or name another"
        )
    _require_one_value(points, name)
    return np.asarray(points[name].astype(float))
