"""Star map files, the eight maps of the paper, and synthetic fields."""

import math
import re

import numpy as np
import pytest

from star_tracker.geometry.spherical import separation
from star_tracker.identification.labels import StarState
from star_tracker.maps.simulation import (
    Condition,
    random_rotation,
    synthetic_field,
    uniform_noise,
    visible_stars,
)
from star_tracker.maps.star_map import (
    PAPER_MAPS,
    Pose,
    StarMap,
    paper_maps,
    read_star_map,
    write_star_map,
)
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

ARCSEC = np.pi / 180 / 3600
HEAD = ("width_px: 512", "height_px: 512", "fov_deg: 12", "cx_px: 256", "cy_px: 256")
COLUMNS = "label,x_px,y_px,star_number,displaced_px"
#: Stars of each map, and the maps' true poses: RA, Dec, roll in degrees (the paper's tables).
COUNTS = {1: 15, 2: 16, 3: 7, 4: 12, 5: 9, 6: 12, 7: 41, 8: 29}
POSES = {
    1: (109.6, 34.5, 90), 2: (43, 18, 30), 3: (125, 44, 90), 4: (243, -28, 90),
    5: (86.5836, 44.4766, 89.988), 6: (112.6, 34.5, 90), 7: (112.6, 34.5, 90), 8: (106, 35, 90),
}


@pytest.fixture(scope="module")
def solved(database):
    """The paper's maps, each with its solution."""
    patient = SolveSettings(deadline_ms=math.inf)
    return {
        number: (star_map, StarTracker(database, star_map.camera, patient).solve(star_map.xy_px))
        for number, star_map in zip(PAPER_MAPS, paper_maps(), strict=True)
    }


def example(**changes):
    values = {
        "name": "an example",
        "camera": Camera.from_fov(14.5, 640, 480, principal_point_px=(320.25, 239.5)),
        "labels": ("A", "B2"), "xy_px": np.array([(1.25, 2.5), (630.01, 470.99)]),
        "star_number": np.array([17, 0]), "displaced_px": np.array([0.0, 3.5]),
        "pose": Pose(359.99, -45.5, 271.25),
    }
    return StarMap(**(values | changes))


# The file format


def test_a_star_map_comes_back_from_its_file(tmp_path):
    star_map = example()
    write_star_map(star_map, tmp_path / "map.csv")
    found = read_star_map(tmp_path / "map.csv")
    assert (found.name, found.labels, found.pose) == (
        star_map.name, star_map.labels, star_map.pose
    )
    np.testing.assert_array_equal(found.xy_px, star_map.xy_px)
    np.testing.assert_array_equal(found.star_number, star_map.star_number)
    np.testing.assert_array_equal(found.displaced_px, star_map.displaced_px)
    assert found.camera.fx_px == pytest.approx(star_map.camera.fx_px, rel=1e-9)
    for name in ("width_px", "height_px", "cx_px", "cy_px", "parity"):
        assert getattr(found.camera, name) == getattr(star_map.camera, name)


def test_coordinates_are_rounded_to_a_hundredth_of_a_pixel(tmp_path):
    write_star_map(example(xy_px=np.array([(1.234, 5.678), (0.0, 0.0)])), tmp_path / "map.csv")
    assert read_star_map(tmp_path / "map.csv").xy_px[0].tolist() == [1.23, 5.68]


@pytest.mark.parametrize("label", ["Castor, A", 'the "North" star', "#3", " padded "])
def test_any_label_comes_back_from_the_file(tmp_path, label):
    write_star_map(example(labels=(label, "B")), tmp_path / "map.csv")
    assert read_star_map(tmp_path / "map.csv").labels == (label, "B")


def test_a_map_without_a_pose_comes_back_without_one(tmp_path):
    write_star_map(example(pose=None), tmp_path / "map.csv")
    assert read_star_map(tmp_path / "map.csv").pose is None


def test_a_map_without_stars_comes_back_empty(tmp_path):
    star_map = example(
        labels=(), xy_px=np.empty((0, 2)), star_number=np.empty(0, np.int64),
        displaced_px=np.empty(0),
    )
    write_star_map(star_map, tmp_path / "map.csv")
    assert read_star_map(tmp_path / "map.csv").xy_px.shape == (0, 2)


def test_columns_that_do_not_fit_together_are_not_written(tmp_path):
    with pytest.raises(ValueError, match="zip"):
        write_star_map(example(labels=("A",)), tmp_path / "map.csv")


@pytest.mark.parametrize(
    "camera",
    [
        Camera(640, 480, 2500.0, 2400.0, 320, 240),
        Camera(640, 480, 2500.0, 2500.0, 320, 240, "normal", Distortion(
            "plumb_bob", (-0.2, 0.0, 0.0, 0.0, 0.0)
        )),
    ],
    ids=["unequal focal lengths", "distortion"],
)
def test_a_camera_that_the_format_cannot_hold_is_not_written_as_another(tmp_path, camera):
    try:
        write_star_map(example(camera=camera), tmp_path / "map.csv")
    except ValueError:
        return
    xy = [(10.0, 20.0)]
    found = read_star_map(tmp_path / "map.csv").camera
    np.testing.assert_allclose(found.vectors(xy), camera.vectors(xy), atol=1e-9)


def written(path, head, *rows):
    lines = [f"# {line}" for line in head] + list(rows)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def refused(path):
    with pytest.raises(ValueError, match=f"^star map {re.escape(str(path))}") as error:
        read_star_map(path)
    return str(error.value)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "broken.csv"


def test_the_smallest_file_takes_its_name_from_the_path(path):
    head = ("width_px: 640", "height_px: 480", "fov_deg: 10", "parity: normal")
    found = read_star_map(written(path, head, COLUMNS, "A,1,2,3,0"))
    assert found.name == "broken"
    assert found.camera == Camera.from_fov(10, 640, 480)
    assert found.pose is None


def test_blank_lines_and_remarks_are_passed_over(path):
    head = (*HEAD, "parity: normal", "a remark without a colon")
    rows = (COLUMNS, "", "A,1,2,3,0", "# another remark", "B,4,5,6,0", "")
    assert read_star_map(written(path, head, *rows)).labels == ("A", "B")


def test_a_missing_file_is_refused_by_name(path):
    assert " cannot be read: " in refused(path)


def test_a_file_that_is_no_text_is_refused_by_name(path):
    path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" * 10)
    assert " cannot be read: " in refused(path)


@pytest.mark.parametrize(
    "rows", [(), ("label,x_px,y_px",), ("x_px,label,y_px,star_number,displaced_px", "1,A,2,3,0")]
)
def test_other_columns_are_refused_by_name(path, rows):
    assert refused(written(path, (*HEAD, "parity: normal"), *rows)) == (
        f"star map {path}: the columns must be label,x_px,y_px,star_number,displaced_px"
    )


@pytest.mark.parametrize(
    "rows",
    [
        ("A,1,two,3,0",),
        ("A,1,2,3,",),
        ("A,1,2,3,0", "B,1,2"),
        ("A,1,2", "B,3,4"),
        ("A,1,2,3,0,1,2,3,0",),
        ("A",),
    ],
    ids=["a word", "empty", "one short row", "all rows short", "twice as long", "label only"],
)
def test_rows_that_are_no_table_of_numbers_are_refused_by_name(path, rows):
    text = refused(written(path, (*HEAD, "parity: normal"), COLUMNS, *rows))
    assert text.startswith(f"star map {path}: not a table of numbers (")


@pytest.mark.parametrize("value", ["nan", "inf", "-1e999"])
def test_a_value_that_is_not_finite_is_refused_by_name(path, value):
    rows = (COLUMNS, f"A,1,{value},3,0")
    assert refused(written(path, (*HEAD, "parity: normal"), *rows)) == (
        f"star map {path}: a value is not a finite number"
    )


@pytest.mark.parametrize("key", ["width_px", "height_px", "fov_deg", "parity"])
def test_a_head_without_the_camera_is_refused_by_name(path, key):
    head = [line for line in (*HEAD, "parity: normal") if not line.startswith(key)]
    assert refused(written(path, head, COLUMNS, "A,1,2,3,0")) == (
        f"star map {path}: the head has no line '# {key}: ...'"
    )


@pytest.mark.parametrize("line", ["cx_px: left", "fov_deg: 12 deg", "ra_deg: 7h 10m"])
def test_a_head_that_holds_no_number_is_refused_by_name(path, line):
    text = refused(written(path, (*HEAD, "parity: normal", line), COLUMNS, "A,1,2,3,0"))
    assert text.startswith(f"star map {path}: a head line holds no number (")


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("parity: flipped", "parity 'flipped' is unknown: use normal, mirrored, auto"),
        ("width_px: 0", "image size 0 x 512 px is impossible: give the width and height"),
        ("fov_deg: 200", "fov_deg 200 is outside of 0.5 to 120"),
        ("width_px: nan", ""),
        ("height_px: inf", ""),
        ("cx_px: nan", "camera cx_px is not a finite number"),
    ],
)
def test_a_head_with_an_impossible_camera_is_refused_by_name(path, line, text):
    found = refused(written(path, (*HEAD, "parity: normal", line), COLUMNS, "A,1,2,3,0"))
    assert found.startswith(f"star map {path}: {text}")


# The paper's maps


def test_an_unknown_map_is_refused():
    with pytest.raises(ValueError, match=r"^there is no map 0, 9: the maps are numbered 1 to 8$"):
        paper_maps((1, 0, 9))


def test_maps_come_in_the_order_asked_for():
    assert [m.name for m in paper_maps((6, 2))] == ["map 6", "map 2"]


def test_maps_may_lie_in_a_folder_of_the_users_own(tmp_path):
    write_star_map(example(), tmp_path / "map4.csv")
    assert paper_maps((4,), tmp_path)[0].name == "an example"
    with pytest.raises(ValueError, match=re.escape(str(tmp_path / "map5.csv"))):
        paper_maps((5,), tmp_path)


def test_shipped_maps_are_those_of_the_paper():
    maps = dict(zip(PAPER_MAPS, paper_maps(), strict=True))
    assert {n: len(m.labels) for n, m in maps.items()} == COUNTS
    assert sum(COUNTS.values()) == 141
    for number, star_map in maps.items():
        side, fov_deg = (512, 12) if number < 7 else (1024, 20)
        assert star_map.camera == Camera.from_fov(fov_deg, side, side, parity="mirrored")
        assert star_map.pose == Pose(*POSES[number])
        letter = "ABCDEFGH"[number - 1]
        assert star_map.labels == tuple(f"{letter}{i:02d}" for i in range(1, COUNTS[number] + 1))


def test_shipped_maps_are_projections_of_the_catalogue(catalog):
    """Rounding to 0.01 px moves a star by at most 0.0071 px; displaced stars are listed."""
    for star_map in paper_maps():
        stars = catalog.vectors[star_map.star_number - 1]
        places = star_map.camera.pixels(stars @ star_map.pose.rotation)
        off = np.linalg.norm(star_map.xy_px - places, axis=1)
        assert np.max(np.abs(off - star_map.displaced_px)) < 0.0071 + 0.005


@pytest.mark.parametrize("number", PAPER_MAPS)
def test_every_star_of_a_map_gets_the_papers_number(solved, catalog, number):
    star_map, solution = solved[number]
    assert solution.status is Status.SOLVED
    assert np.all(solution.identification.catalog_index >= 0)
    found = catalog.number[solution.identification.catalog_index]
    np.testing.assert_array_equal(found, star_map.star_number)


@pytest.mark.parametrize("number", PAPER_MAPS)
def test_boresight_of_a_map_is_where_it_was_computed_for(solved, number):
    """Rounding to 0.01 px is 0.2" a star; three of the seven of map 3 are moved by 2 to 3 px."""
    star_map, solution = solved[number]
    error = separation(solution.attitude.rotation[:, 2], star_map.pose.rotation[:, 2])
    assert error <= (90 if number == 3 else 2) * ARCSEC


@pytest.mark.parametrize("number", PAPER_MAPS)
def test_roll_of_a_map_is_where_it_was_computed_for(solved, number):
    """The error of the boresight, divided by the 0.05 rad or more over which the stars lie."""
    _, solution = solved[number]
    error = np.degrees(solution.attitude.roll_rad) - POSES[number][2]
    assert abs((error + 180) % 360 - 180) * 3600 <= (90 if number == 3 else 2) / 0.05


def test_the_displaced_stars_are_those_of_map_6(solved):
    found = {
        star_map.labels[i]
        for star_map, solution in solved.values()
        for i in np.flatnonzero(solution.identification.state == StarState.DISPLACED)
    }
    assert found == {"F02", "F05", "F08"}


def test_displaced_stars_lie_as_far_from_their_places_as_they_were_moved(solved):
    star_map, solution = solved[6]
    moved = solution.identification.state == StarState.DISPLACED
    np.testing.assert_allclose(
        solution.identification.residual_px[moved], star_map.displaced_px[moved], atol=0.03
    )


@pytest.mark.parametrize("number", PAPER_MAPS)
def test_no_map_could_be_a_coincidence(solved, number):
    _, solution = solved[number]
    assert solution.wrong_probability < 1e-8
    assert solution.parity == "mirrored"


# Synthetic fields

WIDE = Camera.from_fov(20, 1024, 768, principal_point_px=(400, 500), parity="mirrored")


def test_visible_stars_are_those_whose_pixels_lie_in_the_image(catalog):
    rng = np.random.default_rng(1)
    for _ in range(20):
        rotation = random_rotation(rng)
        index, pixels = visible_stars(catalog, WIDE, rotation)
        local = catalog.vectors @ rotation
        front = np.flatnonzero(local[:, 2] > 0)
        inside = WIDE.contains(WIDE.pixels(local[front]))
        np.testing.assert_array_equal(index, front[inside])
        np.testing.assert_allclose(pixels, WIDE.pixels(local[index]))


def test_a_field_without_noise_shows_the_catalogue(catalog):
    rng = np.random.default_rng(2)
    rotation = random_rotation(rng)
    field = synthetic_field(catalog, WIDE, rotation, rng)
    np.testing.assert_array_equal(field.rotation, rotation)
    np.testing.assert_allclose(
        WIDE.vectors(field.xy_px) @ rotation.T, catalog.vectors[field.catalog_index], atol=1e-12
    )
    assert len(np.unique(field.catalog_index)) == len(visible_stars(catalog, WIDE, rotation)[0])


def test_noise_has_the_standard_deviation_asked_for_along_each_axis(catalog):
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(60):
        field = synthetic_field(catalog, WIDE, random_rotation(rng), rng, Condition(noise_px=0.7))
        places = WIDE.pixels(catalog.vectors[field.catalog_index] @ field.rotation)
        errors.append(field.xy_px - places)
    errors = np.concatenate(errors)
    # A standard deviation scatters by 1 / sqrt(2 n); n is some 2000.
    np.testing.assert_allclose(errors.std(axis=0), 0.7, rtol=4 / math.sqrt(2 * len(errors)))
    assert np.all(np.abs(errors.mean(axis=0)) < 4 * 0.7 / math.sqrt(len(errors)))


@pytest.mark.parametrize("missing", [0.0, 0.3, 0.6, 1.0])
def test_missing_stars_and_false_stars_come_in_the_fractions_asked_for(catalog, missing):
    """Exactly, but for rounding to a whole number; the stars that are left are true ones."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        rotation = random_rotation(rng)
        index = visible_stars(catalog, WIDE, rotation)[0]
        n = len(index)
        field = synthetic_field(
            catalog, WIDE, rotation, rng, Condition(missing=missing, false_stars=0.5)
        )
        assert np.count_nonzero(field.catalog_index == -1) == round(0.5 * n)
        seen = field.catalog_index[field.catalog_index >= 0]
        assert len(seen) == len(np.unique(seen)) == n - round(missing * n)
        assert np.isin(seen, index).all()


def test_every_star_is_missing_as_often_as_any_other(catalog):
    """Half of the stars of one field, 400 times: each count is binomial about 200."""
    rng, rotation = np.random.default_rng(10), Pose(10, 20, 30).rotation
    index = visible_stars(catalog, WIDE, rotation)[0]
    seen = np.zeros(len(catalog))
    for _ in range(400):
        field = synthetic_field(catalog, WIDE, rotation, rng, Condition(missing=0.5))
        seen[field.catalog_index] += 1
    assert np.abs(seen[index] - 200).max() < 4.5 * math.sqrt(400 * 0.25)


def test_a_seed_makes_the_field(catalog):
    fields = [
        synthetic_field(
            catalog, WIDE, Pose(10, 20, 30).rotation, np.random.default_rng(seed),
            Condition(noise_px=1.0),
        ).xy_px
        for seed in (5, 5, 6)
    ]
    np.testing.assert_array_equal(fields[0], fields[1])
    assert not np.array_equal(fields[0], fields[2])


def test_magnitudes_are_the_catalogues_with_noise_and_those_of_false_stars_any_star_s(catalog):
    rng = np.random.default_rng(8)
    errors, false = [], []
    for _ in range(60):
        field = synthetic_field(
            catalog, WIDE, random_rotation(rng), rng, Condition(false_stars=1.0)
        )
        assert field.v_mag.shape == field.catalog_index.shape
        true = field.catalog_index >= 0
        errors.append(field.v_mag[true] - catalog.v_mag[field.catalog_index[true]])
        false.append(field.v_mag[~true])
    errors, false = np.concatenate(errors), np.concatenate(false)
    np.testing.assert_allclose(errors.std(), 0.1, rtol=4 / math.sqrt(2 * len(errors)))
    assert np.isin(false, catalog.v_mag).all()
    spread = catalog.v_mag.std() / math.sqrt(len(false))
    assert false.mean() == pytest.approx(catalog.v_mag.mean(), abs=4 * spread)


def test_magnitudes_leave_the_stream_of_positions_alone(catalog):
    """Who is missing, the noise and the order come from it; magnitudes have one of their own."""
    one, two = np.random.default_rng(9), np.random.default_rng(9)
    field = synthetic_field(catalog, WIDE, Pose(10, 20, 30).rotation, one, Condition(noise_px=1.0))
    n = len(field.xy_px)
    two.permutation(n)
    two.normal(0.0, 1.0, (n, 2))
    two.permutation(n)
    assert one.bit_generator.state == two.bit_generator.state


def test_uniform_noise_fills_the_image():
    xy = uniform_noise(WIDE, 5000, np.random.default_rng(7))
    assert WIDE.contains(xy).all()
    # The mean of a uniform distribution scatters by its width / sqrt(12 n).
    np.testing.assert_allclose(xy.mean(axis=0), (512, 384), atol=4 * 1024 / math.sqrt(60_000))


def test_random_rotations_are_proper_and_look_everywhere():
    rng = np.random.default_rng(8)
    rotations = np.array([random_rotation(rng) for _ in range(3000)])
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    # Each component of a uniform direction has mean 0 and variance 1/3, for all three axes.
    assert np.all(np.abs(rotations.mean(axis=0)) < 4.5 / math.sqrt(3 * 3000))
    np.testing.assert_allclose((rotations**2).mean(axis=0), 1 / 3, atol=4.5 * 0.298 / 54.8)
