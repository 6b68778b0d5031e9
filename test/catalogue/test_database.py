"""The feature database: built, for a camera, or out of a file of the cache."""

import pickle
import re
import resource
import subprocess
import zipfile
from dataclasses import fields, replace

import numpy as np
import pytest
from processes import popen
from waiting import longest_s

from star_tracker.catalogue import database as database_module
from star_tracker.catalogue import feature_file
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import MAX_PATTERN_STARS, FeatureDatabase
from star_tracker.catalogue.depth import Depth
from star_tracker.catalogue.pairs import PairTable
from star_tracker.catalogue.patterns import PatternSettings, PatternTable
from star_tracker.optics.camera import Camera

#: Stars close enough to have neighbours within 6 deg.
N_STARS = 12


def catalog_of(n, seed=1, spread=0.05):
    """A catalogue of n stars scattered about one direction."""
    vectors = np.array([0.0, 0.6, 0.8]) + np.random.default_rng(seed).normal(0, spread, (n, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    number = np.arange(1, n + 1)
    return StarCatalog(vectors, np.full(n, 4.0), number, number)


@pytest.fixture(scope="module")
def small():
    return FeatureDatabase.build(catalog_of(N_STARS))


@pytest.fixture
def paper(database):
    return database


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The folder in which the package caches: empty, and gone afterwards."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "star_tracker").mkdir()
    return tmp_path / "star_tracker"


@pytest.fixture
def saved(small, tmp_path):
    """The only file of the folder `tmp_path`, of the features of `small`."""
    assert FeatureDatabase.cached(small.catalog, folder=tmp_path).cache_note == ""
    return only_file(tmp_path)


def only_file(folder):
    (path,) = folder.iterdir()
    return path


def contents(path):
    with np.load(path, allow_pickle=False) as content:
        return dict(content)


def assert_same(one, other):
    for name, first, second in zip(PairTable._fields, one.pairs, other.pairs, strict=True):
        np.testing.assert_array_equal(first, second, err_msg=name)
        assert getattr(first, "dtype", None) == getattr(second, "dtype", None)
    np.testing.assert_array_equal(one.patterns.packed, other.patterns.packed)
    assert one.pattern_settings == other.pattern_settings == one.patterns.settings


def assert_built_again(database, path, text):
    """The file is named with what is wrong, and the next one finds a good file in its place."""
    again = FeatureDatabase.cached(database.catalog, folder=path.parent)
    note = f"feature file {re.escape(str(path))} {text}; it is built again"
    assert re.fullmatch(note, again.cache_note), again.cache_note
    assert_same(again, database)
    assert only_file(path.parent) == path
    assert FeatureDatabase.cached(database.catalog, folder=path.parent).cache_note == ""


@pytest.fixture
def nothing_is_built(monkeypatch):
    def build(*_):
        pytest.fail("what is in a file is not built")

    monkeypatch.setattr(PatternTable, "build", build)
    monkeypatch.setattr(PairTable, "build", build)


# Building


def test_patterns_are_made_at_first_use_and_once(small, monkeypatch):
    made = []
    build = PatternTable.build
    monkeypatch.setattr(PatternTable, "build", lambda *args: made.append(1) or build(*args))
    database = replace(small)
    assert made == []
    assert database.patterns is database.patterns
    assert made == [1]
    np.testing.assert_array_equal(database.patterns.packed, small.patterns.packed)


def test_the_settings_asked_for_are_those_of_the_patterns():
    settings = PatternSettings(np.radians(5.0), np.radians(0.1))
    database = FeatureDatabase.build(catalog_of(N_STARS), pattern_settings=settings)
    assert database.patterns.settings == settings
    assert database.patterns.packed.shape == (N_STARS, settings.n_bytes)
    assert FeatureDatabase.build(catalog_of(3)).pattern_settings == PatternSettings()


@pytest.mark.parametrize("separation_deg", [0.49, 30.1, np.nan, -1.0])
def test_a_separation_out_of_range_is_refused(separation_deg):
    text = f"^max_separation_deg {separation_deg:g} is outside of 0.5 to 30 .0 = automatic.$"
    with pytest.raises(ValueError, match=text):
        FeatureDatabase.build(catalog_of(3), max_separation_deg=separation_deg)


def test_a_catalogue_too_dense_for_patterns_is_refused_with_the_remedy():
    """Its pairs alone, for the primary, are fine."""
    vectors = np.random.default_rng(2).normal(size=(MAX_PATTERN_STARS + 1, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    none = np.zeros(len(vectors), np.int64)
    catalog = StarCatalog(vectors, np.full(len(vectors), 7.0), none, none)
    database = FeatureDatabase.build(catalog, max_separation_deg=0.5)
    text = (
        "15001 guide stars are too dense for method radial_cyclic, which takes 15000: "
        "lower limiting_magnitude or set method to match_group"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        _ = database.patterns


def test_a_catalogue_just_small_enough_is_not_refused(small, monkeypatch):
    monkeypatch.setattr(database_module, "MAX_PATTERN_STARS", N_STARS)
    assert len(replace(small).patterns.packed) == N_STARS
    monkeypatch.setattr(database_module, "MAX_PATTERN_STARS", N_STARS - 1)
    with pytest.raises(ValueError, match="12 guide stars are too dense"):
        _ = replace(small).patterns


def test_a_catalogue_without_patterns_says_so_and_what_to_do(small, monkeypatch):
    assert (small.patterns_available, small.patterns_note) == (True, "")
    monkeypatch.setattr(database_module, "MAX_PATTERN_STARS", N_STARS - 1)
    assert not small.patterns_available
    assert small.patterns_note == (
        "12 guide stars are too dense for method radial_cyclic, which takes 11: "
        "lower limiting_magnitude or set method to match_group"
    )


def test_what_cannot_be_built_is_refused_without_building(small, monkeypatch, nothing_is_built):
    FeatureDatabase.check(small.catalog, max_separation_deg=30)
    FeatureDatabase.check_patterns(small.catalog)
    monkeypatch.setattr("star_tracker.catalogue.pairs.MAX_DIRECTED_PAIRS", 100)
    with pytest.raises(ValueError, match="12 stars make 132 directed pairs up to 30 deg"):
        FeatureDatabase.check(small.catalog, max_separation_deg=30)
    monkeypatch.setattr(database_module, "MAX_PATTERN_STARS", N_STARS - 1)
    with pytest.raises(ValueError, match="12 guide stars are too dense"):
        FeatureDatabase.check_patterns(small.catalog)


def test_separation_and_patterns_of_the_papers_catalogue_are_the_papers(paper):
    assert paper.pairs.max_separation_rad == np.radians(12.0)
    assert paper.pattern_settings == PatternSettings()


def test_a_deeper_catalogue_has_pairs_and_patterns_as_far_as_suits_its_stars():
    """To V = 7 the paper's 12 deg hold 2 million directed pairs; here as many a star as there."""
    database = FeatureDatabase.build(StarCatalog.hipparcos(limiting_magnitude=7.0))
    companions = 2 * database.pairs.n_pairs / len(database.catalog)
    assert companions == pytest.approx(60.9, abs=3)
    vectors = database.catalog.vectors
    radius = database.pattern_settings.radius_rad
    inside = np.count_nonzero(vectors @ vectors[::50].T > np.cos(radius)) / len(vectors[::50])
    assert inside - 1 == pytest.approx(15, abs=1.5)


# For a camera


def test_the_papers_catalogue_is_the_same_for_every_camera(paper, home):
    for fov_deg in (12, 40):
        found = FeatureDatabase.for_camera(
            Camera.from_fov(fov_deg, 512, 512), catalog="paper", with_patterns=False
        )
        assert found.catalog.description == paper.catalog.description
        assert found.pattern_settings == paper.pattern_settings
        for first, second in zip(found.pairs, paper.pairs, strict=True):
            np.testing.assert_array_equal(first, second)
    assert len(list(home.iterdir())) == 1


def test_a_database_for_a_camera_has_its_depth_and_merges_what_it_cannot_resolve(home):
    camera = Camera.from_fov(40, 1024, 768)
    database = FeatureDatabase.for_camera(camera, epoch=2026.9)
    assert database.catalog.description == (
        "hipparcos, V <= 4.9, stars closer than 0.0884 deg merged, epoch 2026.9"
    )
    # 1400 stars: 54 companions each, at the mean density, lie within 22.6 deg.
    assert np.degrees(database.pairs.max_separation_rad) == pytest.approx(22.6, abs=0.5)
    assert database.loaded_patterns is not None
    assert len(list(home.iterdir())) == 1


@pytest.mark.usefixtures("home")
def test_what_is_chosen_holds_whatever_the_camera():
    depth = Depth(limiting_magnitude=3.0, min_separation_deg=0.3, max_separation_deg=9.0)
    database = FeatureDatabase.for_camera(
        Camera.from_fov(10, 1024, 768), depth=depth, with_patterns=False
    )
    assert database.catalog.description == (
        "hipparcos, V <= 3, stars closer than 0.3 deg merged, epoch 2000.0"
    )
    assert database.pairs.max_separation_rad == np.radians(9.0)
    assert database.loaded_patterns is None
    assert len(database.patterns.packed) == len(database.catalog)


@pytest.mark.usefixtures("home")
def test_an_unknown_catalogue_is_refused_for_a_camera_too():
    with pytest.raises(ValueError, match="catalog 'usno' is unknown: use paper, hipparcos, gaia"):
        FeatureDatabase.for_camera(Camera.from_fov(10, 512, 512), catalog="usno")


# Saving and reading back


@pytest.mark.usefixtures("saved")
def test_features_come_back_as_they_were(small, tmp_path, monkeypatch, nothing_is_built):
    loaded = FeatureDatabase.cached(small.catalog, folder=tmp_path)
    assert loaded.cache_note == ""
    monkeypatch.undo()
    assert_same(loaded, small)
    assert loaded.catalog is small.catalog
    for factor in (1, 4):
        for name in ("radial", "companion", "cyclic"):
            np.testing.assert_array_equal(
                getattr(loaded.patterns.level(factor), name),
                getattr(small.patterns.level(factor), name),
            )


def test_the_folder_is_made_and_holds_nothing_else(small, tmp_path):
    folder = tmp_path / "a b" / "c"
    FeatureDatabase.cached(small.catalog, folder=folder)
    assert re.fullmatch(r"features-[0-9a-f]{16}\.npz", only_file(folder).name)


def test_the_default_folder_is_the_packages_cache(small, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    FeatureDatabase.cached(small.catalog)
    assert only_file(tmp_path / "star_tracker").suffix == ".npz"


@pytest.mark.usefixtures("saved")
@pytest.mark.parametrize("changes", [
    {"max_separation_deg": 11.0},
    {"pattern_settings": PatternSettings(np.radians(6), np.radians(0.06))},
    {"pattern_settings": PatternSettings(np.radians(5.95))},
], ids=["separation", "ring", "radius"])
def test_other_settings_have_a_file_of_their_own(small, tmp_path, changes):
    other = FeatureDatabase.cached(small.catalog, folder=tmp_path, **changes)
    assert other.cache_note == ""
    assert len(list(tmp_path.iterdir())) == 2
    assert_same(
        FeatureDatabase.cached(small.catalog, folder=tmp_path, **changes),
        FeatureDatabase.build(small.catalog, **changes),
    )


def test_features_of_other_sources_have_a_file_of_their_own(small, tmp_path, monkeypatch):
    """An upgrade does not go on with what the version before has built."""
    for digest in ("one", "two", "two"):
        monkeypatch.setattr(database_module, "sources_digest", lambda digest=digest: digest)
        FeatureDatabase.cached(small.catalog, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_patterns_that_are_not_asked_for_are_not_made(small, tmp_path):
    for _ in range(2):
        database = FeatureDatabase.cached(small.catalog, with_patterns=False, folder=tmp_path)
        assert (database.cache_note, database.loaded_patterns) == ("", None)
        assert_same(database, small)
    assert FeatureDatabase.cached(small.catalog, folder=tmp_path).loaded_patterns is not None
    assert len(list(tmp_path.iterdir())) == 2


def test_a_catalogue_too_dense_for_patterns_is_cached_without_them(small, tmp_path, monkeypatch):
    monkeypatch.setattr(database_module, "MAX_PATTERN_STARS", N_STARS - 1)
    for _ in range(2):
        database = FeatureDatabase.cached(small.catalog, folder=tmp_path)
        assert (database.cache_note, database.loaded_patterns) == ("", None)
        with pytest.raises(ValueError, match="12 guide stars are too dense"):
            _ = database.patterns


def test_a_separation_out_of_range_is_refused_before_any_file(tmp_path):
    with pytest.raises(ValueError, match=r"^max_separation_deg 31 is outside of 0\.5 to 30 .*"):
        FeatureDatabase.cached(catalog_of(3), max_separation_deg=31, folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_papers_features_fit_six_megabytes(paper, tmp_path):
    """4908 stars, 31 bytes of patterns each, and 21 bytes for each pair and direction."""
    FeatureDatabase.cached(paper.catalog, folder=tmp_path)
    assert only_file(tmp_path).stat().st_size <= 6_000_000
    assert_same(FeatureDatabase.cached(paper.catalog, folder=tmp_path), paper)


#: Two of them at once: each waits for a line, so that both are imported before any of them starts.
SHARE = """
import sys
from pathlib import Path
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
catalog = StarCatalog.hipparcos(limiting_magnitude=4.5)
print("ready", flush=True)
sys.stdin.readline()
for _ in range(3):
    for path in Path(sys.argv[1]).glob("features-*"):
        path.unlink(missing_ok=True)
    database = FeatureDatabase.cached(catalog, folder=Path(sys.argv[1]))
    print(repr(database.cache_note), database.pairs.n_pairs, database.patterns.packed.sum())
"""


@pytest.mark.slow
def test_two_processes_share_a_folder(tmp_path):
    """Each takes the file away three times and makes it again: no half file is ever met."""
    both = [
        popen("-c", SHARE, tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=None)
        for _ in range(2)
    ]
    try:
        for process in both:
            assert process.stdout.readline() == "ready\n"
        for process in both:
            process.stdin.write("go\n")
            process.stdin.flush()
        answers = [process.communicate(timeout=longest_s())[0].splitlines() for process in both]
    finally:
        for process in both:
            process.kill()
            process.communicate()
    alone = FeatureDatabase.build(StarCatalog.hipparcos(limiting_magnitude=4.5))
    expected = f"'' {alone.pairs.n_pairs} {alone.patterns.packed.sum()}"
    assert answers == [[expected] * 3] * 2
    assert re.fullmatch(r"features-[0-9a-f]{16}\.npz", only_file(tmp_path).name)


# Folders that cannot be written


def unsaved(database, folder):
    found = FeatureDatabase.cached(database.catalog, folder=folder)
    assert_same(found, database)
    assert found.cache_note.count("\n") == 0
    return found.cache_note


def test_a_folder_that_cannot_be_made_is_named_once_and_the_features_are_built(small, tmp_path):
    (tmp_path / "file").touch()
    note = unsaved(small, tmp_path / "file" / "folder")
    place = re.escape(str(tmp_path / "file" / "folder" / "features-"))
    assert re.fullmatch(f"feature file {place}[0-9a-f]{{16}}.npz cannot be saved: .+", note)


def test_a_read_only_folder(small, tmp_path):
    """The superuser may write into any folder of a disk: /proc takes no file of anybody."""
    note = unsaved(small, database_module.Path("/proc/star_tracker"))
    assert note.startswith("feature file /proc/star_tracker/features-")
    tmp_path.chmod(0o555)
    try:
        note = unsaved(small, tmp_path)
    finally:
        tmp_path.chmod(0o755)
    assert note == "" or note.endswith("cannot be saved: Permission denied")


def test_a_full_disk_leaves_nothing_behind(small, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        note = unsaved(small, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert note.endswith("cannot be saved: File too large")
    assert not list(tmp_path.iterdir())


def test_a_file_that_may_be_read_but_not_replaced(small, saved, monkeypatch):
    saved.write_bytes(b"damaged")

    def refuse(*_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(database_module, "save_features", refuse)
    note = unsaved(small, saved.parent)
    assert re.fullmatch(
        f"feature file {re.escape(str(saved))} cannot be read: .+; it is built again; "
        f"feature file {re.escape(str(saved))} cannot be saved: Read-only file system", note
    )


def test_a_user_without_a_home(small, monkeypatch):
    monkeypatch.setattr(database_module, "cache_folder", lambda: None)
    assert unsaved(small, None) == "there is no home for a cache of the features"


# Files that are not right


def test_a_folder_in_the_files_place(small, saved):
    saved.unlink()
    saved.mkdir()
    note = unsaved(small, saved.parent)
    assert note.startswith(f"feature file {saved} cannot be read: ")
    assert f"feature file {saved} cannot be saved: " in note
    assert only_file(saved.parent) == saved


@pytest.mark.parametrize("content", [b"", b"PK", b"not a feature file", bytes(1000)])
def test_a_file_of_something_else(small, saved, content):
    saved.write_bytes(content)
    assert_built_again(small, saved, "cannot be read: .*")


def test_a_single_array_is_no_feature_file(small, saved):
    with saved.open("wb") as file:
        np.save(file, small.patterns.packed)
    assert_built_again(small, saved, "cannot be read: .*")


@pytest.mark.parametrize("tenth", range(10))
def test_a_truncated_file(small, saved, tenth):
    whole = saved.read_bytes()
    saved.write_bytes(whole[: len(whole) * tenth // 10])
    assert_built_again(small, saved, "cannot be read: .*")


def test_a_file_truncated_anywhere_is_refused(small, saved):
    whole = saved.read_bytes()
    name = str(contents(saved)["identity"])
    for length in range(0, len(whole), 37):
        saved.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"^cannot be read: "):
            feature_file.load_features(saved, name, small.pattern_settings)


@pytest.mark.parametrize("damage", [
    0x01, pytest.param(0x08, marks=pytest.mark.slow), pytest.param(0x40, marks=pytest.mark.slow),
    0xFF,
])
def test_damage_of_any_byte_is_refused_or_harmless(small, saved, damage):
    """Each 23rd byte, and each third of the archive's directory at its end."""
    whole, outcomes = saved.read_bytes(), set()
    name = str(contents(saved)["identity"])
    directory = whole.index(b"PK\x01\x02")
    for at in [*range(0, directory, 23), *range(directory, len(whole), 3)]:
        saved.write_bytes(whole[:at] + bytes([whole[at] ^ damage]) + whole[at + 1:])
        try:
            loaded = feature_file.load_features(saved, name, small.pattern_settings)
        except ValueError:
            outcomes.add("refused")
        except Exception as error:
            pytest.fail(f"byte {at} of {len(whole)} ^ {damage:#x}: {error!r}")
        else:
            assert_same(replace(small, pairs=loaded.pairs, loaded_patterns=loaded.patterns), small)
    assert "refused" in outcomes


class Witness:
    """Unpickled, it makes a folder."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return database_module.Path.mkdir, (self.path,)


def test_a_pickle_is_not_loaded(small, saved, tmp_path_factory):
    witness = tmp_path_factory.mktemp("witness") / "was here"
    saved.write_bytes(pickle.dumps(Witness(witness)))
    assert_built_again(small, saved, "cannot be read: .*")
    entries = {**contents(saved), "packed": np.array([Witness(witness)], dtype=object)}
    with saved.open("wb") as file:
        np.savez(file, **entries)
    assert_built_again(small, saved, "cannot be read: Object arrays cannot be loaded.*")
    assert not witness.exists()


def test_an_entry_that_claims_more_than_memory_holds(small, saved):
    header = b"{'descr': '|u1', 'fortran_order': False, 'shape': (1152921504606846976,)}"
    head = header.ljust(118 - 1) + b"\n"
    with zipfile.ZipFile(saved, "w") as archive:
        archive.writestr("packed.npy", b"\x93NUMPY\x01\x00" + b"\x76\x00" + head)
    assert_built_again(small, saved, "cannot be read: .*")


OTHER = catalog_of(N_STARS)


@pytest.mark.parametrize("catalog", [
    catalog_of(N_STARS, seed=2),
    catalog_of(N_STARS - 1),
    catalog_of(N_STARS + 1),
    StarCatalog(OTHER.vectors[::-1], OTHER.v_mag, OTHER.hip[::-1], OTHER.number[::-1]),
    StarCatalog(OTHER.vectors, OTHER.v_mag, OTHER.hip + 1, OTHER.number),
    StarCatalog(OTHER.vectors, OTHER.v_mag, OTHER.hip, OTHER.number + 1),
], ids=["places", "one less", "one more", "order", "hip", "number"])
def test_a_file_of_another_catalogue(small, saved, catalog, tmp_path_factory):
    folder = tmp_path_factory.mktemp("other")
    FeatureDatabase.cached(catalog, folder=folder)
    only_file(folder).replace(saved)
    assert_built_again(small, saved, "is of another catalogue or of other settings")


def test_another_epoch_of_the_papers_catalogue_is_another_catalogue(paper, tmp_path):
    for epoch in (paper.catalog.epoch, paper.catalog.epoch + 0.01):
        catalog = StarCatalog.paper(epoch=epoch)
        FeatureDatabase.cached(catalog, with_patterns=False, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("name", ["identity", *PairTable._fields, "packed"])
def test_a_file_without_an_entry(small, saved, name):
    entries = contents(saved)
    del entries[name]
    with saved.open("wb") as file:
        np.savez(file, **entries)
    assert_built_again(small, saved, "cannot be read: .*")


def test_every_attribute_is_read_back():
    """A new one has to go into the file, too, or be made anew."""
    assert [field.name for field in fields(FeatureDatabase)] == [
        "catalog", "pairs", "pattern_settings", "triangle_grid", "loaded_patterns", "cache_note",
    ]
