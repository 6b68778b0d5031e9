"""`star_tracker plot` and the pictures: what is drawn, that it can be read, what is refused."""

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Text
from processes import completed

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.pairs import PairTable
from star_tracker.commands import cli
from star_tracker.figures.field_labels import STAR_LABEL
from star_tracker.figures.field_plot import draw_field
from star_tracker.figures.field_view import FieldView
from star_tracker.figures.pair_histogram import draw_pairs, pairs_per_bin
from star_tracker.figures.placement import overlap_area, place_labels
from star_tracker.figures.sky_grid import grid_lines
from star_tracker.figures.sky_map import Survey, draw_sky_map
from star_tracker.figures.style import house_style, text_box
from star_tracker.geometry.spherical import ra_dec, unit_vectors
from star_tracker.identification.labels import Identification, StarState
from star_tracker.maps.frame_file import read_frame
from star_tracker.maps.simulation import Condition, synthetic_field, uniform_noise, visible_stars
from star_tracker.maps.star_map import Pose, paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

ROOT = Path(__file__).resolve().parents[2]
#: Identified and displaced stars of each map, as the README's demo has them.
COUNTS = {1: (15, 0), 2: (16, 0), 3: (7, 0), 4: (12, 0), 5: (9, 0), 6: (9, 3), 7: (41, 0),
          8: (29, 0)}
#: Of few stars, with displaced ones and of many: the others are slow.
each_map = pytest.mark.parametrize("number", [
    n if n in {3, 6, 7} else pytest.param(n, marks=pytest.mark.slow) for n in COUNTS
])
PORTRAIT = Camera.from_fov(10, 600, 800)


@pytest.fixture(scope="module")
def view(database):
    """Solve a map and return what there is to see."""
    def solved(number):
        (star_map,) = paper_maps((number,))
        solution = StarTracker(database, star_map.camera).solve(star_map.xy_px)
        return FieldView(star_map.name, star_map.camera, star_map.labels, star_map.xy_px,
                         solution, database.catalog)
    return solved


def plot(capsys, *arguments):
    """Draw and return the record."""
    assert cli.main(["plot", *map(str, arguments), "--json"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return json.loads(captured.out)


def refusal(capsys, *arguments):
    """Return the one line of what cannot be drawn."""
    assert cli.main(["plot", *map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err.rstrip("\n")


def frame_file(tmp_path, xy_px, intensity=None):
    path = tmp_path / "frame.csv"
    rows = [f"{x:.3f},{y:.3f}" for x, y in xy_px]
    if intensity is not None:
        rows = [f"{row},{light:.4g}" for row, light in zip(rows, intensity, strict=True)]
    head = "x,y" if intensity is None else "x,y,intensity"
    path.write_text("\n".join(["# a frame", head, *rows]) + "\n", encoding="utf-8")
    return path


def camera_options(camera):
    return ("--fov-deg", camera.fov_deg, "--width-px", camera.width_px,
            "--height-px", camera.height_px)


def texts_of(figure):
    return "\n".join(text.get_text() for text in figure.findobj(Text))


# The eight maps


@each_map
def test_a_map_is_drawn_with_the_numbers_of_the_paper(capsys, tmp_path, number):
    output = tmp_path / "map.png"
    record = plot(capsys, number, "--output", output, "--dpi", 50)
    assert imread(output).shape[:2] > (300, 300)
    assert record["status"] == "SOLVED"
    assert (record["identified"], record["displaced"]) == COUNTS[number]
    assert record["unidentified"] == 0
    assert record["missing"] == len(record["missing_guide_stars"])
    (star_map,) = paper_maps((number,))
    stars = record["stars"]
    assert [star["label"] for star in stars] == list(star_map.labels)
    assert [star["star_number"] for star in stars] == star_map.star_number.tolist()
    states = [star["state"] for star in stars]
    assert (states.count("identified"), states.count("displaced")) == COUNTS[number]
    for star in stars:
        predicted = (star["predicted_x_px"], star["predicted_y_px"])
        off = np.hypot(star["x_px"] - predicted[0], star["y_px"] - predicted[1])
        assert off == pytest.approx(star["residual_px"], abs=1e-6)


def test_all_labels_are_those_of_the_demo():
    assert np.sum(list(COUNTS.values()), axis=0).tolist() == [138, 3]


def test_displaced_stars_are_off_by_what_the_map_says(capsys, tmp_path):
    record = plot(capsys, 6, "--output", tmp_path / "a.svg")
    (star_map,) = paper_maps((6,))
    for star, moved in zip(record["stars"], star_map.displaced_px, strict=True):
        assert star["residual_px"] == pytest.approx(moved, abs=0.05)


@each_map
def test_labels_can_be_read(view, number):
    """No name is left out, and none covers another or leaves the picture."""
    seen = view(number)
    with house_style():
        figure = draw_field(seen)
    labels = [t for t in figure.findobj(Text) if t.get_label() == STAR_LABEL]
    assert len(labels) == len(seen.labels) + seen.missing.sum()
    assert all(label.get_visible() for label in labels)
    boxes = [text_box(label) for label in labels]
    assert not [pair for pair in combinations(boxes, 2) if overlap_area(*pair) > 0]
    width, height = figure.canvas.get_width_height()
    for left, bottom, right, top in boxes:
        assert (left, bottom) > (0, 0)
        assert right < width
        assert top < height


def test_a_picture_says_what_it_shows(view):
    with house_style():
        text = texts_of(draw_field(view(6)))
    for part in (
        "map 6: SOLVED, 9 identified, 3 displaced, 0 unidentified, 2 guide stars missing",
        "α 112.6000°, δ +34.5000°, roll 89.9997°", "field 12° × 12°", "F05: 1603\n20.6 px off",
        "1648", "δ +34°", "α 112°", "N", "E", "residual of", "displaced (3)",
    ):
        assert part in text


def test_north_and_east_point_where_the_sky_does(view):
    """Map 6 has its up direction towards east: north is then to the right."""
    with house_style():
        figure = draw_field(view(6))
    names = {t.get_text(): t for t in figure.findobj(Text) if t.get_text() in {"N", "E"}}
    boxes = {name: text_box(text) for name, text in names.items()}
    assert boxes["N"][0] > boxes["E"][2]
    assert boxes["E"][1] > boxes["N"][3]


@pytest.mark.parametrize("ending", ["png", "svg", pytest.param("pdf", marks=pytest.mark.slow)])
def test_the_same_input_gives_the_same_bytes(capsys, tmp_path, ending):
    written = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}.{ending}"
        plot(capsys, 6, "--output", path, "--dpi", 60)
        written.append(path.read_bytes())
    assert written[0] == written[1]


def test_the_picture_is_named_after_the_map(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["plot", "3", "--dpi", "50"]) == 0
    assert capsys.readouterr().out == (
        "map3.png: SOLVED, 7 identified, 0 displaced, 0 unidentified, 0 guide stars missing\n"
    )
    assert (tmp_path / "map3.png").is_file()


# A user's own frame


def test_a_frame_of_ones_own_is_solved_and_drawn(capsys, tmp_path, database):
    rotation = Pose(83.0, -3.0, 20.0).rotation
    field = synthetic_field(database.catalog, PORTRAIT, rotation, np.random.default_rng(1),
                            Condition(noise_px=0.3, missing=0.2, false_stars=0.2))
    path = frame_file(tmp_path, field.xy_px, 10 ** (-0.4 * field.v_mag))
    record = plot(capsys, path, *camera_options(PORTRAIT), "--output", tmp_path / "frame.png")
    assert record["parity"] == "normal"
    assert record["boresight"]["ra_deg"] == pytest.approx(83.0, abs=0.02)
    assert record["boresight"]["dec_deg"] == pytest.approx(-3.0, abs=0.02)
    assert record["boresight"]["roll_deg"] == pytest.approx(20.0, abs=0.1)
    true = np.where(field.catalog_index >= 0, database.catalog.number[field.catalog_index], 0)
    found = [star["star_number"] or 0 for star in record["stars"]]
    np.testing.assert_array_equal(found, true)
    n_false = int(np.sum(field.catalog_index < 0))
    assert n_false > 0
    assert record["unidentified"] == n_false
    assert record["missing"] > 0


@pytest.mark.slow
def test_hipparcos_stars_carry_their_own_names(tmp_path, capsys):
    catalog = StarCatalog.hipparcos(limiting_magnitude=5.5)
    rotation = Pose(83.0, -3.0, 20.0).rotation
    field = synthetic_field(catalog, PORTRAIT, rotation, np.random.default_rng(1))
    path = frame_file(tmp_path, field.xy_px)
    record = plot(capsys, path, *camera_options(PORTRAIT), "--parity", "normal", "--catalog",
                  "hipparcos", "--limiting-magnitude", "5.5", "--output", tmp_path / "a.png")
    hip = catalog.hip[field.catalog_index].tolist()
    assert [star["hip"] for star in record["stars"]] == hip
    solution = StarTracker(FeatureDatabase.build(catalog), PORTRAIT).solve(field.xy_px)
    names = tuple(f"C{i}" for i in range(len(hip)))
    with house_style():
        text = texts_of(draw_field(
            FieldView("orion", PORTRAIT, names, field.xy_px, solution, catalog)))
    assert all(f"{name}: HIP {number}\n" in text for name, number in zip(names, hip, strict=True))


def test_an_unsolved_frame_is_drawn_and_says_so(tmp_path, capsys, database):
    xy = uniform_noise(PORTRAIT, 6, np.random.default_rng(5))
    xy = np.concatenate([xy, [[5000.0, 10.0]]])
    path, output = frame_file(tmp_path, xy), tmp_path / "noise.png"
    record = plot(capsys, path, *camera_options(PORTRAIT), "--output", output)
    assert record["status"] == "NO_MATCH"
    assert record["boresight"] is None
    assert (record["unidentified"], record["ignored"], record["missing"]) == (7, 1, 0)
    assert output.is_file()
    patient = SolveSettings(deadline_ms=float("inf"))
    solution = StarTracker(database, PORTRAIT, patient).solve(xy)
    seen = FieldView("noise", PORTRAIT, tuple("1234567"), xy, solution, database.catalog)
    with house_style():
        text = " ".join(texts_of(draw_field(seen)).split())
    assert "noise: not solved, NO_MATCH: the best of" in text
    assert "parity unknown" in text


def test_an_empty_frame_is_drawn_under_any_name(tmp_path, capsys):
    path = frame_file(tmp_path, np.zeros((0, 2))).rename(tmp_path / "no$\\stars$.csv")
    record = plot(capsys, path, *camera_options(PORTRAIT), "--output", tmp_path / "a.png")
    assert record["status"] == "TOO_FEW_STARS"
    assert record["stars"] == []


def test_a_crowded_frame_leaves_names_out_and_says_so(database):
    camera = Camera.from_fov(60, 1200, 500)
    rotation = Pose(10.0, 89.0, 0.0).rotation  # with the pole in the image
    field = synthetic_field(database.catalog, camera, rotation, np.random.default_rng(2))
    solution = StarTracker(database, camera).solve(field.xy_px)
    assert len(field.xy_px) > 100
    names = tuple(f"star {i}" for i in range(len(field.xy_px)))
    seen = FieldView("crowd", camera, names, field.xy_px, solution, database.catalog)
    with house_style():
        figure = draw_field(seen)
    labels = [t for t in figure.findobj(Text) if t.get_label() == STAR_LABEL]
    boxes = [text_box(label) for label in labels if label.get_visible()]
    assert 20 < len(boxes) < len(labels)
    assert not [pair for pair in combinations(boxes, 2) if overlap_area(*pair) > 0]
    assert f"{len(labels) - len(boxes)} names left out" in texts_of(figure)


# What is refused


def test_what_cannot_be_drawn_is_refused_in_a_line(capsys, tmp_path):
    own = ("--fov-deg", 12, "--width-px", 512, "--height-px", 512)
    frame = frame_file(tmp_path, [[1, 2]])
    missing = tmp_path / "none.csv"
    assert "there is no map 9" in refusal(capsys, 9)
    unread = refusal(capsys, missing)
    assert f"{missing} cannot be read" in unread
    assert "--fov-deg" not in unread
    assert f"frame {missing} cannot be read: No such file" in refusal(capsys, missing, *own)
    assert "a plain file of x,y needs --fov-deg" in refusal(capsys, frame)
    assert "not known: give --height-px" in refusal(capsys, frame, *own[:-2])
    assert "has its own camera: leave out --fov-deg" in refusal(capsys, 1, *own)
    assert "fov_deg 300 is outside" in refusal(capsys, frame, "--fov-deg", 300, *own[2:])
    assert "--width-px must be a number greater than 0" in refusal(
        capsys, frame, "--width-px", 0)
    assert "--dpi must be at most 1200" in refusal(capsys, 1, "--dpi", 99999)
    assert "ends in .png, .svg or .pdf" in refusal(capsys, 1, "--output", "a.gif")
    nowhere = tmp_path / "no" / "a.png"
    assert f"{nowhere} cannot be written" in refusal(capsys, 1, "--output", nowhere)


@pytest.mark.parametrize(("text", "complaint"), [
    ("", "first line must name the columns"),
    ("1,2\n3,4\n", "first line must name the columns"),
    ("x,y\n1,2,3\n", "the row '1,2,3' does not have 2 columns"),
    ("x,y\n1,b\n", "not a table of numbers"),
    ("x,y\n1,nan\n", "a value is not a finite number"),
    ("row,col\n1,2\n", "first line must name the columns"),
    ("x,x_px,y\n1,2,3\n", "first line must name the columns"),
    (f"x,y\n1,{'2' * 200_000}\n", "not a table of numbers .field larger than"),
])
def test_a_damaged_frame_is_refused_with_its_name(tmp_path, text, complaint):
    path = tmp_path / "frame.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=complaint) as caught:
        read_frame(path)
    assert str(path) in str(caught.value)


def test_columns_are_found_by_their_names(tmp_path):
    path = tmp_path / "frame.csv"
    path.write_text("id,y,intensity,x\nfirst,2,30,1\nsecond,4,50,3\n", encoding="utf-8")
    xy, intensity = read_frame(path)
    np.testing.assert_array_equal(xy, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(intensity, [30, 50])


def test_a_frame_in_another_encoding_is_refused(tmp_path):
    path = tmp_path / "frame.csv"
    path.write_bytes(b"x,y\n\xff\xfe,1\n")
    with pytest.raises(ValueError, match="not text in UTF-8"):
        read_frame(path)


def test_columns_may_carry_their_unit_and_spaces(tmp_path):
    path = tmp_path / "frame.csv"
    path.write_text("\ufeffx_px, y_px, intensity\n1, 2, 3\n\n4, 5, 6\n", encoding="utf-8")
    xy, intensity = read_frame(path)
    assert xy.tolist() == [[1, 2], [4, 5]]
    assert intensity.tolist() == [3, 6]


def test_without_matplotlib_the_extra_is_named():
    """Other commands still work: nothing but a picture imports matplotlib."""
    script = (
        "import sys\n"
        "sys.modules['matplotlib'] = None\n"
        "from star_tracker.commands import cli\n"
        "assert cli.main(['geometry', '1', '--json']) == 0\n"
        "sys.exit(cli.main(['plot', '1']))\n"
    )
    result = completed("-c", script)
    assert result.returncode == 2
    assert result.stderr == (
        "star_tracker plot: pictures need matplotlib: apt install python3-matplotlib, or pip "
        "install matplotlib\n"
    )


# The parts


def test_labels_around_one_point_all_find_room():
    points = np.full((8, 2), 50.0) + np.arange(8)[:, None] * 0.1
    sizes = np.tile([12.0, 4.0], (8, 1))
    placed = place_labels(points, sizes, np.full(8, 2.0), np.zeros((0, 4)),
                          np.array([0.0, 0.0, 100.0, 100.0]))
    assert placed.shown.all()
    boxes = np.hstack([placed.centre - sizes / 2, placed.centre + sizes / 2])
    assert not [pair for pair in combinations(boxes, 2) if overlap_area(*pair) > 0]
    assert boxes.min() >= 0
    assert boxes.max() <= 100


def test_a_label_goes_where_no_symbol_is():
    wall = np.array([[52.0, 0.0, 80.0, 100.0]])  # all that is to the right
    placed = place_labels(np.array([[50.0, 50.0]]), np.array([[12.0, 4.0]]), np.array([2.0]),
                          wall, np.array([0.0, 0.0, 100.0, 100.0]))
    assert placed.centre[0] == pytest.approx([42.0, 50.0])


def test_grid_lines_lie_where_the_sky_has_them():
    rotation = Pose(359.0, 60.0, 37.0).rotation
    camera = Camera.from_fov(12, 512, 512)
    lines = grid_lines(camera, rotation)
    assert {line.is_ra for line in lines} == {True, False}
    for line in lines:
        xy = np.concatenate(line.paths)
        ra, dec = np.degrees(ra_dec(camera.vectors(xy) @ rotation.T))
        value = float(line.label[2:-1].replace("−", "-"))
        if line.is_ra:
            np.testing.assert_allclose((ra - value + 180) % 360 - 180, 0, atol=1e-3)
        else:
            np.testing.assert_allclose(dec, value, atol=1e-3)


def test_a_lens_without_rays_in_its_corners_has_a_grid_up_to_there():
    lens = Distortion("plumb_bob", (-0.405, 0.267, 0.0, 0.0, -0.130))
    camera = Camera(752, 480, 469.0, 469.0, 376.0, 240.0, distortion=lens)
    corner = np.array([[0.0, 0.0]])
    assert not camera.has_ray(corner).any()
    rotation = Pose(83.0, 0.0, 10.0).rotation
    lines = grid_lines(camera, rotation)
    assert {line.is_ra for line in lines} == {True, False}
    for line in lines:
        assert all(np.isfinite(path).all() for path in line.paths)
        # A line ends at the image's border, or a step of the grid before the lens has no ray.
        assert camera.has_ray(np.concatenate(line.paths)).all()


def test_a_field_of_a_lens_without_rays_in_its_corners_is_drawn():
    lens = Distortion("plumb_bob", (-0.405, 0.267, 0.0, 0.0, -0.130))
    camera = Camera(752, 480, 469.0, 469.0, 376.0, 240.0, distortion=lens)
    rotation = Pose(83.0, 0.0, 10.0).rotation
    catalog = StarCatalog.hipparcos(limiting_magnitude=4.5)  # each star has a label to place
    index, xy_px = visible_stars(catalog, camera, rotation)
    found = replace(
        Identification.empty(len(index)), catalog_index=index,
        state=np.full(len(index), StarState.IDENTIFIED, np.uint8),
    )
    attitude = Attitude.from_rotation(rotation, np.eye(3))
    solution = Solution(Status.SOLVED, "", found, attitude, parity="normal")
    labels = tuple(map(str, range(len(index))))
    seen = FieldView("barrel", camera, labels, xy_px, solution, catalog)
    with house_style():
        assert "barrel" in texts_of(draw_field(seen))


def test_a_guide_star_has_the_name_that_its_catalogue_gives_it():
    sky = StarCatalog(
        np.eye(3)[:2], np.full(2, 4.0), np.array([32349, 0]), np.zeros(2, int),
        gaia_source=np.array([0, 3328999114372334208]),
    )
    unsolved = Solution(Status.NO_MATCH, "", Identification.empty(0))
    seen = FieldView("", PORTRAIT, (), np.empty((0, 2)), unsolved, sky)
    assert [seen.guide_star_name(i) for i in range(2)] == [
        "HIP 32349", "Gaia DR3 3328999114372334208"
    ]


@pytest.mark.parametrize("dec_deg", [89.0, -90.0])
def test_around_a_pole_every_parallel_is_labelled_once(dec_deg):
    lines = grid_lines(Camera.from_fov(12, 512, 512), Pose(40.0, dec_deg, 0.0).rotation)
    labels = [line.label for line in lines]
    assert len(labels) == len(set(labels))
    assert sum(line.is_ra for line in lines) >= 8


def test_a_sky_map_shows_its_title_and_both_scales():
    boresights = unit_vectors(np.radians([0.0, 120.0, 240.0]), np.radians([-60.0, 0.0, 60.0]))
    counts = np.array([2, 1, 0])
    found = Survey(boresights, 2, np.array([3.0, 4.0, 5.0]), counts, counts, 0 * counts)
    assert found.rate_percent.tolist() == [100.0, 50.0, 0.0]
    with house_style():
        text = texts_of(draw_sky_map(found, "a title"))
    for part in ("a title", "guide stars in the field", "frames solved rightly, %"):
        assert part in text


def test_pairs_are_as_many_as_in_the_paper(database):
    """5.2.4.1: 149423 pairs below 12 deg, 294833 below 17 deg."""
    pairs = PairTable.build(database.catalog, float(np.radians(17)))
    edges, counts = pairs_per_bin(pairs)
    assert len(counts) == 1700
    assert counts[edges[1:] < 12.005].sum() == 149423
    assert counts.sum() == 294833
    with house_style():
        text = texts_of(draw_pairs(pairs, 4908))
    assert "149,423 pairs\nup to 12°" in text
    assert "294,833 pairs\nup to 17°" in text
