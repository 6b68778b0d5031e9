"""The picture of docs/markers.png: `markers` of a star map as RViz and Foxglove get them.

`python benchmark/markers_figure.py [MAP]` solves a shipped map, makes the MarkerArray with the
node's own adapter and draws what stands in the messages: points, labels and lines with their
colours, seen from the sphere's centre with the boresight in the middle and north up. Only the
labels are moved, each to where it covers nothing. It needs ROS's messages and matplotlib.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.figures.field_labels import annotation, put_labels
from star_tracker.figures.sky_grid import grid_lines
from star_tracker.figures.style import house_style, new_figure, save, text_box
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.markers import markers_from_solution
from star_tracker.optics.camera import Camera
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

BACKGROUND, GRID = "#0a0e1a", "#1d3050"
SIZE_PX, DPI = 910, 130
#: Space between a star and its label, points; half the size of what a label must not cover, px.
GAP_PT, HALF_PX = 7.0, 5.0


def colour(marker: Marker) -> tuple[float, float, float, float]:
    """Return a marker's colour as matplotlib has it."""
    return marker.color.r, marker.color.g, marker.color.b, marker.color.a


def array(points: list) -> np.ndarray:
    """Return points as (n, 3)."""
    return np.array([[point.x, point.y, point.z] for point in points])


def along(line: np.ndarray) -> np.ndarray:
    """Return places (k, 2) close together along the line through corners (n, 2)."""
    share = np.linspace(0, 1, 50)[:, None, None]
    return (line[:-1] + share * np.diff(line, axis=0)).reshape(-1, 2)


def main() -> int:
    """Draw the picture; return 1 if a label has no room in it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("map", type=int, nargs="?", default=7, help="number of the map (7)")
    star_map, = paper_maps((parser.parse_args().map,))
    catalog = StarCatalog.paper()
    tracker = StarTracker(
        FeatureDatabase.build(catalog), star_map.camera, SolveSettings(deadline_ms=60_000.0)
    )
    solution = tracker.solve(star_map.xy_px)
    header = Header(frame_id="icrs")
    markers = markers_from_solution(solution, star_map.camera, catalog, header).markers
    by = {m.ns: [other for other in markers if other.ns == m.ns] for m in markers}
    with house_style():
        n_hidden = draw(solution.attitude, by, f"{star_map.name}: {len(by['labels'])} stars")
    return int(n_hidden > 0)


def draw(attitude, by: dict[str, list[Marker]], title: str) -> int:
    """Write the picture; return how many labels found no room."""
    (stars,), (outline,) = by["stars"], by["field_of_view"]
    # As a camera sees them that points there with north up: east is to the left.
    rotation = rotation_from_boresight(attitude.ra_rad, attitude.dec_rad, 0.0)
    border = array(outline.points) @ rotation
    half = 1.08 * float(np.abs(border[:, :2] / border[:, 2:]).max())
    camera = Camera.from_fov(float(np.degrees(2 * np.arctan(half))), SIZE_PX, SIZE_PX)
    figure = new_figure(SIZE_PX / DPI, SIZE_PX / DPI, DPI)
    figure.patch.set_facecolor(BACKGROUND)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, SIZE_PX), ylim=(SIZE_PX, 0))
    axes.axis("off")
    for line in grid_lines(camera, rotation):
        for path in line.paths:
            axes.plot(*path.T, color=GRID, linewidth=0.7, zorder=0)
    border_px, star_px = camera.pixels(border), camera.pixels(array(stars.points) @ rotation)
    axes.plot(*border_px.T, color=colour(outline), linewidth=1.5)
    axes.scatter(*star_px.T, s=14, color=[colour(stars)], edgecolor="none", zorder=3)
    names = camera.pixels(array([label.pose.position for label in by["labels"]]) @ rotation)
    labels = [
        annotation(axes, place, label.text, {"color": colour(label), "fontsize": 8.0})
        for place, label in zip(names, by["labels"], strict=True)
    ]
    display = axes.transData.transform
    taken = display(np.vstack([star_px, along(border_px)]))
    obstacles = np.hstack([taken - HALF_PX, taken + HALF_PX])
    placed = put_labels(axes, labels, np.full(len(labels), GAP_PT), obstacles)
    for label, star in zip(labels, display(names), strict=True):
        box = text_box(label)
        ends = axes.transData.inverted().transform([star, np.clip(star, box[:2], box[2:])])
        axes.plot(*ends.T, color=label.get_color(), linewidth=0.5, alpha=0.6, zorder=1)
    axes.text(
        0.5, 0.012, f"{title} identified; RA {np.degrees(attitude.ra_rad):.2f}, "
        f"Dec {np.degrees(attitude.dec_rad):+.2f}, roll {np.degrees(attitude.roll_rad):.2f} deg; "
        "north up, east left",
        transform=axes.transAxes, color="0.75", fontsize=7.5, ha="center",
    )
    path, n_hidden = ROOT / "docs" / "markers.png", int(np.sum(~placed.shown))
    save(figure, path, DPI)
    print(f"{path.relative_to(ROOT)}: {len(labels)} labels, {n_hidden} without room")
    return n_hidden


if __name__ == "__main__":
    sys.exit(main())
