"""The star catalogue: the shipped file, proper motion, blends, refusals."""

import csv
import hashlib
import pickle
import re

import numpy as np
import pytest

from star_tracker.catalogue import catalog as catalog_module
from star_tracker.catalogue.catalog import (
    CATALOG_DTYPE,
    CATALOG_FILE,
    StarCatalog,
    read_catalog_file,
    star_name,
)
from star_tracker.catalogue.gaia import GAIA_EPOCH
from star_tracker.geometry.spherical import position_angle, separation, unit_vectors
from star_tracker.resources import resource_path

MAS = np.pi / 180 / 3600e3
ARCSEC = 1000 * MAS


def row(hip, ra_deg, dec_deg, v_mag, *, number=0, pm=(0.0, 0.0)):
    return (hip, number, ra_deg, dec_deg, *pm, v_mag, 0.5)


#: Castor A and B, 3.9 arcsec apart; together V = 1.58 (Hoffleit and Warren 1991, HR 2890/2891).
CASTOR_A = row(36850, 113.65, 31.8883, 1.93, number=11)
CASTOR_B = row(900001, 113.6512, 31.8885, 2.97, number=12)
#: Algieba A and B, 4.6 arcsec apart.
ALGIEBA_A = row(50583, 154.9931, 19.8415, 2.37)
ALGIEBA_B = row(900002, 154.9943, 19.8409, 3.64)
POLLUX = row(37826, 116.3289, 28.0262, 1.16, number=13)


@pytest.fixture
def sky(tmp_path, monkeypatch):
    """A function that makes the package's catalogue file hold just the given rows."""

    def use(*rows):
        path = tmp_path / "tiny.npy"
        np.save(path, np.array(sorted(rows, key=lambda r: r[2]), CATALOG_DTYPE))
        monkeypatch.setattr(catalog_module, "resource_path", lambda _: path)

    return use


@pytest.fixture(scope="module")
def paper():
    return StarCatalog.paper()


@pytest.fixture(scope="module")
def shipped():
    return read_catalog_file(resource_path(CATALOG_FILE))


def star(catalog, hip):
    (index,) = np.flatnonzero(catalog.hip == hip)
    return catalog.vectors[index]


# The shipped file


def test_paper_catalogue_is_the_4908_numbered_stars_in_order(paper):
    np.testing.assert_array_equal(paper.number, np.arange(1, 4909))


def test_paper_numbers_ascend_with_right_ascension(paper):
    ra, _ = paper.ra_dec_rad
    assert np.all(np.diff(ra) >= 0)


def test_no_two_stars_of_the_paper_are_closer_than_its_limit(paper):
    """Both members of pairs closer than 0.05 deg were deleted, to the 1" by which data differ."""
    order = np.argsort(paper.vectors[:, 2])
    z = paper.vectors[order]
    for step in range(1, 40):
        assert np.min(separation(z[step:], z[:-step])) > np.radians(0.05) - ARCSEC


def test_shipped_file_is_hipparcos_to_v_8_and_three_tycho_stars(shipped):
    assert len(shipped) == 41_414
    assert np.count_nonzero(shipped["hip"] > 0) == 41_411
    assert len(np.unique(shipped["hip"])) == 41_411 + 1
    tycho = shipped[shipped["hip"] == 0]
    np.testing.assert_array_equal(np.sort(tycho["number"]), (1304, 2936, 3788))
    assert np.max(shipped["v_mag"]) <= 8.0


def test_shipped_file_is_the_one_that_its_readme_describes():
    digest = hashlib.sha256(resource_path(CATALOG_FILE).read_bytes()).hexdigest()
    assert digest in resource_path("data/README.md").read_text(encoding="utf-8")


def test_numbers_and_hipparcos_names_are_those_of_the_cross_identification(paper):
    with resource_path("data/crossid.csv").open(encoding="utf-8", newline="") as file:
        known = {int(r["number"]): int(r["hip"] or 0) for r in csv.DictReader(file)}
    assert dict(zip(paper.number.tolist(), paper.hip.tolist(), strict=True)) == known


def test_rows_are_shared_and_so_read_only(shipped):
    with pytest.raises(ValueError, match="read-only"):
        shipped["v_mag"][0] = 0


def test_hipparcos_is_cut_at_the_limiting_magnitude():
    catalog = StarCatalog.hipparcos(limiting_magnitude=5.0, min_separation_deg=0.0)
    assert np.max(catalog.v_mag) <= 5.0
    # Hipparcos is complete there: the naked-eye sky has about 1600 stars to V = 5.
    assert 1500 < len(catalog) < 1700


def test_hipparcos_has_castor_and_the_paper_has_not(paper):
    assert 36850 in StarCatalog.hipparcos().hip
    assert 36850 not in paper.hip


@pytest.mark.parametrize("name", ["paper", "hipparcos"])
def test_catalogues_by_name(name):
    named, direct = StarCatalog.named(name), getattr(StarCatalog, name)()
    np.testing.assert_array_equal(named.vectors, direct.vectors)
    assert named.description == direct.description


def test_named_passes_its_limits_on():
    catalog = StarCatalog.named(
        "hipparcos", limiting_magnitude=4.0, min_separation_deg=0.5, epoch=2020.0
    )
    assert catalog.epoch == 2020.0
    assert catalog.description == (
        "hipparcos, V <= 4, stars closer than 0.5 deg merged, epoch 2020.0"
    )


def test_description_says_what_was_selected():
    assert StarCatalog.paper(epoch=2027.5).description == "paper, 4908 stars, epoch 2027.5"
    assert StarCatalog.hipparcos(limiting_magnitude=3).description == (
        "hipparcos, V <= 3, stars closer than 0.05 deg merged, epoch 2000.0"
    )


@pytest.mark.parametrize(
    ("names", "shown"),
    [((32349, 77, 5), "HIP 32349"), ((0, 77, 0), "star 77"), ((0, 0, 4472832130942575872),
     "Gaia DR3 4472832130942575872")],
)
def test_a_star_is_called_by_its_hipparcos_number_first(names, shown):
    assert star_name(*names) == shown


def test_a_catalogue_names_its_stars(paper):
    assert paper.name(2410) == "HIP 55203"
    assert paper.name(1303) == "star 1304"  # of Tycho-2


# Proper motion


@pytest.mark.parametrize(
    ("hip", "ra_deg", "dec_deg"),
    [
        (69673, 213.91811403, 19.18726997),  # Arcturus, 2.3 arcsec a year
        (104214, 316.71181258, 38.74149446),  # 61 Cygni A, 5.3 arcsec a year
    ],
)
def test_positions_of_1991_25_are_those_that_esa_published(hip, ra_deg, dec_deg):
    """ESA 1997, SP-1200, fields H8 and H9, are the positions at the epoch J1991.25.

    That east turns by way * tan(dec) on the way is left out: 46" * 46" * tan(39 deg) = 8 mas.
    """
    found = star(StarCatalog.paper(epoch=1991.25), hip)
    published = unit_vectors(np.radians(ra_deg), np.radians(dec_deg))
    assert separation(found, published) < 10 * MAS


def test_61_cygni_moves_north_east_by_its_proper_motion(paper):
    """4155.10 mas/yr east and 3258.90 mas/yr north (SP-1200, H12 and H13) for 50 years."""
    then, now = star(paper, 104214), star(StarCatalog.paper(epoch=2050.0), 104214)
    way = 50 * np.hypot(4155.10, 3258.90) * MAS
    # The way is laid off along the tangent: short of the arc by way^3 / 3, which is nothing.
    assert separation(then, now) == pytest.approx(way, rel=1e-5)
    assert position_angle(then, now) == pytest.approx(np.arctan2(4155.10, 3258.90), abs=1e-4)


def test_arcturus_of_2027_by_hand(paper):
    """27 years of -1093.45 and -1999.40 mas/yr: 31.2" west on the sky and 54.0" south."""
    ra0, dec0 = (np.degrees(c[2933]) for c in paper.ra_dec_rad)
    ra1, dec1 = (np.degrees(c[2933]) for c in StarCatalog.paper(epoch=2027.0).ra_dec_rad)
    assert 3600 * (dec1 - dec0) == pytest.approx(-53.984, abs=0.002)
    assert 3600 * (ra1 - ra0) * np.cos(np.radians(dec0)) == pytest.approx(-29.523, abs=0.01)


def test_proper_motion_in_right_ascension_is_along_the_sky(sky):
    """A star at declination 60 deg moves by its motion, not by half or twice of it."""
    sky(row(1, 40.0, 60.0, 3.0, number=1, pm=(1000.0, 0.0)))
    then, now = StarCatalog.paper().vectors[0], StarCatalog.paper(epoch=2010.0).vectors[0]
    assert separation(then, now) / ARCSEC == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize(
    ("hip", "ra_deg", "dec_deg", "within_arcsec"),
    [
        # Centres of light of Gaia DR3's places of J2016.0: xi UMa A and B (756853643638639104,
        # 756853643637996160); xi Sco A and B (4343066192373820800, 4343066192373234048), whose
        # motion starts from a place that is good to 0.75". 94 Aqr B is 2411855072801159040, HIP
        # 31067 is 3369454521490604416; their places of 1991.25 are good to an arcsecond.
        (55203, 169.543320, 31.526723, 0.2),
        (78727, 241.091992, -11.373201, 0.75),
        (115125, 349.778739, -13.455716, 1.2),
        (31067, 97.791581, 16.938420, 1.0),
    ],
)
def test_stars_without_a_hipparcos_solution_are_where_gaia_saw_them(
    hip, ra_deg, dec_deg, within_arcsec
):
    catalog = StarCatalog.hipparcos(
        limiting_magnitude=8.0, min_separation_deg=0.0, epoch=GAIA_EPOCH
    )
    seen = unit_vectors(np.radians(ra_deg), np.radians(dec_deg))
    assert separation(star(catalog, hip), seen) < within_arcsec * ARCSEC


def test_the_papers_two_stars_without_a_solution_start_where_they_always_did(paper):
    """The catalogue of the paper's 4908 stars is one to compare with; see data/README.md."""
    for number, (ra_deg, dec_deg) in {
        2411: (169.546833333, 31.530777778), 3306: (241.090125, -11.373555556),
    }.items():
        np.testing.assert_array_equal(
            paper.vectors[number - 1], unit_vectors(np.radians(ra_deg), np.radians(dec_deg))
        )
    way = separation(star(paper, 55203), star(StarCatalog.paper(epoch=2010.0), 55203))
    assert way / ARCSEC == pytest.approx(7.28, abs=0.01)  # ten years of -0.432" and -0.586"


def test_catalogue_is_on_the_unit_sphere_at_every_epoch():
    for epoch in (1900.0, 2100.0):
        lengths = np.linalg.norm(StarCatalog.paper(epoch=epoch).vectors, axis=1)
        np.testing.assert_allclose(lengths, 1, rtol=0, atol=1e-14)


# Blends


def test_castor_becomes_one_star_of_joint_light(sky):
    sky(CASTOR_A, CASTOR_B, POLLUX)
    catalog = StarCatalog.hipparcos()
    np.testing.assert_array_equal(catalog.hip, (36850, 37826))
    np.testing.assert_array_equal(catalog.number, (11, 13))
    # 10^(-0.4 * 1.93) + 10^(-0.4 * 2.97) = 0.16904 + 0.06486; the sky's Castor has V = 1.58
    assert catalog.v_mag[0] == pytest.approx(1.577, abs=0.001)


def test_a_blend_lies_at_its_centre_of_light(sky):
    sky(CASTOR_A, CASTOR_B)
    (blend,) = StarCatalog.hipparcos().vectors
    a, b = (unit_vectors(*np.radians(s[2:4])) for s in (CASTOR_A, CASTOR_B))
    # B gives 0.06486 of 0.23390 of the light.
    assert separation(a, blend) / separation(a, b) == pytest.approx(0.2773, abs=0.0005)
    assert separation(a, blend) + separation(blend, b) == pytest.approx(separation(a, b))


def test_two_blends_stay_two_stars(sky):
    sky(CASTOR_A, CASTOR_B, ALGIEBA_A, ALGIEBA_B, POLLUX)
    np.testing.assert_array_equal(StarCatalog.hipparcos().hip, (36850, 37826, 50583))


def test_a_single_star_is_left_exactly_as_it_is(sky):
    sky(CASTOR_A, CASTOR_B, POLLUX)
    catalog = StarCatalog.hipparcos()
    np.testing.assert_array_equal(
        star(catalog, 37826), unit_vectors(*np.radians([116.3289, 28.0262]))
    )
    assert catalog.v_mag[catalog.hip == 37826] == np.float32(1.16)


def test_the_fainter_member_may_come_first_in_the_file(sky):
    sky(row(1, 10.0, 0.0, 5.0), row(2, 10.01, 0.0, 4.0))
    np.testing.assert_array_equal(StarCatalog.hipparcos().hip, [2])


def test_members_of_equal_light_meet_in_the_middle(sky):
    sky(row(1, 10.0, 0.0, 5.0), row(2, 10.02, 0.0, 5.0))
    catalog = StarCatalog.hipparcos()
    assert np.degrees(catalog.ra_dec_rad[0][0]) == pytest.approx(10.01, abs=1e-9)
    # Twice the light is 2.5 log10(2) = 0.7526 mag brighter.
    assert catalog.v_mag[0] == pytest.approx(5 - 0.7526, abs=1e-4)


def test_a_star_takes_its_own_neighbours_and_no_chain_of_theirs(sky):
    """The ends are 0.08 deg apart, each within 0.05 deg of the star between: the brightest end
    takes that star, and the other end is left."""
    sky(row(1, 10.0, 0.0, 5.0), row(2, 10.04, 0.0, 5.0), row(3, 10.08, 0.0, 4.5))
    catalog = StarCatalog.hipparcos()
    np.testing.assert_array_equal(catalog.hip, [1, 3])
    # 3 and 2 give 10^(-0.4 * 4.5) and 10^(-0.4 * 5.0) of light: 2 gives 0.3869 of it.
    expected = [10.0, 10.08 - 0.04 * 0.3869]
    np.testing.assert_allclose(np.degrees(catalog.ra_dec_rad[0]), expected, atol=1e-5)


def test_stars_that_are_too_faint_to_matter_are_not_merged(sky):
    """2 mag below the limit a star still counts for the light of another; below that none does."""
    sky(row(1, 10.0, 0.0, 4.0), row(2, 10.04, 0.0, 5.99), row(3, 20.0, 0.0, 4.0),
        row(4, 20.04, 0.0, 6.01))
    catalog = StarCatalog.hipparcos(limiting_magnitude=4.0)
    ra_deg = np.degrees(catalog.ra_dec_rad[0])
    assert ra_deg[0] == pytest.approx(10 + 0.04 * 0.1379, abs=1e-4)
    assert ra_deg[1] == pytest.approx(20, abs=1e-9)


def test_two_stars_too_faint_to_be_seen_may_be_seen_together(sky):
    sky(row(1, 10.0, 0.0, 5.0), row(2, 10.04, 0.0, 5.0), row(3, 20.0, 0.0, 5.0))
    np.testing.assert_array_equal(StarCatalog.hipparcos(limiting_magnitude=4.5).hip, [1])


@pytest.mark.parametrize(("apart_deg", "count"), [(0.0499, 1), (0.0501, 2)])
def test_only_stars_closer_than_the_limit_are_a_blend(sky, apart_deg, count):
    sky(row(1, 10.0, 0.0, 5.0), row(2, 10.0, apart_deg, 5.0))
    assert len(StarCatalog.hipparcos(min_separation_deg=0.05)) == count


def test_nothing_is_a_blend_at_separation_zero(sky):
    sky(CASTOR_A, CASTOR_B)
    assert len(StarCatalog.hipparcos(min_separation_deg=0.0)) == 2


def test_a_group_across_right_ascension_zero_is_found(sky):
    sky(row(1, 0.01, 0.0, 5.0), row(2, 359.99, 0.0, 5.0))
    (centre,) = StarCatalog.hipparcos().vectors
    np.testing.assert_allclose(centre, (1, 0, 0), atol=1e-12)


# Refusals


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (
            {"limiting_magnitude": 8.1},
            "limiting_magnitude 8.1 is outside of 2 to 8: the shipped catalogue ends at V = 8",
        ),
        (
            {"limiting_magnitude": float("nan")},
            "limiting_magnitude nan is outside of 2 to 8: the shipped catalogue ends at V = 8",
        ),
        ({"min_separation_deg": -0.1}, "min_separation_deg -0.1 is outside of 0 to 1"),
        ({"min_separation_deg": 1.5}, "min_separation_deg 1.5 is outside of 0 to 1"),
        ({"epoch": 1899.0}, "epoch 1899 is outside of 1900 to 2100 (Julian years)"),
        ({"epoch": 2451545.0}, "epoch 2.45154e+06 is outside of 1900 to 2100 (Julian years)"),
    ],
)
def test_limits_out_of_range_are_refused(options, text):
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        StarCatalog.hipparcos(**options)


@pytest.mark.parametrize("epoch", [1899.9, 2100.1, float("nan")])
def test_the_papers_catalogue_refuses_the_same_epochs(epoch):
    with pytest.raises(ValueError, match=r"^epoch .* is outside of 1900 to 2100"):
        StarCatalog.paper(epoch=epoch)


def test_an_unknown_catalogue_is_refused():
    text = "catalog 'usno' is unknown: use paper, hipparcos, gaia"
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        StarCatalog.named("usno")


def numbers(n):
    return np.zeros(n, np.int64)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"vectors": np.ones((2, 2))}, "catalogue vectors have shape (2, 2), not (n, 3)"),
        ({"v_mag": np.zeros(3)}, "catalogue v_mag does not have one value for each of 2 stars"),
        (
            {"gaia_source": numbers(3)},
            "catalogue gaia_source does not have one value for each of 2 stars",
        ),
        ({"hip": numbers(1)}, "catalogue hip does not have one value for each of 2 stars"),
        ({"number": numbers(0)}, "catalogue number does not have one value for each of 2 stars"),
        ({"vectors": 1.001 * np.eye(3)[:2]}, "catalogue vectors are not unit vectors"),
        ({"vectors": np.full((2, 3), np.nan)}, "catalogue vectors are not unit vectors"),
    ],
)
def test_a_catalogue_that_does_not_fit_together_is_refused(changes, text):
    columns = {
        "vectors": np.eye(3)[:2], "v_mag": np.zeros(2), "hip": numbers(2), "number": numbers(2),
    }
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        StarCatalog(**(columns | changes))


def refused_by_name(path):
    with pytest.raises(ValueError, match=f"^star catalogue {re.escape(str(path))} ") as refused:
        read_catalog_file(path)
    return str(refused.value)


@pytest.mark.parametrize("length", [0, 5, 60, 200, -1, -1000])
def test_a_truncated_file_is_refused_by_name(tmp_path, length):
    path = tmp_path / "short.npy"
    path.write_bytes(resource_path(CATALOG_FILE).read_bytes()[:length])
    assert "cannot be read: " in refused_by_name(path)


@pytest.mark.parametrize(
    "start",
    [b"", b"\x93NUMPY", b"PK\x03\x04", b"\x80\x04"],
    ids=["no beginning", "npy", "zip", "pickle"],
)
def test_a_damaged_file_is_refused_by_name(tmp_path, start):
    path = tmp_path / "damaged.npy"
    path.write_bytes(start + np.random.default_rng(1).bytes(3000))
    assert "cannot be read: " in refused_by_name(path)


def test_a_missing_file_is_refused_by_name(tmp_path):
    assert "cannot be read: " in refused_by_name(tmp_path / "absent.npy")


class Intruder:
    """What a pickle could do when it is loaded."""

    def __reduce__(self):
        return (pytest.fail, ("the pickle was executed",))


def test_a_pickled_file_is_refused_by_name_and_not_executed(tmp_path):
    path = tmp_path / "pickle.npy"
    path.write_bytes(pickle.dumps(Intruder()))
    assert "cannot be read: " in refused_by_name(path)


def test_an_array_of_pickled_objects_is_refused_by_name_and_not_executed(tmp_path):
    path = tmp_path / "objects.npy"
    np.save(path, np.array([Intruder()], object), allow_pickle=True)
    assert "cannot be read: " in refused_by_name(path)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros(3),
        np.zeros((2, 2), CATALOG_DTYPE),
        np.zeros(3, CATALOG_DTYPE.newbyteorder(">")),
        np.zeros((), CATALOG_DTYPE),
    ],
)
def test_a_file_of_another_format_is_refused_by_name(tmp_path, array):
    path = tmp_path / "other.npy"
    np.save(path, array)
    assert refused_by_name(path) == (
        f"star catalogue {path} has another format: rebuild it (make data)"
    )


def test_an_archive_of_arrays_is_refused_by_name(tmp_path):
    path = tmp_path / "archive.npz"
    np.savez(path, stars=np.zeros(3, CATALOG_DTYPE))
    assert refused_by_name(path) == (
        f"star catalogue {path} has another format: rebuild it (make data)"
    )


@pytest.mark.parametrize(
    "column", ["ra_deg", "dec_deg", "v_mag", "pm_ra_mas_yr", "pm_dec_mas_yr"]
)
def test_a_file_with_a_star_that_is_nowhere_is_refused_by_name(tmp_path, column):
    rows = np.zeros(3, CATALOG_DTYPE)
    rows[column][1] = np.nan
    path = tmp_path / "nan.npy"
    np.save(path, rows)
    assert refused_by_name(path) == f"star catalogue {path} is damaged: rebuild it (make data)"


@pytest.mark.parametrize(("columns", "text"), [
    (([], [], [], []), "the catalogue has no star"),
    (([[1, 0, 0]], [np.nan], [0], [0]), "a magnitude of the catalogue is not a finite number"),
    (([[2, 0, 0]], [1.0], [0], [0]), "catalogue vectors are not unit vectors"),
    (([[1, 0, 0]], [1.0, 2.0], [0], [0]), "catalogue v_mag does not have one value for each of 1"),
])
def test_what_is_no_catalogue_is_refused(columns, text):
    with pytest.raises(ValueError, match=text):
        StarCatalog(*columns)


def test_columns_may_be_lists():
    catalog = StarCatalog([[1, 0, 0], [0, 1, 0]], [3, 4], [0, 0], [0, 0])
    assert (catalog.vectors.dtype, catalog.hip.dtype) == (np.float64, np.int64)
    assert len(catalog) == 2
