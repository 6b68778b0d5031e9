"""A user's own frame: a plain CSV file of centroids."""

import csv
from pathlib import Path

import numpy as np

from star_tracker.geometry.spherical import Floats

#: Names of the columns as they may be written.
_HEADS = {("x", "y"), ("x", "y", "intensity"), ("x_px", "y_px"), ("x_px", "y_px", "intensity")}


def read_frame(path: Path) -> tuple[Floats, Floats | None]:
    """Return the centroids (n, 2), px, and their intensities (n,), or None, of a CSV file.

    Its columns are x, y and, where known, intensity (larger = brighter), under a head that names
    them; lines that begin with # are remarks. Raises ValueError with the file's name and what is
    wrong in it.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise ValueError(f"frame {path} cannot be read: {reason}") from error
    rows = [
        tuple(cell.strip() for cell in row)
        for row in csv.reader(line for line in lines if line.strip() and line[0] != "#")
    ]
    if not rows or rows[0] not in _HEADS:
        raise ValueError(
            f"frame {path}: the first line must name the columns: x,y or x,y,intensity"
        )
    wrong = [row for row in rows if len(row) != len(rows[0])]
    if wrong:
        raise ValueError(
            f"frame {path}: the row {','.join(wrong[0])!r} does not have {len(rows[0])} columns"
        )
    try:
        values = np.array(rows[1:], float).reshape(-1, len(rows[0]))
    except ValueError as error:
        raise ValueError(f"frame {path}: not a table of numbers ({error})") from error
    if not np.all(np.isfinite(values)):
        raise ValueError(f"frame {path}: a value is not a finite number")
    return values[:, :2], values[:, 2] if values.shape[1] > 2 else None
