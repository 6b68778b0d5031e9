"""A catalogue's features in a file of the cache: pairs and patterns, with what they belong to.

The file is numpy's archive of arrays, read without pickle: loading it never runs what it holds. A
checksum over all entries is one of them, and every index is held against its bounds, as compiled
code looks none up twice. It is written beside its place and then moved there, so that nodes that
share a folder meet either no file or a whole one.
"""

import io
import os
import tempfile
import warnings
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.pairs import AZIMUTH_BITS, PairTable
from star_tracker.catalogue.patterns import PatternSettings, PatternTable

_FORMAT = "star_tracker features, format 1"
_CHECKSUM = "checksum"
_PAIR_DTYPES = {
    "separation_rad": np.float32, "main_azimuth": np.int32, "bin_start": np.int64,
    "near_start": np.int64, "near_separation_rad": np.float32, "near_azimuth": np.uint8,
    "near_companion": np.int32,
}
Arrays = dict[str, NDArray[Any]]


class Features(NamedTuple):
    """What a file holds; `patterns` is None for a catalogue too dense for them."""

    pairs: PairTable
    patterns: PatternTable | None


def identity(
    catalog: StarCatalog, max_separation_rad: float, settings: PatternSettings, built_by: str
) -> str:
    """Name the stars, their order and places, the settings and the sources that built features."""
    digest = sha256(f"{_FORMAT} {built_by} {max_separation_rad!r} {settings!r}".encode())
    for array in (catalog.hip, catalog.number, catalog.vectors):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def save_features(path: Path, belongs_to: str, features: Features) -> None:
    """Write a file in one step. Raises OSError where the folder or the disk does not take it."""
    entries: Arrays = {
        "format": np.array(_FORMAT), "identity": np.array(belongs_to),
        "packed": np.empty((0, 0), np.uint8),
        **{name: np.asarray(value) for name, value in features.pairs._asdict().items()},
    }
    if features.patterns is not None:
        entries["packed"] = features.patterns.packed
    entries[_CHECKSUM] = np.array(_checksum(entries))
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **entries)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.getbuffer())
        Path(temporary).replace(path)
    except BaseException:  # whatever ends the writing, no half file stays
        Path(temporary).unlink(missing_ok=True)
        raise


def load_features(
    path: Path, belongs_to: str, n_stars: int, settings: PatternSettings
) -> Features:
    """Read a file. Raises FileNotFoundError where there is none, ValueError with what is wrong."""
    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("error")  # numpy's doubts about a header are damage here
            with np.load(file, allow_pickle=False) as content:
                entries = {name: content[name] for name in content.files}
    except (FileNotFoundError, NotADirectoryError) as error:
        raise FileNotFoundError from error
    except Exception as error:  # the reader raises errors of many kinds for damaged files
        raise ValueError(f"cannot be read: {' '.join(str(error).split())}") from error
    expected = entries.pop(_CHECKSUM, np.array(""))
    if str(entries.get("format")) != _FORMAT:
        raise ValueError("is of another format")
    if str(expected) != _checksum(entries):
        raise ValueError("is damaged: its checksum is wrong")
    if str(entries.get("identity")) != belongs_to:
        raise ValueError("is of another catalogue or of other settings")
    if not _fits(entries, n_stars, settings):
        raise ValueError("is damaged: its tables do not fit together")
    pairs = PairTable(
        **{name: entries[name] for name in _PAIR_DTYPES},
        max_separation_rad=float(entries["max_separation_rad"]),
    )
    packed = entries["packed"]
    return Features(pairs, PatternTable(settings, packed) if packed.size else None)


def _checksum(entries: Arrays) -> str:
    digest = sha256()
    for name in sorted(entries):
        array = np.ascontiguousarray(entries[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.tobytes() if array.dtype.kind == "U" else array.data)
    return digest.hexdigest()


def _fits(entries: Arrays, n_stars: int, settings: PatternSettings) -> bool:
    """Tell whether types, lengths and indices are those of features of so many stars."""
    wanted = {*_PAIR_DTYPES, "format", "identity", "max_separation_rad", "packed"}
    if set(entries) != wanted or any(
        entries[name].dtype != dtype or entries[name].ndim != 1
        for name, dtype in _PAIR_DTYPES.items()
    ):
        return False
    n_rows = len(entries["separation_rad"])
    rows = ("main_azimuth", "near_separation_rad", "near_azimuth", "near_companion")
    if any(len(entries[name]) != n_rows for name in rows):
        return False
    packed, separation = entries["packed"], entries["max_separation_rad"]
    return (
        packed.dtype == np.uint8
        and packed.shape in {(0, 0), (n_stars, settings.n_bytes)}
        and separation.shape == ()
        and separation.dtype == np.float64
        and len(entries["near_start"]) == n_stars + 1
        and all(_ascends(entries[name], n_rows) for name in ("bin_start", "near_start"))
        and _within(entries["near_companion"], n_stars)
        and _within(entries["main_azimuth"], n_stars << AZIMUTH_BITS)
    )


def _within(index: NDArray[Any], end: int) -> bool:
    return bool(index.size == 0 or (index.min() >= 0 and index.max() < end))


def _ascends(start: NDArray[Any], end: int) -> bool:
    """Tell whether rows that begin in order stay in [0, end]."""
    return bool(len(start) > 0 and np.all(np.diff(start, prepend=0, append=end) >= 0))
