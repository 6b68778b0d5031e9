"""The star catalogue: read, validate, narrow to what a sensor sees.

The shipped catalogue holds the Hipparcos stars to V = 8 and three Tycho-2 stars, at epoch J2000.0
(`data/README.md`). `StarCatalog.paper` is the 4908 numbered stars of the paper;
`StarCatalog.hipparcos` is for real skies.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from star_tracker.geometry.spherical import Floats, chord, ra_dec, tangent_basis, unit_vectors
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
_BLENDED = {"merge": "merged", "drop": "dropped"}
#: How `StarCatalog.named` builds each catalogue.
CATALOGS = ("paper", "hipparcos")
_MAS_TO_RAD = np.pi / 180 / 3600e3


@dataclass(frozen=True)
class StarCatalog:
    """Guide stars in a fixed order; a star's index in these arrays is its catalogue index.

    Attributes:
        vectors: (n, 3) unit vectors, ICRS axes, at `epoch`.
        v_mag: (n,) V magnitude.
        hip: (n,) Hipparcos number, 0 = none.
        number: (n,) star number of the paper, 0 = none. For reports only, never an index.
        epoch: Julian year of the positions.
        description: what was selected, in words, for reports.
    """

    vectors: Floats
    v_mag: Floats
    hip: NDArray[np.int64]
    number: NDArray[np.int64]
    epoch: float = REFERENCE_EPOCH
    description: str = "custom"

    def __post_init__(self) -> None:
        n = len(self.vectors)
        if self.vectors.shape != (n, 3):
            raise ValueError(f"catalogue vectors have shape {self.vectors.shape}, not (n, 3)")
        for name in ("v_mag", "hip", "number"):
            if getattr(self, name).shape != (n,):
                raise ValueError(f"catalogue {name} does not have one value for each of {n} stars")
        lengths = np.linalg.norm(self.vectors, axis=1)
        if not np.allclose(lengths, 1.0, rtol=0, atol=1e-9):
            raise ValueError("catalogue vectors are not unit vectors")

    def __len__(self) -> int:
        return len(self.vectors)

    @property
    def ra_dec_rad(self) -> tuple[Floats, Floats]:
        """Right ascension and declination of all stars, each (n,), radians, ICRS at `epoch`."""
        return ra_dec(self.vectors)

    @classmethod
    def paper(cls, *, epoch: float = REFERENCE_EPOCH) -> "StarCatalog":
        """Return the paper's 4908 stars, ordered by star number."""
        rows = read_catalog_file(resource_path(CATALOG_FILE))
        rows = rows[rows["number"] > 0]
        rows = rows[np.argsort(rows["number"])]
        return _from_rows(rows, epoch, f"paper, {len(rows)} stars, epoch {epoch:.1f}")

    @classmethod
    def hipparcos(
        cls,
        *,
        limiting_magnitude: float = 6.0,
        min_separation_deg: float = 0.05,
        blends: str = "merge",
        epoch: float = REFERENCE_EPOCH,
    ) -> "StarCatalog":
        """Return the Hipparcos stars to a limiting magnitude, for a real sky.

        Stars that lie closer than `min_separation_deg` reach the detector as one centroid. With
        `blends="merge"` such a group becomes one star at its centre of light, with its joint
        magnitude and the brightest member's names; with `"drop"` the whole group is left out, as
        the paper does. Raises ValueError for a value out of range.
        """
        low, high = LIMITING_MAGNITUDE_RANGE
        if not low <= limiting_magnitude <= high:
            raise ValueError(
                f"limiting_magnitude {limiting_magnitude:g} is outside of {low:g} to {high:g}: "
                "the shipped catalogue ends at V = 8"
            )
        if blends not in _BLENDED:
            raise ValueError(f"blends {blends!r} is unknown: use {' or '.join(_BLENDED)}")
        if not 0 <= min_separation_deg <= 1:
            raise ValueError(f"min_separation_deg {min_separation_deg:g} is outside of 0 to 1")
        rows = read_catalog_file(resource_path(CATALOG_FILE))
        text = (
            f"hipparcos, V <= {limiting_magnitude:g}, blends closer than "
            f"{min_separation_deg:g} deg {_BLENDED[blends]}, epoch {epoch:.1f}"
        )
        limit_rad = float(np.radians(min_separation_deg))
        every = _from_rows(rows, epoch, text)
        if blends == "merge":
            # Two stars too faint to be seen may be seen together: the limit comes after merging.
            merged = _resolve_blends(every, limit_rad, blends)
            return _subset(merged, np.flatnonzero(merged.v_mag <= limiting_magnitude))
        seen = _subset(every, np.flatnonzero(every.v_mag <= limiting_magnitude))
        return _resolve_blends(seen, limit_rad, blends)

    @classmethod
    def named(
        cls,
        catalog: str,
        *,
        limiting_magnitude: float = 6.0,
        min_separation_deg: float = 0.05,
        epoch: float = REFERENCE_EPOCH,
    ) -> "StarCatalog":
        """Return the catalogue that a parameter names: `paper` or `hipparcos`."""
        if catalog == "paper":
            return cls.paper(epoch=epoch)
        if catalog == "hipparcos":
            return cls.hipparcos(
                limiting_magnitude=limiting_magnitude,
                min_separation_deg=min_separation_deg,
                epoch=epoch,
            )
        raise ValueError(f"catalog {catalog!r} is unknown: use {' or '.join(CATALOGS)}")


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


def _resolve_blends(catalog: StarCatalog, limit_rad: float, blends: str) -> StarCatalog:
    """Merge or drop the groups of stars that chain together with steps below `limit_rad`."""
    n = len(catalog)
    close = cKDTree(catalog.vectors).query_pairs(float(chord(limit_rad)), output_type="ndarray")
    graph = coo_array((np.ones(len(close)), (close[:, 0], close[:, 1])), shape=(n, n))
    n_groups, group = connected_components(graph, directed=False)
    size = np.bincount(group, minlength=n_groups)
    if blends == "drop":
        return _subset(catalog, np.flatnonzero(size[group] == 1))
    flux = 10 ** (-0.4 * catalog.v_mag)
    total = np.bincount(group, flux, n_groups)
    light = np.column_stack([
        np.bincount(group, flux * catalog.vectors[:, axis], n_groups) for axis in range(3)
    ])
    centre = light / np.linalg.norm(light, axis=1, keepdims=True)
    # Faintest first, so that the brightest member is the last to claim its group's slot.
    brightest = np.empty(n_groups, np.intp)
    faint_first = np.argsort(-catalog.v_mag, kind="stable")
    brightest[group[faint_first]] = faint_first
    keep = np.sort(brightest)
    merged = size[group[keep]] > 1
    vectors = np.where(merged[:, None], centre[group[keep]], catalog.vectors[keep])
    v_mag = np.where(merged, -2.5 * np.log10(total[group[keep]]), catalog.v_mag[keep])
    return replace(_subset(catalog, keep), vectors=vectors, v_mag=v_mag)


def _subset(catalog: StarCatalog, index: NDArray[np.intp]) -> StarCatalog:
    return replace(
        catalog, vectors=catalog.vectors[index], v_mag=catalog.v_mag[index],
        hip=catalog.hip[index], number=catalog.number[index],
    )
