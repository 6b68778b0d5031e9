"""Import the contest's own files, for users who have them: `pip install .[attachments]`.

`star_catalogue.mat` holds the variable `star_data` (star number, RA deg, Dec deg, magnitude);
`xingtu01.xls` to `xingtu08.xls` hold rows of label, X, Y. Neither is part of this package.
"""

from io import StringIO
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import unit_vectors
from star_tracker.maps.star_map import StarMap
from star_tracker.optics.camera import Camera

_CATALOG_COLUMNS = 4


def read_contest_catalog(path: Path) -> StarCatalog:
    """Read `star_catalogue.mat`. Raises ValueError naming the file where it is another."""
    try:
        table = loadmat(str(path))["star_data"]
        finite = bool(np.all(np.isfinite(table)))
    except Exception as error:  # the reader raises errors of many kinds for damaged files
        raise ValueError(f"{path} is not the contest's star catalogue: {error}") from error
    if table.ndim != 2 or table.shape[1] != _CATALOG_COLUMNS or not finite:
        raise ValueError(f"{path}: star_data is not a table of number, RA, Dec, magnitude")
    number = table[:, 0].astype(np.int64)
    vectors = unit_vectors(np.radians(table[:, 1]), np.radians(table[:, 2]))
    return StarCatalog(
        vectors, table[:, 3].astype(float), np.zeros_like(number), number,
        description=f"contest, {len(number)} stars",
    )


def read_contest_map(path: Path, camera: Camera) -> StarMap:
    """Read a `xingtu0N.xls`, whose Y axis points up: `camera` should be `mirrored` or `auto`.

    Raises ValueError naming the file where it is another, ImportError where xlrd is missing.
    """
    try:
        import xlrd
    except ImportError as error:
        raise ImportError(
            "reading .xls files needs xlrd: pip install 'star_tracker[attachments]'"
        ) from error
    try:
        sheet = xlrd.open_workbook(str(path), logfile=StringIO()).sheet_by_index(0)
        rows = [sheet.row_values(i) for i in range(sheet.nrows)]
        labels = tuple(str(row[0]) for row in rows)
        xy = np.array([[float(row[1]), float(row[2])] for row in rows])
    except Exception as error:  # the reader raises errors of many kinds for damaged files
        raise ValueError(f"{path} is not a star map of the contest: {error}") from error
    n = len(labels)
    return StarMap(path.stem, camera, labels, xy, np.zeros(n, np.int64), np.zeros(n))
