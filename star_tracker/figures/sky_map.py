"""Maps of the whole sky: where fields are solved, and how many guide stars they have."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from star_tracker.figures.sky_grid import degrees_text
from star_tracker.figures.style import HALO, SEQUENTIAL, new_figure
from star_tracker.geometry.spherical import Floats, ra_dec, tangent_basis, unit_vectors

#: North galactic pole, ICRS (ESA SP-1200, volume 1, 1.5.3).
_GALACTIC_POLE_DEG = (192.85948, 27.12825)
#: Cells of the map along right ascension and declination.
_CELLS = 480, 240
_RA_LABELS_DEG = (60, 120, 180, 240, 300)
_DEC_LABELS_DEG = (-60, -30, 0, 30, 60)


@dataclass(frozen=True)
class Survey:
    """What became of the frames of fields all over the sky.

    Attributes:
        boresights: (n, 3) unit vectors, ICRS.
        frames: how many frames, at random rolls, each field was given.
        guide_stars: (n,) mean number of guide stars in the image.
        possible: (n,) frames that showed enough stars, four, to be solved at all.
        right: (n,) frames whose attitude was found.
        wrong: (n,) frames that were solved with a wrong attitude.
    """

    boresights: Floats
    frames: int
    guide_stars: Floats
    possible: NDArray[np.int64]
    right: NDArray[np.int64]
    wrong: NDArray[np.int64]

    @property
    def rate_percent(self) -> Floats:
        """Share of frames (n,) whose attitude was found."""
        return np.asarray(100.0 * self.right / self.frames)


def draw_sky_map(found: Survey, title: str) -> Figure:
    """Return a figure of two maps: percent of the frames solved rightly, and guide stars.

    Mollweide's projection, in which equal areas of the sky have equal areas; right ascension
    grows to the left, as seen from inside. Each field stands for the sky that is nearest to it.
    """
    figure = new_figure(6.6, 6.7)
    figure.text(0.02, 0.985, title, va="top", fontsize=9, linespacing=1.4)
    lowest = float(np.floor(found.rate_percent.min() / 10) * 10)
    _draw(figure, (0.06, 0.48, 0.78, 0.45), found, found.rate_percent,
          ("frames solved rightly, %", min(lowest, 90.0), 100.0))
    _draw(figure, (0.06, 0.01, 0.78, 0.45), found, found.guide_stars,
          ("guide stars in the field", 0.0, float(found.guide_stars.max())))
    return figure


def _draw(
    figure: Figure, place: tuple[float, float, float, float], found: Survey, values: Floats,
    scale: tuple[str, float, float],
) -> None:
    """Draw one map with its scale: name, lowest and highest value."""
    name, lowest, highest = scale
    axes = figure.add_axes(place, projection="mollweide")
    # The map's own longitude is 0 in the middle and grows to the right.
    across, up = np.linspace(-np.pi, np.pi, _CELLS[0] + 1), np.linspace(-0.5, 0.5, _CELLS[1] + 1)
    middle = (across[1:] + across[:-1]) / 2, (up[1:] + up[:-1]) / 2 * np.pi
    longitude, latitude = np.meshgrid(*middle)
    nearest = cKDTree(found.boresights).query(unit_vectors(np.pi - longitude, latitude))[1]
    image = axes.pcolormesh(
        across, up * np.pi, values[nearest], cmap=SEQUENTIAL, vmin=lowest, vmax=highest,
        rasterized=True,
    )
    for color, width in (("white", 2.2), ("black", 0.9)):
        axes.plot(*_galactic_equator(), color=color, linewidth=width, linestyle=(0, (5, 3)))
    axes.set_xticks([np.pi - np.radians(ra) for ra in _RA_LABELS_DEG])
    axes.set_xticklabels([f"{ra}°" for ra in _RA_LABELS_DEG], fontsize=7, path_effects=HALO)
    axes.set_yticks(np.radians(_DEC_LABELS_DEG))
    axes.set_yticklabels([degrees_text(dec, 0, "+") for dec in _DEC_LABELS_DEG], fontsize=7)
    axes.grid(visible=True, color="0.6", linewidth=0.4)
    bar = figure.add_axes((place[0] + place[2] + 0.03, place[1] + 0.06, 0.02, place[3] - 0.12))
    figure.colorbar(image, cax=bar, label=name)


def _galactic_equator() -> tuple[Floats, Floats]:
    """Return longitude and latitude (k,) of the map along the Milky Way, NaN at its border."""
    pole = unit_vectors(*np.radians(_GALACTIC_POLE_DEG))
    east, north = tangent_basis(pole)
    angle = np.linspace(0, 2 * np.pi, 721)[:, None]
    ra, dec = ra_dec(np.cos(angle) * east + np.sin(angle) * north)
    longitude = np.pi - ra
    longitude[1:][np.abs(np.diff(longitude)) > np.pi] = np.nan
    return longitude, dec
