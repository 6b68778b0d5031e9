"""The project's pictures: the eight maps, guide-star pairs by separation, all-sky maps.

`make figures` writes docs/maps/map1.png to map8.png, docs/pairs_per_separation.png,
docs/all_sky_12deg.png and docs/all_sky_20deg.png, and prints a summary of the last two. It needs
matplotlib.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

from star_tracker.commands import cli
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.maps.simulation import CAMERAS, Condition
from star_tracker.figures.pair_histogram import draw_pairs
from star_tracker.figures.sky_map import Survey, draw_sky_map
from star_tracker.study.sky_survey import survey
from star_tracker.figures.style import house_style, save
from star_tracker.catalogue.pairs import PairTable
from star_tracker.maps.star_map import PAPER_MAPS
from star_tracker.tracker import StarTracker

DPI = 110
#: The paper's figure 5-2 goes so far.
FARTHEST_PAIR_DEG = 17.0
SEED = 2019
#: Hard enough that some fields are not solved.
CONDITIONS = {
    "12 deg": Condition("0.5 px of noise, 60 % of the stars missing", 0.5, 0.6),
    "20 deg": Condition("0.5 px of noise, 80 % of the stars missing", 0.5, 0.8),
}


def draw_maps(folder: Path) -> None:
    """Draw the eight maps as a user would."""
    folder.mkdir(exist_ok=True)
    for number in PAPER_MAPS:
        output = folder / f"map{number}.png"
        if cli.main(["plot", str(number), "--output", str(output), "--dpi", str(DPI)]) != 0:
            raise SystemExit(f"map {number} was not drawn")


def draw_pair_histogram(path: Path) -> None:
    """Draw the pairs of the paper's catalogue."""
    catalog = StarCatalog.paper()
    pairs = PairTable.build(catalog, float(np.radians(FARTHEST_PAIR_DEG)))
    save(draw_pairs(pairs, len(catalog)), path, DPI)


def draw_all_sky(options: argparse.Namespace, docs: Path) -> None:
    """Survey the sky with both cameras, draw the maps and print a summary."""
    database = FeatureDatabase.cached(StarCatalog.paper())
    print("| camera | frames | guide stars, least / median | four shown % | right % | wrong |")
    print("|---|---|---|---|---|---|")
    for name, camera in CAMERAS.items():
        condition = CONDITIONS[name]
        found = survey(
            StarTracker(database, camera), condition, options.fields, options.frames, SEED
        )
        title = (
            f"{name}, {camera.width_px} × {camera.height_px} px: {options.fields} fields, "
            f"{options.frames} frames each at random rolls; dashed: galactic equator\n"
            f"{condition.name}: {found.rate_percent.mean():.1f} % solved rightly, "
            f"{found.wrong.sum()} of {found.right.size * found.frames} wrongly"
        )
        print(summary(name, found))
        save(draw_sky_map(found, title), docs / f"all_sky_{name.replace(' ', '')}.png", DPI)


def summary(name: str, found: Survey) -> str:
    """Return a row of the table."""
    n = found.right.size * found.frames
    cells = [
        name, n, f"{found.guide_stars.min():.1f} / {np.median(found.guide_stars):.1f}",
        f"{100 * found.possible.sum() / n:.2f}", f"{found.rate_percent.mean():.2f}",
        found.wrong.sum(),
    ]
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def main() -> int:
    """Draw everything."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fields", type=int, default=2500, help="fields of an all-sky map (2500)")
    parser.add_argument("--frames", type=int, default=10, help="frames a field (10)")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs", help="where to write (docs/)")
    options = parser.parse_args()
    with house_style():
        draw_maps(options.docs / "maps")
        draw_pair_histogram(options.docs / "pairs_per_separation.png")
        draw_all_sky(options, options.docs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
