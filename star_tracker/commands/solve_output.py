"""What `star_tracker solve` prints and writes of each result."""

import argparse
import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from star_tracker.commands.options import Record, check_writable, json_text
from star_tracker.geometry.spherical import ra_dec
from star_tracker.offline.image_file import read_image
from star_tracker.offline.solving import Result
from star_tracker.offline.wcs import header_text
from star_tracker.resources import write_whole

_COLUMNS = (
    "file", "topic", "frame", "stamp_ns", "status", "ra_deg", "dec_deg", "roll_deg", "fov_deg",
    "parity", "n_detected", "n_ignored", "n_surplus", "n_identified", "wrong_probability",
    "rms_px", "detect_ms", "solve_ms", "reason",
)
_STAR_COLUMNS = (
    "x_px", "y_px", "hip", "v_mag", "ra_deg", "dec_deg", "residual_px", "state",
)
_DPI = 130.0


class Output:
    """Takes results one after the other; the table of all is written at the end.

    Args:
        options: of the command: `json`, `csv`, `stars`, `wcs`, `annotate`.

    Attributes:
        failed: whether a file or a frame could not be used at all.

    Raises ValueError for a folder that cannot be made, and a file that cannot be written.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options
        self._rows: list[Record] = []
        self.failed = False
        check_writable(options.csv)
        for folder in (options.stars, options.wcs, options.annotate):
            if folder is not None:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except OSError as error:
                    raise ValueError(f"{folder} cannot be made: {error.strerror}") from error

    def take(self, result: Result) -> None:
        """Print a result and write the files about it."""
        self.failed |= bool(result.error)
        record = record_of(result)
        print(json_text(record) if self._options.json else line_of(record))
        if self._options.csv is not None:
            self._rows.append(record)
        if not result.is_solved or result.solution is None:
            return
        if self._options.stars is not None:
            _write_table(
                self._options.stars / f"{result.name}.stars.csv", _STAR_COLUMNS, _stars(result)
            )
        if self._options.wcs is not None:
            write_whole(self._options.wcs / f"{result.name}.wcs", header_text(result.solution))
        if self._options.annotate is not None:
            _draw(result, self._options.annotate / f"{result.name}.png")

    def finish(self) -> None:
        """Write the table of all results. Raises ValueError where the place does not take it."""
        if self._options.csv is not None:
            _write_table(self._options.csv, _COLUMNS, self._rows)


def record_of(result: Result) -> Record:
    """Return a result as plain values."""
    solution, frame, place = result.solution, result.frame, result.place
    record: Record = {"file": str(result.path)}
    if place is not None:
        record |= {"topic": place.topic, "frame": place.number, "stamp_ns": place.stamp_ns}
    if solution is None or frame is None:
        return record | {"status": "UNUSABLE", "reason": result.error}
    attitude, camera = solution.attitude, solution.camera
    record |= {
        "status": solution.status.value, "ra_deg": None,
        "dec_deg": None, "roll_deg": None, "fov_deg": None, "parity": solution.parity,
        "n_detected": len(frame.xy_px), "n_ignored": solution.n_ignored,
        "n_surplus": solution.n_surplus,
        "n_identified": len(solution.identification.identified),
        "wrong_probability": solution.wrong_probability, "rms_px": solution.rms_px,
        "detect_ms": frame.detect_ms, "solve_ms": solution.solve_ms, "reason": solution.reason,
    }
    if attitude is not None and camera is not None:
        record |= {
            "ra_deg": float(np.degrees(attitude.ra_rad)),
            "dec_deg": float(np.degrees(attitude.dec_rad)),
            "roll_deg": float(np.degrees(attitude.roll_rad)), "fov_deg": camera.fov_deg,
        }
    return record


def line_of(record: Record) -> str:
    """Return a result as a line for people."""
    if record["status"] == "UNUSABLE":
        return f"UNUSABLE  {record['reason']}"
    values: dict[str, Any] = {**record, "at": record["file"]}
    if "topic" in record:
        values["at"] = "{file} {topic} {frame} {stamp_ns}".format(**record)
    values["left_out"] = ", {n_ignored} outside".format(**record) if record["n_ignored"] else ""
    if record["ra_deg"] is None:
        return "{status:9} {at}  {n_detected} stars{left_out}: {reason}".format(**values)
    # What is rounded to a full turn is none.
    values["ra_deg"] = round(values["ra_deg"], 4) % 360
    values["roll_deg"] = round(values["roll_deg"], 2) % 360
    return (
        "SOLVED    {at}  RA {ra_deg:.4f} Dec {dec_deg:+.4f} roll {roll_deg:.2f} deg  "
        "field {fov_deg:.4g} deg {parity}  {n_identified} of {n_detected} stars{left_out}  "
        "p(wrong) {wrong_probability:.0e}  rms {rms_px:.2f} px"
    ).format(**values)


def _stars(result: Result) -> list[Record]:
    """Return a row for each centroid of a solved file."""
    solution, frame = result.solution, result.frame
    if solution is None or frame is None or solution.catalog is None:
        return []
    found, catalog = solution.identification, solution.catalog
    rows: list[Record] = []
    for i, (x, y) in enumerate(frame.told_px.tolist()):
        row: Record = {"x_px": x, "y_px": y, "state": int(found.state[i])}
        star = int(found.catalog_index[i])
        if star >= 0:
            ra, dec = np.degrees(ra_dec(catalog.vectors[star]))
            row |= {
                "hip": int(catalog.hip[star]), "v_mag": float(catalog.v_mag[star]),
                "ra_deg": float(ra), "dec_deg": float(dec),
                "residual_px": float(found.residual_px[i]),
            }
        rows.append(row)
    return rows


def _draw(result: Result, path: Path) -> None:
    """Draw a solved frame over its image, where it has one."""
    from star_tracker.figures import style
    from star_tracker.figures.field_plot import draw_field
    from star_tracker.figures.field_view import FieldView

    solution, frame = result.solution, result.frame
    if solution is None or frame is None or solution.catalog is None or solution.camera is None:
        return
    labels = tuple(str(i + 1) for i in range(len(frame.xy_px)))
    view = FieldView(
        result.name, solution.camera, labels, frame.xy_px, solution, solution.catalog
    )
    image = read_image(result.path) if frame.is_image else None
    with style.house_style():
        style.save(draw_field(view, image), path, _DPI)


def _write_table(path: Path, columns: Sequence[str], rows: Iterable[Record]) -> None:
    """Write rows as CSV; raises ValueError where the place does not take it."""
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, restval="")
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror}") from error
