"""PointCloud2 <-> centroids and identified stars."""

import array
import re

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.identification.labels import Identification, StarState
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.point_cloud import (
    STAR_DTYPE,
    Centroids,
    centroids_from_cloud,
    cloud_from_centroids,
    cloud_from_identification,
    cloud_from_points,
    points_from_cloud,
    stars_from_cloud,
)

HEADER = Header(frame_id="camera")
HEADER.stamp.sec, HEADER.stamp.nanosec = 9, 8
XY = np.array([[1.5, 2.5], [300.25, 400.75], [511.0, 0.125]])
F4, F8 = PointField.FLOAT32, PointField.FLOAT64


def field(name, offset, datatype=F4, count=1):
    return PointField(name=name, offset=offset, datatype=datatype, count=count)


def cloud(fields, data, point_step, width, **changes):
    """A cloud with every part given, right or wrong."""
    return PointCloud2(**{
        "header": HEADER, "height": 1, "width": width, "fields": fields, "point_step": point_step,
        "row_step": point_step * width, "data": array.array("B", data), **changes,
    })


def cloud_of(dtype, **columns):
    """A well-formed cloud whose layout is that of a numpy structured type."""
    points = np.zeros(len(XY), dtype)
    points["x"], points["y"] = XY[:, 0], XY[:, 1]
    for name, values in columns.items():
        points[name] = values
    return cloud_from_points(points, HEADER)


def xy_cloud(**changes):
    """A well-formed cloud of float32 x and y, then changed."""
    data = XY.astype("<f4").tobytes()
    message = cloud([field("x", 0), field("y", 4)], data, 8, len(XY))
    for name, value in changes.items():
        setattr(message, name, value)
    return message


# ---- centroids: what is read -----------------------------------------------------------------


def test_centroids_round_trip():
    back = centroids_from_cloud(cloud_from_centroids(Centroids(XY), HEADER))
    np.testing.assert_array_equal(back.xy_px, XY)
    assert back.intensity is None


def test_intensity_round_trip():
    intensity = np.array([10.0, 0.5, 3.25])
    back = centroids_from_cloud(cloud_from_centroids(Centroids(XY, intensity), HEADER))
    np.testing.assert_array_equal(back.intensity, intensity)


def test_written_cloud_is_complete():
    message = cloud_from_centroids(Centroids(XY, np.ones(3)), HEADER)
    assert message.header == HEADER
    assert (message.height, message.width) == (1, 3)
    assert (message.point_step, message.row_step, len(message.data)) == (20, 60, 60)
    assert [f.name for f in message.fields] == ["x", "y", "intensity"]
    assert not message.is_bigendian


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("form", ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"])
def test_x_and_y_may_be_any_number(form, big_endian):
    xy = np.array([(1, 127), (100, 2), (0, 55)], f"{'>' if big_endian else '<'}{form}")
    types = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    size = xy.dtype.itemsize
    message = cloud(
        [field("x", 0, types[form]), field("y", size, types[form])], xy.tobytes(), 2 * size, 3,
        is_bigendian=big_endian,
    )
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, xy.astype(float))


def test_largest_integers_are_exact():
    xy = np.array([(2**32 - 1, 2**31)], "<u4")
    fields = [field("x", 0, PointField.UINT32), field("y", 4, PointField.UINT32)]
    message = cloud(fields, xy.tobytes(), 8, 1)
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, [(2.0**32 - 1, 2.0**31)])


def test_coordinates_may_go_by_other_names():
    fields = [field("u", 0), field("v", 4), field("flux", 8), field("x", 12)]
    data = np.array([(1.5, 2.5, 7, 9), (3, 4, 8, 9)], "<f4")
    message = cloud(fields, data.tobytes(), 16, 2)
    found = centroids_from_cloud(message, x="u", y="v", intensity="flux")
    np.testing.assert_array_equal(found.xy_px, data[:, :2])
    np.testing.assert_array_equal(found.intensity, [7, 8])
    assert centroids_from_cloud(message, x="u", y="v").intensity is None


def test_an_intensity_that_is_named_has_to_be_there():
    text = r"^PointCloud2 has no field flux, its fields are x, y: rename it or name another$"
    with pytest.raises(MessageError, match=text):
        centroids_from_cloud(xy_cloud(), intensity="flux")


# ---- organised clouds ------------------------------------------------------------------------

GRID = np.arange(24.0).reshape(3, 4, 2)


def organised(grid, **changes):
    """A cloud of the height and width of an array (height, width, 2)."""
    height, width, _ = grid.shape
    return xy_cloud(**{
        "height": height, "width": width, "row_step": 8 * width,
        "data": array.array("B", grid.astype("<f4").tobytes()), **changes,
    })


@pytest.mark.parametrize("shape", [(3, 4), (12, 1), (1, 12)])
def test_points_of_an_organised_cloud_come_row_by_row(shape):
    message = organised(GRID.reshape(*shape, 2))
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, GRID.reshape(-1, 2))


def test_rows_may_be_padded():
    rows = [row.astype("<f4").tobytes() + b"\xff" * 12 for row in GRID]
    message = organised(GRID, row_step=44, data=array.array("B", b"".join(rows)))
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, GRID.reshape(-1, 2))


@pytest.mark.parametrize("height", [1, 3])
def test_row_step_zero_means_rows_without_padding(height):
    message = organised(GRID[:height], row_step=0)
    np.testing.assert_array_equal(
        centroids_from_cloud(message).xy_px, GRID[:height].reshape(-1, 2)
    )


@pytest.mark.parametrize("row_step", [8, 32, 999])
def test_the_row_step_of_a_single_row_tells_nothing(row_step):
    message = organised(GRID[:1], row_step=row_step)
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, GRID[0])


def test_points_behind_the_end_of_a_single_row_are_not_taken_for_padding():
    text = r"data has 32 bytes, but width 3 x point_step 8 is 24: make them agree$"
    with pytest.raises(MessageError, match=text):
        centroids_from_cloud(organised(GRID[:1], width=3, row_step=32))


def test_places_without_a_point_in_an_organised_cloud_stay_nan():
    """Each centroid keeps its row: the frame leaves them out and counts them."""
    grid = GRID.copy()
    grid[1] = np.nan
    found = centroids_from_cloud(organised(grid, is_dense=False)).xy_px
    np.testing.assert_array_equal(found, grid.reshape(-1, 2))


@pytest.mark.parametrize(("changes", "text"), [
    ({"row_step": 16}, "row_step 16 is less than width 4 x point_step 8: make them agree"),
    ({"row_step": 40}, "data has 96 bytes, but height 3 x row_step 40 is 120: make them agree"),
    ({"height": 2}, "data has 96 bytes, but height 2 x row_step 32 is 64: make them agree"),
    (
        {"height": 2**32 - 1, "width": 2**32 - 1, "row_step": 0},
        f"data has 96 bytes, but height {2**32 - 1} x row_step {8 * (2**32 - 1)} is "
        f"{8 * (2**32 - 1) ** 2}: make them agree",
    ),
    (
        {"point_step": 0, "row_step": 0, "data": array.array("B")},
        "PointCloud2 has points, but point_step is 0: give their size in bytes",
    ),
])
def test_organised_cloud_whose_sizes_disagree_is_refused(changes, text):
    with pytest.raises(MessageError, match=f"{re.escape(text)}$"):
        centroids_from_cloud(organised(GRID, **changes))


@pytest.mark.parametrize("form", ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"])
def test_intensity_may_be_any_number(form):
    message = cloud_of([("x", "f4"), ("y", "f4"), ("intensity", form)], intensity=[7, 0, 100])
    np.testing.assert_array_equal(centroids_from_cloud(message).intensity, [7.0, 0.0, 100.0])


def test_coordinates_are_float64():
    assert centroids_from_cloud(xy_cloud()).xy_px.dtype == np.float64


def test_big_endian_cloud():
    message = xy_cloud(is_bigendian=True)
    message.data = array.array("B", XY.astype(">f4").tobytes())
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


def test_fields_may_come_in_any_order():
    message = cloud_of([("y", "f8"), ("intensity", "f4"), ("x", "f4")], intensity=[1, 2, 3])
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


def test_field_order_may_differ_from_offset_order():
    message = xy_cloud()
    message.fields = list(reversed(message.fields))
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


def test_extra_fields_are_ignored():
    message = cloud_of([("ring", "u2"), ("x", "f4"), ("z", "f8"), ("y", "f4"), ("rgb", "u4")])
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


def test_extra_field_of_several_values_is_ignored():
    fields = [field("x", 0), field("descriptor", 4, F4, 8), field("y", 36)]
    data = np.zeros((len(XY), 10), "<f4")
    data[:, 0], data[:, 9] = XY.T
    message = cloud(fields, data.tobytes(), 40, len(XY))
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


def test_padding_is_ignored():
    message = cloud_of(np.dtype({
        "names": ["x", "y"], "formats": ["f4", "f8"], "offsets": [4, 24], "itemsize": 48,
    }))
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


def test_count_zero_means_one_as_older_drivers_write_it():
    message = xy_cloud()
    for f in message.fields:
        f.count = 0
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, XY)


@pytest.mark.parametrize("message", [
    PointCloud2(),
    PointCloud2(height=1),
    cloud([field("x", 0), field("y", 4)], b"", 8, 0),
    cloud_from_centroids(Centroids(np.empty((0, 2))), HEADER),
])
def test_no_points_are_an_empty_frame(message):
    assert centroids_from_cloud(message).xy_px.shape == (0, 2)


def test_values_that_are_not_finite_pass():
    xy = np.array([[np.nan, 1.0], [np.inf, -np.inf], [1e30, 2.0]])
    message = cloud_from_centroids(Centroids(xy), HEADER)
    np.testing.assert_array_equal(centroids_from_cloud(message).xy_px, xy)


def test_is_dense_says_whether_all_values_are_finite():
    assert cloud_from_centroids(Centroids(XY), HEADER).is_dense
    assert not cloud_from_centroids(Centroids(XY * np.nan), HEADER).is_dense


# ---- centroids: what is refused --------------------------------------------------------------


def with_field(index, **changes):
    message = xy_cloud()
    for name, value in changes.items():
        setattr(message.fields[index], name, value)
    return message


@pytest.mark.parametrize(("message", "text"), [
    (with_field(0, name="u"), "has no field x, its fields are u, y: rename it or name another"),
    (with_field(1, name="v"), "has no field y, its fields are x, v: rename it or name another"),
    (with_field(1, name="Y"), "has no field y"),
    (with_field(0, count=2), "field x must hold one value for each point"),
    (with_field(0, datatype=0), "field x has no valid datatype"),
    (with_field(1, datatype=9), "field y has no valid datatype"),
    (with_field(1, datatype=F8), "field y at offset 4 does not fit into point_step 8"),
    (with_field(1, offset=5), "field y at offset 5 does not fit into point_step 8"),
    (with_field(1, offset=2**32 - 1), "field y at offset 4294967295 does not fit"),
    (with_field(1, count=2), "field y at offset 4 does not fit into point_step 8"),
    (with_field(1, name="x"), "names a field twice: x"),
    (xy_cloud(point_step=12), r"data has 24 bytes, but width 3 x point_step 12 is 36"),
    (xy_cloud(point_step=4), r"data has 24 bytes, but width 3 x point_step 4 is 12"),
    (xy_cloud(point_step=0), r"data has 24 bytes, but width 3 x point_step 0 is 0"),
    (xy_cloud(width=4), r"data has 24 bytes, but width 4 x point_step 8 is 32"),
    (xy_cloud(width=2**32 - 1), r"data has 24 bytes, but width 4294967295"),
    (xy_cloud(data=array.array("B")), r"data has 0 bytes, but width 3 x point_step 8 is 24"),
    (xy_cloud(fields=[]), "has no field x, its fields are none"),
])
def test_malformed_cloud_is_refused_with_the_reason(message, text):
    with pytest.raises(MessageError, match=text):
        centroids_from_cloud(message)


@pytest.mark.parametrize("count", [2**29, 2**32 - 1])
def test_field_longer_than_any_point_is_refused(count):
    with pytest.raises(MessageError, match="field y at offset 4 does not fit into point_step 8"):
        centroids_from_cloud(with_field(1, count=count))


def test_intensity_of_several_values_is_refused():
    fields = [field("x", 0), field("y", 4), field("intensity", 8, F4, 2)]
    with pytest.raises(MessageError, match="intensity"):
        centroids_from_cloud(cloud(fields, bytes(48), 16, 3))


def random_cloud(rng):
    """A cloud of random layout, often well-formed in some parts, seldom in all."""
    height = int(rng.choice([0, 1, 1, 1, 2]))
    names = ["x", "y", "intensity", "x", "y", "z", ""]
    fields = [
        field(
            str(rng.choice(names)), int(rng.choice([0, 4, 8, 12, 17, 2**32 - 1])),
            int(rng.choice([0, 2, 4, 7, 7, 7, 8, 9, 255])),
            int(rng.choice([0, 1, 1, 1, 2, 3, 2**29, 2**32 - 1])),
        )
        for _ in range(rng.integers(0, 4))
    ]
    if rng.random() < 0.5:
        fields = [field("x", 0), field("y", 4), *fields]
    width, step = int(rng.integers(0, 4)), int(rng.choice([0, 8, 16, 24, 24]))
    size = height * width * step if rng.random() < 0.9 else int(rng.integers(0, 50))
    return cloud(
        fields, rng.bytes(size), step, width, height=height,
        is_bigendian=bool(rng.integers(2)),
    )


def test_random_layouts_give_arrays_or_a_message_error_and_nothing_else():
    rng = np.random.default_rng(1)
    n_read = n_refused = 0
    for _ in range(2000):
        message = random_cloud(rng)
        try:
            centroids = centroids_from_cloud(message)
        except MessageError:
            n_refused += 1
            continue
        n_read += 1
        n = message.width * message.height
        assert centroids.xy_px.shape == (n, 2), message
        assert centroids.intensity is None or centroids.intensity.shape == (n,), message
    assert n_read > 100
    assert n_refused > 100


# ---- any cloud, and identified stars ---------------------------------------------------------


def test_points_keep_their_types():
    points = np.zeros(2, [("a", "<i2"), ("b", "<f8"), ("c", "<u1")])
    points["a"], points["b"], points["c"] = [-5, 7], [0.1, 1e300], [255, 0]
    np.testing.assert_array_equal(points_from_cloud(cloud_from_points(points, HEADER)), points)


def test_identified_stars_round_trip():
    stars = np.zeros(2, STAR_DTYPE)
    for i, name in enumerate(STAR_DTYPE.names):
        stars[name] = [i, i + 1]
    np.testing.assert_array_equal(stars_from_cloud(cloud_from_points(stars, HEADER)), stars)


def test_identified_stars_of_an_empty_frame_round_trip():
    message = cloud_from_points(np.zeros(0, STAR_DTYPE), HEADER)
    stars = stars_from_cloud(message)
    assert len(stars) == 0
    assert stars.dtype == STAR_DTYPE


@pytest.mark.parametrize("name", STAR_DTYPE.names)
def test_identified_stars_without_a_field_are_refused(name):
    kept = [(n, STAR_DTYPE[n]) for n in STAR_DTYPE.names if n != name]
    with pytest.raises(MessageError, match=f"has no field {name}"):
        stars_from_cloud(cloud_from_points(np.zeros(2, kept), HEADER))


def test_identified_stars_with_a_field_of_several_values_are_refused():
    message = cloud_from_points(np.zeros(1, STAR_DTYPE), HEADER)
    message.fields[0].datatype, message.fields[0].count = PointField.UINT8, 4
    with pytest.raises(MessageError, match="field x"):
        stars_from_cloud(message)


CATALOG = StarCatalog(
    np.eye(3), np.array([1.0, 2.0, 3.5]), np.array([101, 102, 103]), np.array([11, 12, 13])
)


def identified(index, state, residual_px, xy=XY):
    identification = Identification(
        np.array(index), np.array(state, np.uint8), np.array(residual_px)
    )
    return stars_from_cloud(cloud_from_identification(identification, xy, CATALOG, HEADER))


def test_identified_stars_say_which_star_a_centroid_is():
    star = identified([2, 1, 0], [1, 2, 1], [0.1, 5.0, 0.2])
    np.testing.assert_array_equal(star["star_number"], [13, 12, 11])
    np.testing.assert_array_equal(star["hip"], [103, 102, 101])
    np.testing.assert_allclose(star["dec_deg"], [90.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(star["ra_deg"][1:], [90.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(star["magnitude"], [3.5, 2.0, 1.0])
    np.testing.assert_array_equal(star["state"], [1, 2, 1])
    np.testing.assert_allclose(star["residual_px"], [0.1, 5.0, 0.2], rtol=1e-6)


def test_identified_stars_are_in_input_order():
    stars = identified([-1, 1, -1], [0, 1, 0], [np.nan, 0.1, np.nan])
    np.testing.assert_array_equal(np.column_stack([stars["x"], stars["y"]]), XY)
    np.testing.assert_array_equal(stars["star_number"], [0, 12, 0])


def test_unidentified_star_has_number_zero_and_no_position():
    star = identified([-1], [StarState.UNIDENTIFIED], [np.nan], XY[:1])[0]
    assert (star["star_number"], star["hip"], star["state"]) == (0, 0, 0)
    assert all(np.isnan(star[name]) for name in ("ra_deg", "dec_deg", "magnitude", "residual_px"))


def test_coordinates_too_large_for_float32_become_infinite():
    star = identified([-1], [0], [np.nan], np.array([[1e300, -1e300]]))[0]
    assert (star["x"], star["y"]) == (np.inf, -np.inf)
