"""The contest's own files, for those who have them; they are no part of this package.

They are looked for in the folder that the environment variable STAR_TRACKER_ATTACHMENTS names, or
in `shared/attachments` beside the checkout.
"""

import csv
import importlib.util
import math
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from contest_files import read_contest_catalog, read_contest_map
from scipy.io import savemat

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.pairs import PairTable
from star_tracker.geometry.spherical import separation
from star_tracker.identification.labels import StarState
from star_tracker.maps.star_map import PAPER_MAPS, paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

BESIDE = Path(__file__).resolve().parents[3] / "shared" / "attachments"
FOLDER = Path(os.environ.get("STAR_TRACKER_ATTACHMENTS") or BESIDE)
HAS_XLRD = importlib.util.find_spec("xlrd") is not None
PATIENT = SolveSettings(deadline_ms=math.inf)
CAMERA = Camera.from_fov(12, 512, 512, parity="mirrored")
ARCSEC = np.pi / 180 / 3600

needs_files = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"the contest's files are not in {FOLDER}"
)
#: Where the files are there and the tests run for everybody, xlrd has to be there too.
needs_xlrd = pytest.mark.skipif(
    not HAS_XLRD and not (os.environ.get("CI") and FOLDER.is_dir()),
    reason="xlrd is not installed: pip install 'star_tracker[attachments]'",
)


@pytest.fixture(scope="module")
def contest_catalog():
    return read_contest_catalog(FOLDER / "star_catalogue.mat")


@pytest.fixture(scope="module")
def contest_maps():
    """The contest's maps by number."""
    assert HAS_XLRD, "xlrd is missing: pip install 'star_tracker[attachments]'"
    cameras = {number: star_map.camera for number, star_map in shipped_maps().items()}
    return {n: read_contest_map(FOLDER / f"xingtu0{n}.xls", cameras[n]) for n in PAPER_MAPS}


@pytest.fixture(scope="module")
def expected_ids():
    """Star numbers by (map, label), from the paper's tables 5-1 to 5-8."""
    with (FOLDER / "expected_ids.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {(int(row["map"]), row["label"]): int(row["star_number"]) for row in rows}


def shipped_maps():
    return dict(zip(PAPER_MAPS, paper_maps(), strict=True))


def labels_found(catalog, maps, parity):
    """Solve maps; return the star numbers by (map, label), and the labels of displaced stars."""
    database = FeatureDatabase.build(catalog)
    found, displaced = {}, set()
    for number, star_map in maps.items():
        camera = star_map.camera.with_parity(parity)
        solution = StarTracker(database, camera, PATIENT).solve(star_map.xy_px)
        assert solution.status is Status.SOLVED
        assert solution.parity == "mirrored"
        for i, label in enumerate(star_map.labels):
            index = int(solution.identification.catalog_index[i])
            found[number, label] = int(catalog.number[index]) if index >= 0 else 0
            if solution.identification.state[i] == StarState.DISPLACED:
                displaced.add(label)
    return found, displaced


@needs_files
def test_there_are_141_stars_to_identify(expected_ids):
    assert len(expected_ids) == 141


@needs_files
@needs_xlrd
@pytest.mark.parametrize("source", [pytest.param("shipped", marks=pytest.mark.slow), "contest"])
@pytest.mark.parametrize("parity", [pytest.param("mirrored", marks=pytest.mark.slow), "auto"])
def test_all_141_stars_of_the_contest_are_identified(
    contest_catalog, contest_maps, expected_ids, source, parity
):
    catalog = contest_catalog if source == "contest" else StarCatalog.paper()
    found, displaced = labels_found(catalog, contest_maps, parity)
    assert found == expected_ids
    assert displaced == {"F02", "F05", "F08"}


@needs_files
def test_shipped_maps_carry_the_numbers_of_the_papers_tables(expected_ids):
    shipped = {
        (number, label): int(star)
        for number, star_map in shipped_maps().items()
        for label, star in zip(star_map.labels, star_map.star_number, strict=True)
    }
    assert shipped == expected_ids


@needs_files
@needs_xlrd
@pytest.mark.parametrize("number", PAPER_MAPS)
def test_shipped_maps_are_the_contests_to_a_few_hundredths_of_a_pixel(contest_maps, number):
    """The contest's are rounded to 0.01 px; a few stars differ by arcseconds, 84" to a pixel."""
    ours, theirs = shipped_maps()[number], contest_maps[number]
    assert ours.labels == theirs.labels
    # 0.06 px with room for how 0.01 px is written in binary.
    assert np.max(np.abs(ours.xy_px - theirs.xy_px)) <= 0.0605
    assert np.median(np.abs(ours.xy_px - theirs.xy_px)) <= 0.0105


@needs_files
def test_the_contests_catalogue_has_the_same_stars_as_ours(contest_catalog):
    ours = StarCatalog.paper()
    np.testing.assert_array_equal(contest_catalog.number, ours.number)
    difference = separation(contest_catalog.vectors, ours.vectors) / ARCSEC
    assert np.median(difference) < 0.01
    # Components of double stars that the two catalogues do not choose alike (data/README.md).
    assert np.max(difference) < 10
    assert np.count_nonzero(difference > 1) <= 10


@needs_files
@pytest.mark.parametrize(("limit_deg", "pairs"), [(12.0, 149_423), (17.0, 294_833)])
def test_the_contests_catalogue_has_as_many_pairs(contest_catalog, limit_deg, pairs):
    assert PairTable.build(contest_catalog, np.radians(limit_deg)).n_pairs == pairs


@needs_files
def test_the_contests_catalogue_says_what_it_is(contest_catalog):
    assert contest_catalog.description == "contest, 4908 stars"
    assert contest_catalog.epoch == 2000.0
    assert not contest_catalog.hip.any()


# Refusals


def refused(function, path, *arguments):
    with pytest.raises(ValueError, match=re.escape(str(path))) as error:
        function(path, *arguments)
    return str(error.value)


def test_a_missing_catalogue_is_refused_by_name(tmp_path):
    path = tmp_path / "absent.mat"
    assert refused(read_contest_catalog, path).startswith(
        f"{path} is not the contest's star catalogue: "
    )


@pytest.mark.parametrize(
    "content",
    [b"", b"x" * 10, b"number,ra,dec,mag\n" * 100],
    ids=["empty", "short", "text"],
)
def test_a_file_that_is_no_mat_file_is_refused_by_name(tmp_path, content):
    path = tmp_path / "other.mat"
    path.write_bytes(content)
    assert refused(read_contest_catalog, path).startswith(
        f"{path} is not the contest's star catalogue: "
    )


@pytest.mark.parametrize("fraction", [0.001, 0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("compressed", [False, True])
def test_a_truncated_catalogue_is_refused_by_name(tmp_path, fraction, compressed):
    path = tmp_path / "short.mat"
    table = np.random.default_rng(1).random((500, 4))
    savemat(path, {"star_data": table}, do_compression=compressed)
    content = path.read_bytes()
    path.write_bytes(content[: int(fraction * len(content))])
    refused(read_contest_catalog, path)


@pytest.mark.parametrize(
    "variables", [{"stars": np.zeros((3, 4))}, {}], ids=["another name", "none"]
)
def test_a_mat_file_without_star_data_is_refused_by_name(tmp_path, variables):
    path = tmp_path / "other.mat"
    savemat(path, variables)
    assert "star_data" in refused(read_contest_catalog, path)


@pytest.mark.parametrize(
    "table",
    [np.zeros((3, 3)), np.zeros((3, 4, 2)), np.full((3, 4), np.nan)],
    ids=["three columns", "three axes", "not finite"],
)
def test_star_data_of_another_shape_is_refused_by_name(tmp_path, table):
    path = tmp_path / "other.mat"
    savemat(path, {"star_data": table})
    assert refused(read_contest_catalog, path) == (
        f"{path}: star_data is not a table of number, RA, Dec, magnitude"
    )


@pytest.mark.parametrize(
    "table", [np.array([["a", 1, 2, 3]], object), "text", {"a": 1}],
    ids=["cells", "text", "structure"],
)
def test_star_data_that_are_no_numbers_are_refused_by_name(tmp_path, table):
    path = tmp_path / "other.mat"
    savemat(path, {"star_data": table})
    refused(read_contest_catalog, path)


@needs_xlrd
def test_a_missing_map_is_refused_by_name(tmp_path):
    path = tmp_path / "absent.xls"
    assert refused(read_contest_map, path, CAMERA).startswith(
        f"{path} is not a star map of the contest: "
    )


@needs_xlrd
@pytest.mark.parametrize(
    "content",
    [b"", b"x" * 10, b"A01,1,2\n" * 1000, b"PK\x03\x04" * 99],
    ids=["empty", "short", "text", "zip"],
)
def test_a_file_that_is_no_spreadsheet_is_refused_by_name(tmp_path, content):
    path = tmp_path / "other.xls"
    path.write_bytes(content)
    assert refused(read_contest_map, path, CAMERA).startswith(
        f"{path} is not a star map of the contest: "
    )


@needs_files
@needs_xlrd
@pytest.mark.parametrize("fraction", [0.01, 0.1, 0.3, 0.5, 0.7, 0.9])
def test_a_truncated_map_is_refused_by_name(tmp_path, fraction):
    path = tmp_path / "short.xls"
    content = (FOLDER / "xingtu01.xls").read_bytes()
    path.write_bytes(content[: int(fraction * len(content))])
    refused(read_contest_map, path, CAMERA)


@needs_files
def test_a_catalogue_is_no_map_and_a_map_is_no_catalogue():
    refused(read_contest_catalog, FOLDER / "xingtu01.xls")
    if HAS_XLRD:
        refused(read_contest_map, FOLDER / "star_catalogue.mat", CAMERA)


def test_without_xlrd_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xlrd", None)
    text = "reading .xls files needs xlrd: pip install 'star_tracker[attachments]'"
    with pytest.raises(ImportError, match=f"^{re.escape(text)}$"):
        read_contest_map(tmp_path / "any.xls", CAMERA)
