"""The database's patterns in a file: saved, read back, and refused with the file's name."""

import pickle
import re
from dataclasses import replace

import numpy as np
import pytest

from star_tracker import database as database_module
from star_tracker.catalog import StarCatalog
from star_tracker.database import MAX_PATTERN_STARS, FeatureDatabase
from star_tracker.patterns import PatternSettings, PatternTable

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


@pytest.fixture(scope="module")
def paper():
    return FeatureDatabase.build(StarCatalog.paper())


@pytest.fixture
def saved(small, tmp_path):
    path = tmp_path / "patterns.npz"
    small.save_patterns(path)
    return path


def contents(path):
    with np.load(path, allow_pickle=False) as content:
        return dict(content)


def rewritten(path, **changes):
    """Write the file again with other entries; None leaves one out."""
    entries = {**contents(path), **changes}
    np.savez(path, **{name: value for name, value in entries.items() if value is not None})


def assert_refused(database, path, text):
    with pytest.raises(ValueError, match=f"^pattern file {re.escape(str(path))} {text}"):
        database.with_patterns(path)


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
    text = f"^max_separation_deg {separation_deg:g} is outside of 0.5 to 30$"
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


# Saving and reading back


def test_patterns_come_back_as_they_were(small, saved, monkeypatch):
    def build(*_):
        pytest.fail("patterns of a file are not built")

    monkeypatch.setattr(PatternTable, "build", build)
    loaded = replace(small).with_patterns(saved)
    np.testing.assert_array_equal(loaded.patterns.packed, small.patterns.packed)
    assert loaded.patterns.settings == small.pattern_settings
    assert loaded.catalog is small.catalog
    assert loaded.pairs is small.pairs
    for factor in (1, 4):
        for name in ("radial", "companion", "cyclic"):
            np.testing.assert_array_equal(
                getattr(loaded.patterns.level(factor), name),
                getattr(small.patterns.level(factor), name),
            )


@pytest.mark.parametrize("name", ["patterns.npz", "patterns", "patterns.v1", "a b.npz"])
def test_the_file_has_the_name_asked_for(small, tmp_path, name):
    path = tmp_path / name
    small.save_patterns(path)
    assert [file.name for file in tmp_path.iterdir()] == [name]
    assert small.with_patterns(path).loaded_patterns is not None


def test_loaded_patterns_can_be_saved_again(small, saved, tmp_path):
    again = tmp_path / "again.npz"
    small.with_patterns(saved).save_patterns(again)
    for name, value in contents(saved).items():
        np.testing.assert_array_equal(contents(again)[name], value)


def test_the_original_database_is_left_as_it_was(small, saved):
    small.with_patterns(saved)
    assert small.loaded_patterns is None


def test_the_papers_patterns_fit_a_quarter_of_a_megabyte(paper, tmp_path):
    """4908 stars, rings of 0.05 deg: 31 bytes each are 152 kB."""
    path = tmp_path / "paper.npz"
    paper.save_patterns(path)
    assert path.stat().st_size <= 250_000
    np.testing.assert_array_equal(
        paper.with_patterns(path).patterns.packed, paper.patterns.packed
    )


# Refused files


def test_a_missing_file(small, tmp_path):
    assert_refused(small, tmp_path / "none.npz", "cannot be read: .*No such file")


def test_a_folder(small, tmp_path):
    assert_refused(small, tmp_path, "cannot be read: ")


@pytest.mark.parametrize("content", [b"", b"PK", b"not a pattern file", bytes(1000)])
def test_a_file_of_something_else(small, tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    assert_refused(small, path, "cannot be read: ")


def test_a_single_array_is_no_pattern_file(small, tmp_path):
    path = tmp_path / "single.npy"
    np.save(path, small.patterns.packed)
    assert_refused(small, path, "cannot be read: ")


def test_a_file_truncated_anywhere(small, saved):
    whole = saved.read_bytes()
    for length in range(0, len(whole), 37):
        saved.write_bytes(whole[:length])
        assert_refused(small, saved, "cannot be read: ")


def test_a_file_with_damage_in_its_patterns(small, saved):
    """The archive's checksum tells."""
    whole = bytearray(saved.read_bytes())
    at = whole.find(small.patterns.packed.tobytes())
    assert at > 0
    whole[at + 100] ^= 1
    saved.write_bytes(whole)
    assert_refused(small, saved, "cannot be read: .*CRC")


@pytest.mark.parametrize("damage", [0x01, 0x08, 0x40])
def test_damage_of_any_byte_is_refused_or_harmless(small, saved, damage):
    """The file's name is told, or the patterns are right.

    Each fifth byte, and each of the archive's directory, which takes the last 310 bytes.
    """
    whole, outcomes = saved.read_bytes(), set()
    for at in [*range(0, len(whole) - 310, 5), *range(len(whole) - 310, len(whole))]:
        saved.write_bytes(whole[:at] + bytes([whole[at] ^ damage]) + whole[at + 1:])
        try:
            loaded = small.with_patterns(saved)
        except ValueError as error:
            assert str(error).startswith(f"pattern file {saved} ")  # noqa: PT017
            outcomes.add("refused")
        except Exception as error:
            pytest.fail(f"byte {at} of {len(whole)} ^ {damage:#x}: {error!r}")
        else:
            np.testing.assert_array_equal(loaded.patterns.packed, small.patterns.packed)
    assert "refused" in outcomes


def test_a_pickle_is_not_loaded(small, tmp_path):
    path = tmp_path / "patterns.npz"
    path.write_bytes(pickle.dumps({"format": 1}))
    assert_refused(small, path, "cannot be read: ")


def test_an_archive_with_a_pickle_inside_is_not_loaded(small, saved):
    rewritten(saved, packed=np.array([{"format": 1}], dtype=object))
    assert_refused(small, saved, "cannot be read: Object arrays cannot be loaded")


@pytest.mark.parametrize("name", ["format", "catalog", "settings", "packed"])
def test_an_archive_without_an_entry(small, saved, name):
    rewritten(saved, **{name: None})
    assert_refused(small, saved, f"cannot be read: .*{name}")


@pytest.mark.parametrize("changes", [
    {"format": "star_tracker patterns, format 2"},
    {"format": ""},
    {"packed": np.zeros((N_STARS, 31), np.float32)},
    {"packed": np.zeros(N_STARS * 31, np.uint8)},
    {"packed": np.uint8(3)},
])
def test_another_format(small, saved, changes):
    rewritten(saved, **changes)
    assert_refused(small, saved, "has another format: save it again$")


OTHER = catalog_of(N_STARS)


@pytest.mark.parametrize("catalog", [
    catalog_of(N_STARS, seed=2),
    catalog_of(N_STARS - 1),
    catalog_of(N_STARS + 1),
    StarCatalog(OTHER.vectors[::-1], OTHER.v_mag, OTHER.hip[::-1], OTHER.number[::-1]),
    StarCatalog(OTHER.vectors, OTHER.v_mag, OTHER.hip + 1, OTHER.number),
    StarCatalog(OTHER.vectors, OTHER.v_mag, OTHER.hip, OTHER.number + 1),
], ids=["places", "one less", "one more", "order", "hip", "number"])
def test_another_catalogue(saved, catalog):
    other = FeatureDatabase.build(catalog)
    assert_refused(other, saved, "is of another catalogue: save it again$")


def test_another_epoch_of_the_papers_catalogue(paper, tmp_path):
    """Half a year of proper motion moves the fastest of the stars by more than 1e-6 rad."""
    path = tmp_path / "paper.npz"
    paper.save_patterns(path)
    other = FeatureDatabase.build(StarCatalog.paper(epoch=paper.catalog.epoch + 0.5))
    assert_refused(other, path, "is of another catalogue: save it again$")


def test_patterns_of_another_number_of_stars(small, saved):
    rewritten(saved, packed=small.patterns.packed[:-1])
    assert_refused(small, saved, "is of another catalogue: save it again$")


@pytest.mark.parametrize(
    "settings",
    [PatternSettings(np.radians(6), np.radians(0.06)), PatternSettings(np.radians(5.95)),
     PatternSettings(np.radians(3), np.radians(0.025))],
    ids=["ring", "radius", "both"],
)
def test_other_settings(small, saved, settings):
    other = replace(small, pattern_settings=settings)
    assert_refused(other, saved, "has other pattern settings: save it again$")


@pytest.mark.parametrize("settings", [
    np.zeros(3), np.float64(0.1), np.zeros((2, 2)), np.full(2, np.nan), np.array(["6", "0.05"]),
], ids=["three", "one", "table", "NaN", "text"])
def test_settings_that_are_none(small, saved, settings):
    rewritten(saved, settings=settings)
    assert_refused(small, saved, "")


@pytest.mark.parametrize("n_bytes", [0, 30, 32])
def test_patterns_of_another_number_of_bytes(small, saved, n_bytes):
    rewritten(saved, packed=np.zeros((N_STARS, n_bytes), np.uint8))
    assert_refused(small, saved, "has other pattern settings: save it again$")
