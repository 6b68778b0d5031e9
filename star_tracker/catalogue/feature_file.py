"""A catalogue's features in a file of the cache: pairs and patterns, with what they belong to.

The file is numpy's archive of arrays, read without pickle: loading it never runs what it holds,
and the archive's own check sums tell damage. It is written beside its place and then moved there,
so that nodes that share a folder meet either no file or a whole one.
"""

import os
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import IO, NamedTuple
from zipfile import ZipFile

import numpy as np
from numpy.typing import ArrayLike

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.pairs import PairTable
from star_tracker.catalogue.patterns import PatternSettings, PatternTable

_FORMAT = "star_tracker features, format 2"


class Features(NamedTuple):
    """What a file holds; `patterns` is None for a catalogue that has too many stars for them."""

    pairs: PairTable
    patterns: PatternTable | None


def identity(catalog: StarCatalog, settings: str, built_by: str) -> str:
    """Name the stars, their order and places, the settings and the sources that built features."""
    digest = sha256(f"{_FORMAT} {built_by} {settings}".encode())
    for array in (catalog.hip, catalog.number, catalog.vectors):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def save_features(path: Path, belongs_to: str, features: Features) -> None:
    """Write a file in one step. Raises OSError where the folder or the disk does not take it."""
    patterns = features.patterns
    packed = np.empty((0, 0), np.uint8) if patterns is None else patterns.packed
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            _write_arrays(file, identity=np.array(belongs_to), packed=packed,
                          **features.pairs._asdict())
        Path(temporary).replace(path)
    except BaseException:  # whatever ends the writing, no half file stays
        Path(temporary).unlink(missing_ok=True)
        raise


def _write_arrays(file: IO[bytes], **arrays: ArrayLike) -> None:
    """Write arrays as `numpy.savez` does, which leaves its archive open on a disk that is full."""
    with ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def load_features(path: Path, belongs_to: str, settings: PatternSettings) -> Features:
    """Read a file. Raises FileNotFoundError where there is none, ValueError with what is wrong."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            owner = str(content["identity"])
            entries = {name: content[name] for name in PairTable._fields}
            packed = content["packed"]
    except (FileNotFoundError, NotADirectoryError) as error:
        raise FileNotFoundError from error
    except Exception as error:  # the reader raises errors of many kinds for damaged files
        raise ValueError(f"cannot be read: {' '.join(str(error).split())}") from error
    if owner != belongs_to:
        raise ValueError("is of another catalogue or of other settings")
    pairs = PairTable(**{**entries, "max_separation_rad": float(entries["max_separation_rad"])})
    return Features(pairs, PatternTable(settings, packed) if packed.size else None)
