"""`star_tracker solve`: every kind of file, what is written, and what is refused."""

import csv
import json
import struct
from importlib.util import find_spec

import numpy as np
import pytest

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.commands import cli
from star_tracker.commands.solve_output import line_of
from star_tracker.detection.detect import detect_stars
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.maps.star_map import Pose
from star_tracker.offline.image_writing import write_image
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

CAMERA = Camera.from_fov(20, 320, 240, parity="normal")
POSE = Pose(84.0, 2.0, 15.0)
#: A quarter of a pixel: 4 arcmin to the pixel.
LIMIT_DEG = 0.016
LIBRARIES = {"Pillow": "PIL", "astropy": "astropy", "rosbags": "rosbags", "dask": "distributed",
             "matplotlib": "matplotlib"}


def needs(name):
    return pytest.mark.skipif(
        find_spec(LIBRARIES[name]) is None, reason=f"needs {name}, an extra"
    )


@pytest.fixture(scope="module")
def picture():
    """A small image of 12 bits in 16 of the sky at POSE, of half the default's gain."""
    catalog = StarCatalog.named("hipparcos", limiting_magnitude=8.0)
    return render(CAMERA, POSE.rotation, catalog, RenderSettings(seed=3)).image


@pytest.fixture(scope="module")
def picture8(picture):
    return np.clip(picture // 4, 0, 255).astype(np.uint8)


def run(capsys, *arguments, fov_deg=20):
    """Return exit code, lines of output and messages.

    The camera is told, within 5 %: to find it out takes seconds in each process. A frame may take
    as long as a busy machine needs.
    """
    told = ["--jobs", "1", "--fov-deg", str(fov_deg), "--deadline-ms", "1e9"]
    try:
        code = cli.main(["solve", *told, *map(str, arguments)])
    except SystemExit as end:
        code = end.code
    captured = capsys.readouterr()
    return code, captured.out.splitlines(), captured.err


def records(capsys, *arguments, fov_deg=20):
    code, lines, err = run(capsys, *arguments, "--json", fov_deg=fov_deg)
    assert (code, err) == (0, "")
    return [json.loads(line) for line in lines]


def assert_true(record):
    """Hold that the record has the attitude of POSE."""
    assert record["status"] == "SOLVED", record
    found = [record[name] for name in ("ra_deg", "dec_deg")]
    np.testing.assert_allclose(found, [POSE.ra_deg, POSE.dec_deg], atol=LIMIT_DEG)
    assert record["roll_deg"] == pytest.approx(POSE.roll_deg, abs=0.1)
    assert record["fov_deg"] == pytest.approx(20.0, abs=0.02)


# Kinds of files


@needs("Pillow")
@pytest.mark.parametrize("ending", ["png", "tif", "tiff"])
def test_images_of_16_bits(ending, picture, tmp_path, capsys):
    write_image(tmp_path / f"sky.{ending}", picture)
    (record,) = records(capsys, tmp_path / f"sky.{ending}")
    assert_true(record)


@needs("Pillow")
@pytest.mark.parametrize("ending", ["png", "tif", "bmp", "jpg"])
def test_images_of_8_bits(ending, picture8, tmp_path, capsys):
    from PIL import Image

    Image.fromarray(picture8).save(tmp_path / f"sky.{ending}", quality=95)
    (record,) = records(capsys, tmp_path / f"sky.{ending}")
    assert_true(record)


@needs("Pillow")
@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_images_with_colours(ending, picture8, tmp_path, capsys):
    from PIL import Image

    Image.fromarray(np.stack([picture8] * 3, axis=2)).save(tmp_path / f"sky.{ending}", quality=95)
    (record,) = records(capsys, tmp_path / f"sky.{ending}")
    assert_true(record)


@needs("astropy")
@pytest.mark.parametrize("ending", ["fits", "fit"])
def test_fits_images(ending, picture, tmp_path, capsys):
    write_image(tmp_path / f"sky.{ending}", picture)
    (record,) = records(capsys, tmp_path / f"sky.{ending}")
    assert_true(record)


def test_nothing_has_to_be_known_of_the_camera(picture, tmp_path, capsys):
    np.save(tmp_path / "sky.npy", picture)
    (record,) = records(capsys, tmp_path / "sky.npy", fov_deg=0)
    assert_true(record)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, ">u2"])
def test_arrays(kind, picture, picture8, tmp_path, capsys):
    np.save(tmp_path / "sky.npy", (picture8 if kind is np.uint8 else picture).astype(kind))
    (record,) = records(capsys, tmp_path / "sky.npy")
    assert_true(record)


def test_a_raw_image_of_a_colour_sensor(tmp_path, capsys):
    catalog = StarCatalog.named("hipparcos", limiting_magnitude=8.0)
    settings = RenderSettings(seed=3, bayer="rggb", exposure_s=0.5)
    np.save(tmp_path / "sky.npy", render(CAMERA, POSE.rotation, catalog, settings).image)
    (record,) = records(capsys, tmp_path / "sky.npy", "--bayer", "rggb")
    assert_true(record)


# Half a pixel


#: As ROS has it, counted from the middle of the first pixel; the principal point is elsewhere.
ROS_CAMERA = f"""
image_width: 320
image_height: 240
camera_matrix:
  data: [{CAMERA.fx_px}, 0, 109.5, 0, {CAMERA.fx_px}, 149.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [-0.3, 0, 0, 0, 0]}}
star_tracker: {{parity: normal, tolerance_percent: 0.5}}
"""
OFF_CENTER = Camera(
    320, 240, CAMERA.fx_px, CAMERA.fx_px, 110.0, 150.0, "normal",
    Distortion("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0)),
)


@pytest.fixture(scope="module")
def off_center(tmp_path_factory):
    """A folder with the camera's file, its image, and the list of its stars as OpenCV counts."""
    folder = tmp_path_factory.mktemp("ros")
    (folder / "camera.yaml").write_text(ROS_CAMERA, encoding="utf-8")
    catalog = StarCatalog.named("hipparcos", limiting_magnitude=8.0)
    image = render(OFF_CENTER, POSE.rotation, catalog, RenderSettings(seed=3)).image
    np.save(folder / "sky.npy", image)
    xy = detect_stars(image).xy_px - 0.5
    np.savetxt(folder / "list.csv", xy, delimiter=",", header="x,y", comments="", fmt="%.17g")
    return folder


def assert_boresight(record, part_px):
    """Hold that the boresight is that of POSE to a part of a pixel."""
    assert record["status"] == "SOLVED", record
    angles = np.radians([(record["ra_deg"], record["dec_deg"]), (POSE.ra_deg, POSE.dec_deg)])
    off_px = separation(*unit_vectors(*angles.T)) * CAMERA.fx_px
    assert off_px < part_px


@pytest.mark.parametrize(("file", "told"), [
    ("sky.npy", ()), ("list.csv", ("--pixel-origin", "center")),
])
def test_a_camera_file_counts_from_the_middle_of_the_first_pixel(
    file, told, off_center, tmp_path, capsys
):
    """Counted the other way the boresight would be off by 0.7 px."""
    pytest.importorskip("yaml", reason="reading camera files needs PyYAML")
    (record,) = records(
        capsys, off_center / file, "--camera", off_center / "camera.yaml", *told,
        "--width-px", 320, "--height-px", 240, "--wcs", tmp_path, "--stars", tmp_path,
    )
    assert_boresight(record, 0.1)
    header = (tmp_path / f"{file}.wcs").read_text()
    cards = {header[i : i + 8].strip(): header[i + 10 : i + 30] for i in range(0, len(header), 80)}
    principal = float(cards["CRPIX1"]), float(cards["CRPIX2"])
    assert principal == (110.5, 150.5)  # FITS begins with 1
    with (tmp_path / f"{file}.stars.csv").open(encoding="utf-8") as table:
        written = [(float(row["x_px"]), float(row["y_px"])) for row in csv.DictReader(table)]
    # The stars as the file counts them.
    listed = np.loadtxt(off_center / "list.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(
        written, listed + (0.0 if told else 0.5), atol=1e-12
    )


def test_render_counts_a_camera_file_alike(off_center, tmp_path, capsys):
    pytest.importorskip("yaml", reason="reading camera files needs PyYAML")
    camera = ("--camera", str(off_center / "camera.yaml"))
    assert cli.main([
        "render", str(tmp_path / "sky.npy"), *camera, "--ra-deg", str(POSE.ra_deg), "--dec-deg",
        str(POSE.dec_deg), "--roll-deg", str(POSE.roll_deg), "--seed", "3",
    ]) == 0
    capsys.readouterr()
    assert np.array_equal(np.load(tmp_path / "sky.npy"), np.load(off_center / "sky.npy"))


def test_star_maps_and_lists_of_centroids(tmp_path, capsys):
    from star_tracker.maps.star_map import paper_maps

    rows = "\n".join(f"{x},{y}" for x, y in paper_maps((1,))[0].xy_px)
    (tmp_path / "list.csv").write_text(f"x,y\n{rows}\n", encoding="utf-8")
    size = ("--width-px", 512, "--height-px", 512)
    for record in records(capsys, "1", tmp_path / "list.csv", *size, fov_deg=12):
        assert record["status"] == "SOLVED"
        assert record["ra_deg"] == pytest.approx(109.6, abs=0.01)


# What is written


def test_a_table_and_the_stars(picture, tmp_path, capsys):
    np.save(tmp_path / "sky.npy", picture)
    code, _, _ = run(
        capsys, tmp_path / "sky.npy", "--csv", tmp_path / "all.csv", "--stars", tmp_path / "stars"
    )
    assert code == 0
    with (tmp_path / "all.csv").open(encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert row["status"] == "SOLVED"
    assert row["topic"] == row["stamp_ns"] == ""
    with (tmp_path / "stars" / "sky.npy.stars.csv").open(encoding="utf-8") as file:
        stars = [row for row in csv.DictReader(file) if row["hip"]]
    assert len(stars) >= int(row["n_identified"])
    assert {"27989", "25336"} & {star["hip"] for star in stars}


@pytest.mark.slow
@needs("matplotlib")
def test_a_picture_is_drawn_over_the_image(picture, tmp_path, capsys):
    """The image is under the symbols: without it the ground between them is white."""
    from matplotlib.image import imread

    np.save(tmp_path / "sky.npy", picture)
    assert run(capsys, tmp_path / "sky.npy", "7", "--annotate", tmp_path / "drawn")[0] == 0
    (with_image,) = (tmp_path / "drawn").glob("sky.npy.png")
    (without,) = (tmp_path / "drawn").glob("map7.csv.png")
    inked = [
        np.mean(imread(path)[..., :3].mean(axis=2) < 0.999) for path in (with_image, without)
    ]
    assert inked[0] > 2 * inked[1]


# What is refused


def test_a_damaged_file_is_told_and_the_others_are_done(picture, tmp_path, capsys):
    np.save(tmp_path / "sky.npy", picture)
    bad = tmp_path / "bad.npy"
    bad.write_bytes((tmp_path / "sky.npy").read_bytes()[:1000])
    code, lines, err = run(capsys, bad, tmp_path / "sky.npy", tmp_path / "missing.npy")
    assert (code, err) == (1, "")
    assert lines[0].startswith(f"UNUSABLE  {bad} cannot be read: ")
    assert lines[1].startswith("SOLVED ")
    assert lines[2] == (
        f"UNUSABLE  {tmp_path / 'missing.npy'} cannot be read: there is no such file"
    )


def test_an_empty_pattern_is_told(tmp_path, capsys):
    code, lines, _ = run(capsys, tmp_path / "*.npy", "7")
    assert code == 1
    assert sorted(line.split()[0] for line in lines) == ["SOLVED", "UNUSABLE"]
    assert f"UNUSABLE  no file fits {tmp_path / '*.npy'}: check the folder and the ending" in lines


def test_a_quoted_pattern_names_its_files(picture, tmp_path, capsys):
    for name in ("a", "b"):
        np.save(tmp_path / f"{name}.npy", picture)
    found = records(capsys, tmp_path / "*.npy")
    assert [record["file"] for record in found] == [
        str(tmp_path / f"{name}.npy") for name in ("a", "b")
    ]


@pytest.mark.parametrize("image", [
    np.zeros((100, 100), np.uint8), np.full((100, 100), 255, np.uint8),
    np.full((100, 100), np.nan, np.float32), np.zeros((1, 1), np.uint8),
    np.zeros((0, 5), np.uint8), np.zeros(5, np.uint8), np.zeros((2, 2, 2, 2), np.uint8),
    np.zeros((9, 9), complex), np.array([["a", "b"]]),
])
def test_an_image_without_stars_gives_one_sentence(image, tmp_path, capsys):
    np.save(tmp_path / "sky.npy", image)
    code, lines, err = run(capsys, tmp_path / "sky.npy")
    assert code in {0, 1}
    assert err == ""
    (line,) = lines
    assert line.split()[0] in {"UNUSABLE", "TOO_FEW_STARS"}, line


@needs("Pillow")
def test_a_picture_too_large_is_refused_before_it_is_read(picture, tmp_path, capsys):
    """The head of a bitmap of 20,000 x 20,000 pixels, of which none follows."""
    np.save(tmp_path / "sky.npy", picture)
    huge = tmp_path / "huge.bmp"
    head = struct.pack("<IiiHHIIiiII", 40, 20_000, 20_000, 1, 24, 0, 0, 2835, 2835, 0, 0)
    huge.write_bytes(b"BM" + struct.pack("<IHHI", 54, 0, 0, 54) + head)
    code, lines, err = run(capsys, huge, tmp_path / "sky.npy")
    assert (code, err) == (1, "")
    assert lines[0].startswith(f"UNUSABLE  {huge} cannot be read: ")
    assert "400000000 pixels" in lines[0]
    assert lines[1].startswith("SOLVED ")


def test_files_of_one_name_do_not_overwrite_what_is_written_of_each_other(tmp_path, capsys):
    files = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        files.append(tmp_path / folder / "frame.csv")
        files[-1].write_text("x,y\n1,2\n")
    size = ["--width-px", "512", "--height-px", "512"]
    code, lines, err = run(capsys, *files, *size, "--stars", tmp_path / "stars")
    assert (code, lines) == (2, [])
    assert "have one name, and so would what is written of them" in err
    assert not (tmp_path / "stars").exists()
    assert len(run(capsys, *files, *size)[1]) == 2  # nothing is written
    assert run(capsys, files[0], files[0], *size, "--stars", tmp_path / "stars")[0] == 0


def test_a_line_says_how_many_centroids_lie_outside(tmp_path, capsys):
    path = tmp_path / "frame.csv"
    path.write_text("x,y\n1,2\n50,60\n600,70\n")
    size = ["--width-px", "512", "--height-px", "512"]
    _, (line,), _ = run(capsys, path, *size)
    assert "3 stars, 1 outside: 2 stars, at least 4 are needed" in line
    (record,) = records(capsys, path, *size)
    assert (record["n_detected"], record["n_ignored"], record["n_surplus"]) == (3, 1, 0)


@pytest.mark.parametrize(("angle", "shown"), [(359.99997, "0.00"), (359.99, "359.99")])
def test_a_full_turn_is_none(angle, shown):
    record = {
        "status": "SOLVED", "file": "a", "ra_deg": angle, "dec_deg": 0.0, "roll_deg": angle,
        "fov_deg": 12.0, "parity": "normal", "n_identified": 5, "n_detected": 5, "n_ignored": 0,
        "wrong_probability": 0.0, "rms_px": 0.1,
    }
    line = line_of(record)
    assert f"roll {shown} deg" in line
    assert f"RA {shown}" in line


@pytest.mark.parametrize(("options", "text"), [
    (["--fov-deg", "-5"], "fov_deg -5 is outside of"),
    (["--fov-deg", "nan"], "fov_deg nan is outside of"),
    (["--fov-tolerance-percent", "nan"], "tolerance_percent nan is outside of"),
    (["--epoch", "26.9"], "epoch 26.9 is outside of"),
    (["--catalog", "tycho"], "catalog 'tycho' is unknown"),
    (["--limiting-magnitude", "-30"], "limiting_magnitude -30 is outside of"),
    (["--bayer", "xyzw"], "--bayer xyzw is unknown: use rggb"),
    (["--storage", "sqlite3"], "--storage is that of --output-bag: name one"),
    (["--jobs", "0"], "--jobs must be at least 1"),
    (["--output-bag", "out"], "--output-bag takes what comes of one bag: name one at a time"),
    (["--csv", "no/such/folder/x.csv"], "no/such/folder/x.csv cannot be written: "),
    (["--scheduler", "here"], "--scheduler 'here' is no address"),
    (["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers at tcp://127.0.0.1:9"),
])
def test_what_cannot_be_done_is_refused_in_one_line(options, text, capsys):
    if "--scheduler" in options:
        pytest.importorskip("distributed")
    code, _, err = run(capsys, "7", *options)
    assert code == 2
    assert err.startswith(f"star_tracker solve: {text}")
    assert err.count("\n") == 1


def test_a_bag_without_rosbags_is_named_with_the_remedy(tmp_path, monkeypatch, capsys):
    import sys

    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    code, lines, err = run(capsys, "7", tmp_path / "bag.mcap")
    assert (code, err) == (1, "")
    assert lines[1] == "UNUSABLE  bags need rosbags: pip install rosbags"


# In parallel


def without_times(found):
    return [
        {key: value for key, value in record.items() if not key.endswith("_ms")}
        for record in found
    ]


@pytest.fixture
def three_files(picture, tmp_path):
    np.save(tmp_path / "a.npy", picture)
    np.save(tmp_path / "b.npy", picture[20:, 10:])
    (tmp_path / "c.npy").write_bytes(b"no array")
    return [tmp_path / f"{name}.npy" for name in "abc"]


def test_processes_give_what_one_process_gives(three_files, capsys):
    _, one, _ = run(capsys, *three_files, "--json")
    code, two, _ = run(capsys, *three_files, "--json", "--jobs", 2)
    assert code == 1
    assert without_times(map(json.loads, one)) == without_times(map(json.loads, two))


@pytest.mark.slow
@needs("dask")
def test_a_dask_cluster_gives_what_this_process_gives(three_files, capsys):
    """Its workers need not see the files."""
    import distributed

    _, one, _ = run(capsys, *three_files, "--json")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        scheduler_port=0,
    ) as cluster:
        code, two, _ = run(
            capsys, *three_files, "--json", "--scheduler", cluster.scheduler_address
        )
    assert code == 1
    assert without_times(map(json.loads, one)) == without_times(map(json.loads, two))


# Bags


@needs("rosbags")
def test_a_bag_gives_a_line_and_a_row_for_each_frame(tmp_path, capsys):
    bag, table, out = (tmp_path / name for name in ("maps.mcap", "all.csv", "out"))
    assert cli.main(["make-bag", str(bag), "--maps", "1,6"]) == 0
    assert capsys.readouterr().out == f"{bag}: centroids of 2 maps, 4 messages\n"
    found = records(capsys, bag, "--csv", table, "--output-bag", out, fov_deg=0)
    assert [(one["topic"], one["frame"], one["stamp_ns"]) for one in found] == [
        ("/centroids", 0, 946_684_800_000_000_000), ("/centroids", 1, 946_684_800_100_000_000),
    ]
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["stamp_ns"]) for row in rows] == [one["stamp_ns"] for one in found]
    assert [float(row["ra_deg"]) for row in rows] == [one["ra_deg"] for one in found]
    assert sorted(path.name for path in out.iterdir()) == ["metadata.yaml", "out.mcap"]


@needs("rosbags")
def test_a_damaged_bag_is_told_and_the_others_are_done(tmp_path, capsys):
    good, bad = tmp_path / "good.mcap", tmp_path / "bad.mcap"
    assert cli.main(["make-bag", str(good), "--maps", "1"]) == 0
    bad.write_bytes(good.read_bytes()[:500])
    capsys.readouterr()
    code, lines, err = run(capsys, bad, good, "1", fov_deg=12)
    assert (code, err) == (1, "")
    assert [line.split()[0] for line in lines] == ["SOLVED", "UNUSABLE", "SOLVED"]
    assert lines[1].startswith(f"UNUSABLE  {bad} cannot be read: ")


@needs("rosbags")
def test_bags_and_pictures_do_not_go_together(tmp_path, capsys):
    code, _, err = run(capsys, tmp_path / "bag.mcap", "--annotate", tmp_path / "drawn")
    assert code == 2
    assert err == (
        "star_tracker solve: --annotate draws over image files: leave it out for bags\n"
    )
