"""Every number in the tables of docs/conventions.md is what the package computes.

A table stands under a heading of its own. Its checker takes a row of the page as it stands and
returns what the package makes of the row's inputs, by column.
"""

import re
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import position_angle, ra_dec, separation, unit_vectors
from star_tracker.maps.star_map import Pose, paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.tracker import StarTracker

PAGE = Path(__file__).resolve().parents[2] / "docs" / "conventions.md"
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]\d+)?")
ARCSEC = np.degrees(1) * 3600
SOMEWHERE = [(0.0, 0.0), (109.6, 34.5), (250.0, -70.0)]
CELESTIAL = ("ra_deg", "dec_deg", "roll_deg")


def tables_of(text):
    """Return the rows of each table, a dict by column each, by the heading above it."""
    tables = {}
    for section in re.split(r"^#+ ", text, flags=re.MULTILINE)[1:]:
        lines = [line for line in section.splitlines() if line.startswith("|")]
        if lines:
            cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
            assert set("".join(cells[1])) == {"-"}, f"one table under each heading: {lines[0]}"
            tables[section.splitlines()[0]] = [
                dict(zip(cells[0], row, strict=True)) for row in cells[2:]
            ]
    return tables


TABLES = tables_of(PAGE.read_text(encoding="utf-8"))


def value(cell):
    """Return a cell's number, or its text where it is none; a remark may follow a number."""
    first = cell.split(" (")[0]
    return float(first) if NUMBER.fullmatch(first) else cell


def last_digit(cell):
    """Return one unit of the last digit printed."""
    mantissa, _, exponent = cell.split(" (")[0].partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def tolerance(cell):
    """Return half a unit of the last digit; a number without a decimal point is exact."""
    return 0.5 * last_digit(cell) * (1 + 1e-6) if "." in cell else 1e-9


def faults(heading, row):
    """Return the columns of a row of the page that differ from what the package computes."""
    computed = CHECKERS[heading][0]({name: value(cell) for name, cell in row.items()})
    assert set(computed) <= set(row)
    return [
        f"{name}: the page has {row[name]}, the package {number:.9g}"
        for name, number in computed.items()
        if not abs(value(row[name]) - number) <= tolerance(row[name])
    ]


# What the package makes of a row


def camera_of(row, **others):
    return Camera.from_fov(row["fov_deg"], round(row["width_px"]), 800, **others)


def example_camera(**changes):
    (row,) = TABLES["The example camera"]
    number = {name: value(cell) for name, cell in row.items()}
    camera = Camera.from_fov(
        number["fov_deg"], round(number["width_px"]), round(number["height_px"]),
        principal_point_px=(number["cx_px"], number["cy_px"]),
    )
    return replace(camera, **changes)


def rotation_of(row):
    return Pose(*(row[name] for name in CELESTIAL)).rotation


def named(names, numbers):
    return dict(zip(names, np.ravel(numbers), strict=True))


def default_camera(row):
    camera = Camera.from_fov(row["fov_deg"], round(row["width_px"]), round(row["height_px"]))
    return {name: getattr(camera, name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")}


def scale(row):
    camera = camera_of(row)
    x = np.array([camera.cx_px, camera.cx_px + 1, camera.width_px - 1, camera.width_px])
    v = camera.vectors(np.column_stack([x, np.full(4, camera.cy_px)]))
    return {
        "focal_length_px": camera.focal_length_px,
        "centre_arcsec": separation(v[0], v[1]) * ARCSEC,
        "edge_arcsec": separation(v[2], v[3]) * ARCSEC,
    }


def opencv_count(row):
    """The same direction, seen by a camera whose principal point is counted OpenCV's way."""
    camera = example_camera()
    opencv = example_camera(cx_px=(camera.width_px - 1) / 2)
    direction = camera.vectors([(row["corner_px"], 0)])
    known = {
        "outer edge of the first column": 0, "centre of the first column": 0.5,
        "default principal point, cx": camera.width_px / 2,
        "centre of the last column": camera.width_px - 0.5,
        "outer edge of the last column": camera.width_px,
    }
    return {
        "corner_px": known[row["place"]], "opencv_px": opencv.pixels(direction)[0, 0],
    }


@cache
def limits_of(distortion):
    """Return the first and last whole coordinates along x and along y that a tracker uses."""
    lens = Distortion("plumb_bob", (-0.01, 0.0, 0.0, 0.0, 0.0)) if distortion == "yes" else None
    camera = replace(example_camera(), distortion=lens)
    tracker = StarTracker(FeatureDatabase.build(StarCatalog.paper()), camera)

    def used(pixels):
        which = [at for at, pixel in pixels if tracker.solve([pixel]).n_ignored == 0]
        return min(which), max(which)

    along = range(-100, 1200)
    return *used([(x, (x, 400)) for x in along]), *used([(y, (500, y)) for y in along])


def outside(row):
    names = ("first_x_px", "last_x_px", "first_y_px", "last_y_px")
    return named(names, limits_of(row["distortion"]))


def half_pixel(row):
    camera = camera_of(row)
    cx, cy = camera.cx_px, camera.cy_px
    middle, x, xy = camera.vectors([(cx, cy), (cx + 0.5, cy), (cx + 0.5, cy + 0.5)])
    return {
        "one_axis_arcsec": separation(middle, x) * ARCSEC,
        "both_axes_arcsec": separation(middle, xy) * ARCSEC,
    }


def pixel_to_direction(row):
    camera = example_camera(parity=row["parity"])
    pixel = [(row["x_px"], row["y_px"])]
    return named(("x_over_z", "y_over_z"), camera.plane(pixel)) | named(
        ("unit_x", "unit_y", "unit_z"), camera.vectors(pixel)
    )


def star_to_pixel(row):
    rotation = Pose(0, 0, row["roll_deg"]).rotation
    star = unit_vectors(*np.radians([row["ra_deg"], row["dec_deg"]])) @ rotation
    x, y = example_camera(parity="normal").pixels(star)[0]
    mirrored_x, mirrored_y = example_camera(parity="mirrored").pixels(star)[0]
    assert mirrored_x == pytest.approx(x)
    return {"x_px": x, "y_normal_px": y, "y_mirrored_px": mirrored_y}


def axes(row):
    names = [f"{axis}_{component}" for axis in ("right", "down", "bore") for component in "xyz"]
    return named(names, rotation_of(row).T)


def quaternion(row):
    """Both ways: angles -> quaternion, and the page's formula of its quaternion -> boresight."""
    found = Attitude.from_rotation(rotation_of(row), np.zeros((3, 3))).quaternion_xyzw
    x, y, z, w = (row[name] for name in "xyzw")
    boresight = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)
    truth = unit_vectors(*np.radians([row["ra_deg"], row["dec_deg"]]))
    np.testing.assert_allclose(boresight, truth, atol=1e-5)
    return named("xyzw", found)


def second_quaternion():
    row = TABLES["Quaternion"][1]
    return Rotation.from_quat([value(row[name]) for name in "xyzw"]).as_matrix()


def direction(row):
    camera = [row["camera_x"], row["camera_y"], row["camera_z"]]
    rotation = second_quaternion()
    return named(("icrs_x", "icrs_y", "icrs_z"), rotation @ camera) | named(
        ("inverse_x", "inverse_y", "inverse_z"), rotation.T @ camera
    )


def roll(row):
    """The position angle of a point a little off the boresight, in each direction."""
    steps = {"up": (0, -1), "right": (1, 0), "down": (0, 1), "left": (-1, 0)}
    angles = {name: [] for name in steps}
    for ra_deg, dec_deg in SOMEWHERE:
        rotation = Pose(ra_deg, dec_deg, row["roll_deg"]).rotation
        for name, (x, y) in steps.items():
            towards = rotation @ (1e-6 * x, 1e-6 * y, 1.0)
            angles[name].append(np.degrees(position_angle(rotation[:, 2], towards)))
    for found in angles.values():
        np.testing.assert_allclose(np.sin(np.radians(np.subtract(found, found[0]))), 0, atol=1e-5)
    return {f"{name}_deg": round(found[0], 3) % 360 for name, found in angles.items()}


def turn(row):
    about_z = Rotation.from_euler("z", row["rotation_about_z_deg"], degrees=True).as_matrix()
    before = rotation_from_boresight(1.0, 0.5, 2.0)
    after = Attitude.from_rotation(before @ about_z, np.zeros((3, 3)))
    return {"change_of_roll_deg": np.degrees(after.roll_rad - 2.0)}


def star_of_map_1(row):
    (star_map,) = paper_maps((1,))
    x, y = star_map.xy_px[0]
    pixel = [(row["x_px"], row["y_px"])]
    pixel_ra, pixel_dec = ra_dec(star_map.camera.vectors(pixel)[0] @ star_map.pose.rotation.T)
    catalog = StarCatalog.paper()
    star = int(np.flatnonzero(catalog.number == star_map.star_number[0])[0])
    ra, dec = (angles[star] for angles in catalog.ra_dec_rad)
    return {"x_px": x, "y_px": y, "hip": catalog.hip[star]} | named(
        ("x_over_z", "y_over_z"), star_map.camera.plane(pixel)
    ) | named(
        ("pixel_ra_deg", "pixel_dec_deg", "catalogue_ra_deg", "catalogue_dec_deg"),
        np.degrees([pixel_ra, pixel_dec, ra, dec]),
    )


def icrs_axis(row):
    angles = [0 if row[name] == "any" else row[name] for name in CELESTIAL[:2]]
    return named("xyz", unit_vectors(*np.radians(angles)))


def body_axis(row):
    """At right ascension, declination and roll 0 such a body's axes are those of ICRS."""
    column = Pose(0, 0, 0).rotation[:, "xyz".index(row["optical_axis"][0])]
    return named(("body_x", "body_y", "body_z"), column)


def imu_covariance(row):
    imu = pytest.importorskip("star_tracker.msg_adapters.imu", reason="needs ROS 2's messages")
    camera = np.diag([row["camera_x"], row["camera_y"], row["camera_z"]])
    attitude = Attitude.from_rotation(Pose(0, 0, 0).rotation, camera)
    return named(("icrs_x", "icrs_y", "icrs_z"), np.diag(imu.reference_covariance(attitude)))


def angle(row):
    radians = row["pixels"] / camera_of(row).focal_length_px
    return {
        "angle_arcsec": radians * ARCSEC, "angle_deg": np.degrees(radians),
        "angle_rad": radians, "variance_rad2": radians**2,
    }


def boresight(row):
    adapter = pytest.importorskip(
        "star_tracker.msg_adapters.attitude", reason="needs ROS 2's messages"
    )
    from std_msgs.msg import Header

    attitude = Attitude.from_rotation(rotation_of(row), np.zeros((3, 3)))
    message = adapter.boresight_from_attitude(attitude, Header()).vector
    degrees = (message.x % 360, message.y, message.z)
    return named(CELESTIAL, [row["ra_deg"] % 360, row["dec_deg"], row["roll_deg"]]) | named(
        CELESTIAL, degrees
    ) | {name: getattr(attitude, name) for name in ("ra_rad", "dec_rad", "roll_rad")}


def julian_year(row):
    days = (datetime.fromisoformat(row["date"]) - datetime(2000, 1, 1, 12)) / timedelta(days=1)
    return {"epoch": 2000 + days / 365.25}


@cache
def unmerged(epoch):
    return StarCatalog.hipparcos(limiting_magnitude=8, min_separation_deg=0, epoch=epoch)


def proper_motion(row):
    before, after = (
        c.vectors[np.flatnonzero(c.hip == row["hip"])[0]]
        for c in (unmerged(2000.0), unmerged(row["epoch"]))
    )
    ra, dec = ra_dec(after)
    return {
        "ra_deg": np.degrees(ra), "dec_deg": np.degrees(dec),
        "moved_arcsec": separation(before, after) * ARCSEC,
    }


def aberration(row):
    return {"at_most_arcsec": np.arctan(1e3 * row["v_km_s"] / speed_of_light) * ARCSEC}


def k_of_page():
    rows = TABLES["K"]
    return [value(row[name]) for row in rows for name in ("first", "second", "third")]


def k_row(row):
    """The row of the K that describes the example camera in OpenCV's count."""
    adapter = pytest.importorskip(
        "star_tracker.msg_adapters.camera_info", reason="needs ROS 2's messages"
    )
    from std_msgs.msg import Header

    camera = example_camera()
    opencv = example_camera(
        cx_px=(camera.width_px - 1) / 2, cy_px=(camera.height_px - 1) / 2
    )
    k = np.reshape(adapter.info_from_camera(opencv, Header()).k, (3, 3))
    at = [{name: value(cell) for name, cell in one.items()} for one in TABLES["K"]].index(row)
    return named(("first", "second", "third"), k[at])


def pixel_with_k(row):
    adapter = pytest.importorskip(
        "star_tracker.msg_adapters.camera_info", reason="needs ROS 2's messages"
    )
    from sensor_msgs.msg import CameraInfo

    ours = example_camera()
    camera = adapter.camera_from_info(
        CameraInfo(width=ours.width_px, height=ours.height_px, k=k_of_page()), "normal"
    )
    plane = camera.plane([(row["x_px"], row["y_px"])])
    np.testing.assert_allclose(plane, ours.plane([(row["x_px"] + 0.5, row["y_px"] + 0.5)]))
    return named(("x_over_z", "y_over_z"), plane)


#: Each table's checker, and how many rows it has.
CHECKERS = {
    "The example camera": (default_camera, 1),
    "Focal length and pixel scale": (scale, 4),
    "Where pixels are counted from": (opencv_count, 5),
    "Centroids outside of the image": (outside, 2),
    "What half a pixel costs": (half_pixel, 4),
    "Pixel to direction": (pixel_to_direction, 5),
    "Star to pixel": (star_to_pixel, 6),
    "Axes": (axes, 2),
    "Quaternion": (quaternion, 6),
    "Direction of the quaternion": (direction, 3),
    "Roll": (roll, 3),
    "Turning about the boresight": (turn, 2),
    "Star A01 of map 1": (star_of_map_1, 1),
    "ICRS axes": (icrs_axis, 3),
    "Body frame": (body_axis, 3),
    "Covariance": (imu_covariance, 1),
    "Angles": (angle, 2),
    "Boresight in both units": (boresight, 1),
    "Julian years": (julian_year, 3),
    "Proper motion": (proper_motion, 4),
    "Not corrected": (aberration, 2),
    "K": (k_row, 3),
    "Pixel to direction with K": (pixel_with_k, 4),
}
each_table = pytest.mark.parametrize("heading", TABLES)


def test_the_page_has_all_its_tables_and_rows():
    assert {heading: len(rows) for heading, rows in TABLES.items()} == {
        heading: n for heading, (_, n) in CHECKERS.items()
    }


@each_table
def test_a_table_is_what_the_package_computes(heading):
    assert [faults(heading, row) for row in TABLES[heading]] == [[] for _ in TABLES[heading]]


@each_table
def test_no_number_of_a_table_can_be_altered_unnoticed(heading):
    """By one unit of the last digit where it is computed, by thirty where it is given."""
    for row in TABLES[heading]:
        computed = CHECKERS[heading][0]({name: value(cell) for name, cell in row.items()})
        for name, cell in row.items():
            if isinstance(value(cell), str):
                continue
            for units in (1, -1) if name in computed else (30,):
                altered = altered_by(cell, units)
                assert noticed(heading, row | {name: altered}), f"{name}: {altered} for {cell}"


def altered_by(cell, units):
    """Return a cell with its number altered, printed with as many digits."""
    mantissa, e, exponent = cell.split(" (")[0].partition("e")
    decimals = len(mantissa.partition(".")[2])
    return f"{float(mantissa) + units * 10.0**-decimals:.{decimals}f}{e}{exponent}"


def noticed(heading, row):
    """Return whether a row is refused: by its numbers, or as no camera or star has them."""
    try:
        return bool(faults(heading, row))
    except (AssertionError, IndexError, ValueError):
        return True
