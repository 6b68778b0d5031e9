"""`star_tracker geometry`: which stars of a star map fix the boresight best (paper, 4.3)."""

import argparse
from collections.abc import Callable

import numpy as np
from rich.table import Table

from star_tracker.attitude.attitude import covariance
from star_tracker.attitude.wahba import wahba
from star_tracker.calibration.error_propagation import (
    CRITERIA,
    Triples,
    cramer_rao_covariance,
    ranking,
    triples,
    wahba_covariance,
)
from star_tracker.calibration.three_star import MAX_ERROR_FACTOR, radii_px
from star_tracker.commands import matched_map
from star_tracker.commands.matched_map import MatchedMap
from star_tracker.commands.options import (
    Record,
    add_map_arguments,
    add_sigma_argument,
    check_positive,
)
from star_tracker.commands.printing import cell, print_result
from star_tracker.geometry.spherical import ARCSEC_PER_RAD, Floats

_ATTITUDES: dict[str, Callable[[Floats, float], Floats]] = {
    "Wahba, exact first order": wahba_covariance,
    "Wahba, as published": covariance,
    "Cramer-Rao bound": cramer_rao_covariance,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_map_arguments(parser)
    parser.add_argument(
        "--top", type=int, default=5, metavar="N", help="how many triples to print (%(default)s)"
    )
    parser.add_argument(
        "--by", choices=CRITERIA, default="error",
        help="order: predicted boresight error, K or tetrahedron volume (%(default)s)",
    )
    add_sigma_argument(parser)


def execute(options: argparse.Namespace) -> None:
    """Rank the triples and print them. Raises ValueError for what cannot be used."""
    check_positive(options, "sigma_px", "top")
    matched = matched_map.load(options.map)
    camera, sigma = matched.camera, options.sigma_px
    every = triples(
        matched.star_vectors, radii_px(camera, matched.xy_px), camera.focal_length_px
    )
    ranked = ranking(every, by=options.by)
    usable = ranked[every.k[ranked] <= MAX_ERROR_FACTOR]
    rows = [_triple(matched, every, row, sigma) for row in usable[: options.top]]
    attitudes = _attitudes(matched, sigma)
    record: Record = {
        "map": matched.name, "source": matched.source, "sigma_px": sigma, "by": options.by,
        "triples": len(every.k), "refused": len(every.k) - len(usable), "best": rows,
        "all_stars": attitudes,
    }
    tables = [_triples_table(record, rows), _attitudes_table(matched, attitudes)]
    print_result(record, tables, options.json)


def _triple(matched: MatchedMap, every: Triples, row: int, sigma_px: float) -> Record:
    error = float(every.boresight_rad_per_px[row]) * sigma_px * ARCSEC_PER_RAD
    return {
        "stars": [matched.labels[i] for i in every.index[row]], "k": float(every.k[row]),
        "volume": float(every.volume[row]), "boresight_error_arcsec": error,
    }


def _attitudes(matched: MatchedMap, sigma_px: float) -> list[Record]:
    """Return the predicted errors of the attitude from all stars."""
    # Where the stars lie, not where noise has put them: the fit's own view of the sky.
    rotation = wahba(matched.camera.vectors(matched.xy_px), matched.star_vectors)
    vectors = matched.star_vectors @ rotation
    result: list[Record] = []
    for name, covariance_of in _ATTITUDES.items():
        p = covariance_of(vectors, sigma_px / matched.camera.focal_length_px)
        result.append({
            "estimate": name,
            "boresight_error_arcsec": float(np.sqrt(p[0, 0] + p[1, 1])) * ARCSEC_PER_RAD,
            "roll_error_arcsec": float(np.sqrt(p[2, 2])) * ARCSEC_PER_RAD,
        })
    return result


def _triples_table(record: Record, rows: list[Record]) -> Table:
    table = Table(
        title=f"{record['map']}: the best of {record['triples']} triples by {record['by']}",
        caption=f"{record['source']}; boresight: root mean square error of the closed form with "
        f"known focal length for {record['sigma_px']:g} px of noise; {record['refused']} triples "
        f"are refused: K > {MAX_ERROR_FACTOR:g}",
    )
    table.add_column("stars")
    for heading in ("K", "volume", "boresight\narcsec"):
        table.add_column(heading, justify="right")
    for row in rows:
        names = row["stars"]
        assert isinstance(names, list)
        table.add_row(
            ", ".join(names), cell(row["k"], ".4g"), cell(row["volume"], ".3g"),
            cell(row["boresight_error_arcsec"], ".2f"),
        )
    return table


def _attitudes_table(matched: MatchedMap, attitudes: list[Record]) -> Table:
    table = Table(title=f"attitude from all {len(matched.labels)} stars, predicted errors")
    table.add_column("estimate")
    for heading in ("boresight\narcsec", "roll\narcsec"):
        table.add_column(heading, justify="right")
    for row in attitudes:
        table.add_row(
            str(row["estimate"]), cell(row["boresight_error_arcsec"], ".2f"),
            cell(row["roll_error_arcsec"], ".1f"),
        )
    return table
