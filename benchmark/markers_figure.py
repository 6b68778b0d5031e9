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

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from msg_adapters.markers import markers_from_solution
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.solution import SolveSettings
from star_tracker.geometry.spherical import tangent_basis
from star_tracker.maps.star_map import paper_maps
from star_tracker.tracker import StarTracker

BACKGROUND, GRID = "#0a0e1a", "#1d3050"
SIZE_IN, DPI = 7.0, 130
#: Where a label may stand beside its star, in the order of preference: distance, pt, and angle.
DISTANCES_PT = (7, 12, 18, 26)
ANGLES = np.radians([0, 180, 90, 270, 45, 135, 225, 315, 22, 158, 202, 338, 67, 113, 247, 293])
GRID_STEP_DEG = 5.0
SEED, ORDERS = 7, 40


class Sky:
    """Projects the sphere onto the plane that touches it at the boresight, degrees, east left."""

    def __init__(self, boresight: np.ndarray) -> None:
        self._east, self._north = tangent_basis(boresight)
        self._boresight = boresight

    def flat(self, vectors: np.ndarray) -> np.ndarray:
        """Return (n, 2) degrees of directions (n, 3)."""
        along = vectors @ self._boresight
        xy = np.column_stack([-(vectors @ self._east), vectors @ self._north])
        return np.degrees(xy / along[:, None])


def colour(marker: Marker) -> tuple[float, float, float, float]:
    """Return a marker's colour as matplotlib has it."""
    return marker.color.r, marker.color.g, marker.color.b, marker.color.a


def array(points: list) -> np.ndarray:
    """Return points as (n, 3)."""
    return np.array([[point.x, point.y, point.z] for point in points])


def overlap(box: np.ndarray, others: list[np.ndarray]) -> float:
    """Return the area that a box (x0, y0, x1, y1) shares with others."""
    if not others:
        return 0.0
    all_ = np.array(others)
    width = np.minimum(box[2], all_[:, 2]) - np.maximum(box[0], all_[:, 0])
    height = np.minimum(box[3], all_[:, 3]) - np.maximum(box[1], all_[:, 1])
    return float((np.maximum(width, 0) * np.maximum(height, 0)).sum())


def places(star: np.ndarray, size: tuple[float, float]) -> list[np.ndarray]:
    """Return boxes, px, that a label of a size can take beside a star, the nearest first."""
    boxes = []
    for distance in np.array(DISTANCES_PT) * DPI / 72:
        for angle in ANGLES:
            direction = np.array([np.cos(angle), np.sin(angle)])
            middle = star + direction * (distance + np.abs(direction) @ np.array(size) / 2)
            half = np.array(size) / 2
            boxes.append(np.concatenate([middle - half, middle + half]))
    return boxes


def outside(box: np.ndarray, frame: np.ndarray) -> float:
    """Return the area of a box that lies outside of a frame, both (x0, y0, x1, y1)."""
    return float(np.prod(box[2:] - box[:2])) - overlap(box, [frame])


def leader(star: np.ndarray, box: np.ndarray) -> list[np.ndarray]:
    """Return small boxes, px, along the line from a star to its label."""
    nearest = np.clip(star, box[:2], box[2:])
    points = star + np.linspace(0.4, 0.95, 6)[:, None] * (nearest - star)
    return [np.concatenate([point - 1, point + 1]) for point in points]


def arranged(
    order: np.ndarray, stars: np.ndarray, sizes: np.ndarray, frame: np.ndarray
) -> tuple[float, float, dict[int, np.ndarray]]:
    """Place labels one after the other, each where it covers least.

    Returns the area that still overlaps or lies outside, px^2, the distances of all labels from
    their stars, px, and the boxes by star.
    """
    taken = [np.concatenate([star - 5, star + 5]) for star in stars]
    covered, far, boxes = 0.0, 0.0, {}
    for i in order:
        others = taken[:i] + taken[i + 1:]
        found = places(stars[i], sizes[i])
        costs = [
            overlap(place, taken) + outside(place, frame)
            + sum(overlap(step, others) for step in leader(stars[i], place))
            for place in found
        ]
        best = found[int(np.argmin(costs))]
        covered += min(costs)
        far += float(np.hypot(*(np.clip(stars[i], best[:2], best[2:]) - stars[i])))
        boxes[int(i)] = best
        taken += [best, *leader(stars[i], best)]
    return covered, far, boxes


def put_labels(
    axes: plt.Axes, labels: list[Marker], xy: np.ndarray, border: np.ndarray, size_pt: float
) -> float:
    """Write the labels of stars at (n, 2) within a border (m, 2), where they cover least.

    Returns the area that still overlaps or lies outside, px^2.
    """
    stars, corners = axes.transData.transform(xy), axes.transData.transform(border)
    frame = np.concatenate([corners.min(axis=0) + 4, corners.max(axis=0) - 4])
    texts = [
        axes.text(
            *place, label.text, color=colour(label), fontsize=size_pt, ha="center", va="center"
        )
        for place, label in zip(xy, labels, strict=True)
    ]
    extents = [text.get_window_extent() for text in texts]
    sizes = np.array([(extent.width + 3, extent.height + 2) for extent in extents])
    # Who comes first has the choice: the best of some orders is good enough.
    rng = np.random.default_rng(SEED)
    covered, _, boxes = min(
        (arranged(rng.permutation(len(stars)), stars, sizes, frame) for _ in range(ORDERS)),
        key=lambda arrangement: arrangement[:2],
    )
    to_data = axes.transData.inverted().transform
    for i, box in boxes.items():
        texts[i].set_position(to_data((box[:2] + box[2:]) / 2))
        ends = to_data([stars[i], np.clip(stars[i], box[:2], box[2:])])
        axes.plot(*ends.T, color=colour(labels[i]), linewidth=0.5, alpha=0.6, zorder=1)
    return covered


def draw_grid(axes: plt.Axes, sky: Sky, half_deg: float) -> None:
    """Draw parallels and meridians every few degrees."""
    x = np.linspace(0, 2 * np.pi, 721)
    for dec in np.radians(np.arange(-85, 90, GRID_STEP_DEG)):
        ring = np.column_stack([
            np.cos(dec) * np.cos(x), np.cos(dec) * np.sin(x), np.full_like(x, np.sin(dec))
        ])
        _line(axes, sky, ring, half_deg)
    y = np.radians(np.linspace(-85, 85, 341))
    for ra in np.radians(np.arange(0, 360, GRID_STEP_DEG)):
        arc = np.column_stack([np.cos(y) * np.cos(ra), np.cos(y) * np.sin(ra), np.sin(y)])
        _line(axes, sky, arc, half_deg)


def _line(axes: plt.Axes, sky: Sky, vectors: np.ndarray, half_deg: float) -> None:
    near = vectors[vectors @ sky._boresight > np.cos(np.radians(3 * half_deg))]  # noqa: SLF001
    if len(near) > 1:
        axes.plot(*sky.flat(near).T, color=GRID, linewidth=0.7, zorder=0)


def main() -> int:
    """Draw the picture; return 1 if labels overlap in it."""
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
    attitude = solution.attitude
    sky = Sky(attitude.rotation[:, 2])

    (stars,), (outline,) = by["stars"], by["field_of_view"]
    border, xy = sky.flat(array(outline.points)), sky.flat(array(stars.points))
    half = 1.08 * float(np.abs(border).max())
    figure, axes = plt.subplots(figsize=(SIZE_IN, SIZE_IN), dpi=DPI)
    figure.patch.set_facecolor(BACKGROUND)
    axes.set(position=(0, 0, 1, 1), xlim=(-half, half), ylim=(-half, half), aspect="equal")
    axes.axis("off")
    draw_grid(axes, sky, half)
    axes.plot(*border.T, color=colour(outline), linewidth=1.5)
    axes.scatter(*xy.T, s=14, color=[colour(stars)], edgecolor="none", zorder=3)
    names = sky.flat(array([label.pose.position for label in by["labels"]]))
    covered = put_labels(axes, by["labels"], names, border, 8.0)
    axes.text(
        0.5, 0.012,
        f"{star_map.name}: {len(xy)} stars identified; RA {np.degrees(attitude.ra_rad):.2f}, "
        f"Dec {np.degrees(attitude.dec_rad):+.2f}, roll {np.degrees(attitude.roll_rad):.2f} deg; "
        f"north up, east left, grid {GRID_STEP_DEG:g} deg",
        transform=axes.transAxes, color="0.75", fontsize=7.5, ha="center",
    )
    path = ROOT / "docs" / "markers.png"
    figure.savefig(path, facecolor=BACKGROUND, metadata={"Software": None})
    print(f"{path.relative_to(ROOT)}: {len(by['labels'])} labels, {covered:.0f} px^2 overlap, "
          f"{path.stat().st_size / 1e3:.0f} kB")
    return int(covered > 0)


if __name__ == "__main__":
    sys.exit(main())
