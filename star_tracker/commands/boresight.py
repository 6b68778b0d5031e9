"""`star_tracker boresight`: the boresight of a star map from three stars (paper, 4.1 and 4.2)."""

import argparse

import numpy as np
from rich.table import Table

from star_tracker.calibration.error_propagation import (
    best_triple,
    three_star_covariance,
    triples,
    unknown_focal_length_covariance,
)
from star_tracker.calibration.three_star import (
    Boresight,
    boresight_linear,
    boresight_spherical,
    boresight_unknown_focal_length,
    error_factor,
    radii_px,
    tetrahedron_volume,
)
from star_tracker.commands import matched_map
from star_tracker.commands.matched_map import MatchedMap
from star_tracker.commands.options import (
    Record,
    add_focal_length_argument,
    add_map_arguments,
    add_sigma_argument,
    check_positive,
)
from star_tracker.commands.printing import cell, print_result
from star_tracker.geometry.spherical import ARCSEC_PER_RAD, Floats, separation

#: The rows of the table: key of the record, heading, unit, format.
_ROWS = (
    ("ra_deg", "right ascension", "deg", ".6f"), ("dec_deg", "declination", "deg", ".6f"),
    ("standard_error_east_arcsec", "  +/- east", "arcsec", ".2f"),
    ("standard_error_north_arcsec", "  +/- north", "arcsec", ".2f"),
    ("focal_length_px", "focal length", "px", ".3f"),
    ("standard_error_focal_length_px", "  +/-", "px", ".3f"), ("norm_of_m", "|m|", "", ".8f"),
    ("error_arcsec", "off the map's pose", "arcsec", ".2f"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_map_arguments(parser)
    parser.add_argument(
        "--stars", metavar="A,B,C", help="labels of three stars (those of least predicted error)"
    )
    add_focal_length_argument(parser, "the known focal length, and where the search for it starts")
    add_sigma_argument(parser)


def execute(options: argparse.Namespace) -> None:
    """Print the boresight by all three ways. Raises ValueError for what cannot be used.

    A focal length that cannot be found is reported as refused, with the reason.
    """
    check_positive(options, "focal_length_px", "sigma_px")
    matched = matched_map.load(options.map)
    f = options.focal_length_px or matched.camera.focal_length_px
    every = radii_px(matched.camera, matched.xy_px)
    index = _chosen(matched, options.stars, every, f)
    stars, a = matched.star_vectors[index], every[index]
    methods = {"linear system": boresight_linear, "spherical triangles": boresight_spherical}
    found = [(method, solve(stars, a, f)) for method, solve in methods.items()]
    known = three_star_covariance(stars, a, f, options.sigma_px)
    answers = [_answer(method, boresight, known, matched) for method, boresight in found]
    answers.append(_unknown_focal_length(stars, a, f, options.sigma_px, matched))
    record: Record = {
        "map": matched.name, "source": matched.source,
        "stars": [matched.labels[i] for i in index], "radii_px": a.tolist(),
        "sigma_px": options.sigma_px, "k": float(error_factor(stars)),
        "volume": float(tetrahedron_volume(stars)), "boresight": answers,
    }
    print_result(record, [_table(record, answers)], options.json)


def _chosen(matched: MatchedMap, labels: str | None, a_px: Floats, f_px: float) -> list[int]:
    """Return the indices of the three stars that were asked for, or of the best three."""
    if labels is None:
        return list(best_triple(triples(matched.star_vectors, a_px, f_px)))
    names = [name.strip() for name in labels.split(",")]
    if len(names) != 3:
        raise ValueError("--stars takes three labels, for instance A01,A02,A03")
    unknown = [name for name in names if name not in matched.labels]
    if unknown:
        raise ValueError(f"{matched.name} has no matched star {unknown[0]!r}")
    return [matched.labels.index(name) for name in names]


def _unknown_focal_length(
    stars: Floats, a_px: Floats, f0_px: float, sigma_px: float, matched: MatchedMap
) -> Record:
    method = "unknown focal length"
    try:
        found = boresight_unknown_focal_length(stars, a_px, f0_px)
    except ValueError as error:
        return {"method": method, "refused": str(error)}
    covariance = unknown_focal_length_covariance(
        stars, found.direction, a_px, found.focal_length_px, sigma_px
    )
    return _answer(method, found, covariance, matched)


def _answer(method: str, boresight: Boresight, covariance: Floats, matched: MatchedMap) -> Record:
    errors = np.sqrt(np.diag(covariance))
    off = None
    if matched.pose is not None:
        off = float(separation(boresight.direction, matched.pose.rotation[:, 2])) * ARCSEC_PER_RAD
    return {
        "method": method,
        "ra_deg": float(np.degrees(boresight.ra_rad)),
        "dec_deg": float(np.degrees(boresight.dec_rad)),
        "standard_error_east_arcsec": float(errors[0]) * ARCSEC_PER_RAD,
        "standard_error_north_arcsec": float(errors[1]) * ARCSEC_PER_RAD,
        "focal_length_px": boresight.focal_length_px,
        "standard_error_focal_length_px": float(errors[2]) if len(errors) > 2 else None,
        "norm_of_m": boresight.norm,
        "error_arcsec": off,
    }


def _table(record: Record, answers: list[Record]) -> Table:
    names = record["stars"]
    assert isinstance(names, list)
    caption = (
        f"{record['source']}; +/-: standard error for {record['sigma_px']:g} px of noise; "
        f"K = {record['k']:.4g}, volume {record['volume']:.3g}"
    )
    refused = [f"refused: {answer['refused']}" for answer in answers if "refused" in answer]
    table = Table(
        title=f"{record['map']}: boresight from {', '.join(names)}",
        caption="\n".join([caption, *refused]),
    )
    table.add_column("")
    for answer in answers:
        table.add_column(str(answer["method"]).replace(" ", "\n", 1), justify="right")
    table.add_column("unit")
    for key, heading, unit, spec in _ROWS:
        cells = [
            "refused" if "refused" in answer else cell(answer[key], spec) for answer in answers
        ]
        table.add_row(heading, *cells, unit)
    return table
