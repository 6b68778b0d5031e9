"""How many guide-star pairs there are at each separation (paper, figure 5-2)."""

import numpy as np
from matplotlib.figure import Figure

from star_tracker.catalogue.database import DEFAULT_MAX_SEPARATION_DEG
from star_tracker.catalogue.pairs import PairTable
from star_tracker.figures.style import BLUE, new_figure
from star_tracker.geometry.spherical import Floats

#: As the paper has it.
BIN_DEG = 0.01


def pairs_per_bin(pairs: PairTable) -> tuple[Floats, Floats]:
    """Return the edges (bins + 1,), degrees, and the number of undirected pairs (bins,)."""
    bins = round(float(np.degrees(pairs.max_separation_rad)) / BIN_DEG)
    edges = np.linspace(0.0, bins * BIN_DEG, bins + 1)
    # Each pair is stored in both directions.
    directed, _ = np.histogram(np.degrees(pairs.separation_rad.astype(float)), edges)
    return edges, directed / 2


def draw_pairs(pairs: PairTable, n_stars: int) -> Figure:
    """Return a figure of the pairs per bin, and of what as many stars at random would have."""
    edges, counts = pairs_per_bin(pairs)
    figure = new_figure(6.2, 3.9)
    axes = figure.add_axes((0.1, 0.12, 0.87, 0.78))
    axes.stairs(counts, edges, color="0.55", linewidth=0.6, label=f"pairs in {BIN_DEG:g}°")
    middle = (edges[1:] + edges[:-1]) / 2
    uniform = n_stars * (n_stars - 1) / 4 * np.sin(np.radians(middle)) * np.radians(BIN_DEG)
    axes.plot(middle, uniform, color=BLUE, linewidth=1.5, label="if the stars lay at random")
    top = float(counts.max()) * 1.04
    for limit in (DEFAULT_MAX_SEPARATION_DEG, float(edges[-1])):
        n = int(counts[edges[1:] <= limit + BIN_DEG / 2].sum())
        axes.axvline(limit, color="black", linewidth=0.9, linestyle="--")
        axes.annotate(
            f"{n:,} pairs\nup to {limit:g}°", (limit, top * 0.02), (-4, 0), ha="right",
            va="bottom", textcoords="offset points", fontsize=8,
        )
    axes.set_xlim(0, edges[-1])
    axes.set_ylim(0, top)
    axes.set_xlabel("separation, deg")
    axes.set_ylabel(f"guide-star pairs in a bin of {BIN_DEG:g}°")
    axes.set_title(f"Pairs of the {n_stars} guide stars (paper, figure 5-2)", loc="left")
    axes.legend(loc="upper left", frameon=False)
    return figure
