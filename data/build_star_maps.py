"""Compute the eight star maps of the paper: `python data/build_star_maps.py [--output FOLDER]`.

Each map is a pinhole projection of catalogue stars at a known pose, rounded to 0.01 px. Which star
carries which label is the paper's result (tables 5-1 to 5-8); the poses, and the shifts of the
displaced stars, were recovered from it.
"""

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from star_tracker.optics.camera import Camera
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.resources import resource_path
from star_tracker.maps.star_map import Pose, StarMap, write_star_map


@dataclass(frozen=True)
class Recipe:
    """How a map is made. Its X axis points cos(theta) north + sin(theta) east."""

    letter: str
    camera: Camera
    ra_deg: float
    dec_deg: float
    theta_deg: float
    star_numbers: tuple[int, ...]
    displaced_px: dict[str, tuple[float, float]] = field(default_factory=dict)


# The maps' Y axis points up, so their parity is mirrored.
FOV12 = Camera.from_fov(12, 512, 512, parity="mirrored")
FOV20 = Camera.from_fov(20, 1024, 1024, parity="mirrored")
# fmt: off
RECIPES = (
    Recipe("A", FOV12, 109.6, 34.5, 0, (
        1670, 1477, 1502, 1631, 1603, 1453, 1432, 1492, 1488, 1648, 1646, 1566, 1688,
        1655, 1505,
    )),
    Recipe("B", FOV12, 43, 18, -60, (
        518, 472, 537, 428, 491, 469, 482, 503, 478, 499, 547, 460, 507, 556, 447, 479,
    )),
    Recipe("C", FOV12, 125, 44, 0, (
        1864, 1942, 1825, 1941, 1943, 1900, 1722,
    ), {"C02": (0, 3), "C04": (3, 0), "C06": (0, 2)}),
    Recipe("D", FOV12, 243, -28, 0, (
        3249, 3346, 3364, 3275, 3421, 3319, 3283, 3370, 3265, 3261, 3321, 3309,
    )),
    Recipe("E", FOV12, 86.5836, 44.4766, -0.012, (
        1230, 1150, 1017, 1033, 1014, 1223, 1008, 1208, 1201,
    )),
    Recipe("F", FOV12, 112.6, 34.5, 0, (
        1670, 1477, 1502, 1631, 1603, 1692, 1492, 1488, 1646, 1566, 1655, 1505,
    ), {"F02": (2, 4), "F05": (5, 20), "F08": (-30, 20)}),
    Recipe("G", FOV20, 112.6, 34.5, 0, (
        1525, 1572, 1443, 1748, 1780, 1675, 1720, 1503, 1634, 1577, 1757, 1586, 1536,
        1610, 1681, 1606, 1670, 1477, 1790, 1502, 1631, 1603, 1415, 1692, 1453, 1432,
        1492, 1488, 1648, 1646, 1566, 1688, 1655, 1505, 1373, 1576, 1545, 1424, 1375,
        1825, 1401,
    )),
    Recipe("H", FOV20, 106, 35, 0, (
        1572, 1387, 1675, 1634, 1586, 1610, 1354, 1681, 1606, 1670, 1390, 1502, 1631,
        1603, 1692, 1432, 1488, 1648, 1646, 1566, 1688, 1359, 1505, 1373, 1576, 1424,
        1375, 1401, 1385,
    )),
)
# fmt: on


def build(number: int, recipe: Recipe, catalog: StarCatalog) -> StarMap:
    """Project the stars of one map."""
    index = {int(star): i for i, star in enumerate(catalog.number)}
    stars = [index[star] for star in recipe.star_numbers]
    labels = tuple(f"{recipe.letter}{i:02d}" for i in range(1, len(stars) + 1))
    shift = np.array([recipe.displaced_px.get(label, (0.0, 0.0)) for label in labels])
    # The image's up direction is the maps' Y axis, -sin(theta) north + cos(theta) east.
    pose = Pose(recipe.ra_deg, recipe.dec_deg, 90 + recipe.theta_deg)
    xy = recipe.camera.pixels(catalog.vectors[stars] @ pose.rotation) + shift
    return StarMap(
        f"map {number}", recipe.camera, labels, xy, np.array(recipe.star_numbers),
        np.hypot(shift[:, 0], shift[:, 1]), pose,
    )


def main() -> None:
    """Write map1.csv to map8.csv."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=Path, default=resource_path("data") / "star_maps")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    catalog = StarCatalog.paper()
    for number, recipe in enumerate(RECIPES, start=1):
        write_star_map(build(number, recipe, catalog), folder / f"map{number}.csv")


if __name__ == "__main__":
    main()
