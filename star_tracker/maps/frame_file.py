"""A user's own frame: a plain CSV file of centroids."""

import csv
from pathlib import Path

import numpy as np

from star_tracker.geometry.spherical import Floats

#: Names of the columns, each as it may be written, in any order and among others.
_X, _Y, _INTENSITY = ("x", "x_px"), ("y", "y_px"), ("intensity",)


def read_frame(path: Path) -> tuple[Floats, Floats | None]:
    """Return the centroids (n, 2), px, and their intensities (n,), or None, of a CSV file.

    Its columns are x (to the right), y and, where known, intensity (larger = brighter), in any
    order under a head that names them; others are left aside, and lines that begin with # are
    remarks. Raises ValueError with the file's name and what is
    wrong in it.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise ValueError(f"frame {path} cannot be read: {reason}") from error
    try:
        rows = [
            tuple(cell.strip() for cell in row)
            for row in csv.reader(line for line in lines if line.strip() and line[0] != "#")
        ]
    except csv.Error as error:
        raise ValueError(f"frame {path}: not a table of numbers ({error})") from error
    head = rows[0] if rows else ()
    columns = [
        [at for at, name in enumerate(head) if name in names] for names in (_X, _Y, _INTENSITY)
    ]
    if [len(found) for found in columns] not in ([1, 1, 0], [1, 1, 1]):
        raise ValueError(
            f"frame {path}: the first line must name the columns: x, y and, where it is known, "
            "intensity"
        )
    wrong = [row for row in rows if len(row) != len(rows[0])]
    if wrong:
        raise ValueError(
            f"frame {path}: the row {','.join(wrong[0])!r} does not have {len(rows[0])} columns"
        )
    places = [at for found in columns for at in found]
    try:
        values = np.array(
            [[row[at] for at in places] for row in rows[1:]], float
        ).reshape(-1, len(places))
    except ValueError as error:
        raise ValueError(f"frame {path}: not a table of numbers ({error})") from error
    if not np.all(np.isfinite(values)):
        raise ValueError(f"frame {path}: a value is not a finite number")
    return values[:, :2], values[:, 2] if values.shape[1] > 2 else None
