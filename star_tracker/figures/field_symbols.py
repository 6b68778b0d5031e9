"""The symbols of a frame's stars: what they look like, where they lie and how they are drawn.

guide star in view      grey disc, larger = brighter    missing: an open one
identified centroid     ring around a dot               residual: an exaggerated arrow
displaced centroid      diamond, with an arrow from where the star should be
unidentified centroid   cross
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from star_tracker.figures.field_view import FieldView
from star_tracker.figures.style import BLUE, VERMILION, Looks
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import StarState

#: How a symbol is drawn: arguments of `Axes.plot`, sizes in points.
GUIDE: Looks = {
    "marker": "o", "markerfacecolor": "0.75", "markeredgecolor": "0.45", "linestyle": "",
}
MISSING: Looks = {**GUIDE, "markerfacecolor": "white", "markeredgecolor": "0.1"}
BORESIGHT: Looks = {"marker": "+", "color": "0.4", "markersize": 9.0, "linestyle": ""}
_DOT: Looks = {"marker": ".", "color": "black", "markersize": 3.0, "linestyle": ""}
CENTROIDS: dict[StarState, Looks] = {
    StarState.IDENTIFIED: {
        "marker": "o", "markerfacecolor": "none", "markeredgecolor": BLUE, "markeredgewidth": 1.3,
        "markersize": 12.0, "linestyle": "",
    },
    StarState.DISPLACED: {
        "marker": "D", "markerfacecolor": "none", "markeredgecolor": VERMILION,
        "markeredgewidth": 1.5, "markersize": 10.0, "linestyle": "",
    },
    StarState.UNIDENTIFIED: {
        "marker": "x", "color": "black", "markeredgewidth": 1.4, "markersize": 6.0,
        "linestyle": "",
    },
}
#: Half the size of the box that a symbol takes, points, by state; that of a point of an arrow.
_REACH_PT, _ARROW_PT = np.array([4.0, 7.0, 8.0]), 1.5
#: The largest residual is drawn about this long, in widths of the image.
_LONGEST = 0.07
#: More stars than this are drawn smaller, but not below a share of the size.
_CROWD, _SMALLEST = 50, 0.55
_SMALLEST_PT, _LARGEST_PT, _PT_PER_MAGNITUDE = 2.6, 10.0, 1.5


@dataclass(frozen=True)
class Symbols:
    """The symbols of one frame.

    Attributes:
        view: the frame.
        residual_scale: how many times too long residuals are drawn; 0 = none are.
        size: of the symbols, 1 = that of a field that is not crowded.
    """

    view: FieldView
    residual_scale: float
    size: float

    @classmethod
    def of(cls, view: FieldView) -> "Symbols":
        """Choose the scale of the residuals and the size of the symbols."""
        _, residuals = view.arrows(StarState.IDENTIFIED)
        largest = float(np.max(np.hypot(*residuals.T), initial=0.0))
        scale = 0.0
        if largest > 0:
            scale = max(1.0, round_down(_LONGEST * view.camera.width_px / largest))
        crowd = len(view.drawn) + int(view.missing.sum())
        return cls(view, scale, float(np.clip(np.sqrt(_CROWD / max(crowd, 1)), _SMALLEST, 1.0)))

    def scaled(self, looks: Looks) -> Looks:
        """Return how a symbol is drawn in a picture as crowded as this."""
        return {**looks, "markersize": looks["markersize"] * self.size}

    def disc_pt(self, v_mag: Floats) -> Floats:
        """Return the diameters (k,) of discs for magnitudes (k,)."""
        faintest = float(np.max(self.view.catalog.v_mag))
        size = _SMALLEST_PT + _PT_PER_MAGNITUDE * (faintest - v_mag)
        return np.asarray(np.clip(size, _SMALLEST_PT, _LARGEST_PT) * self.size)

    def reach_pt(self, centroids: NDArray[np.intp]) -> Floats:
        """Return how far the symbols of some centroids (k,) reach, points."""
        state = self.view.solution.identification.state[centroids]
        return np.asarray(_REACH_PT[state] * self.size)

    def draw(self, axes: Axes) -> None:
        """Draw all stars."""
        view = self.view
        axes.plot(view.optics.cx_px, view.optics.cy_px, zorder=1.5, **BORESIGHT)
        index, places = view.guide_stars
        sizes = self.disc_pt(view.catalog.v_mag[index])
        for place, size, missing in zip(places, sizes, view.missing, strict=True):
            looks = MISSING if missing else GUIDE
            axes.plot(*place, markersize=size, zorder=2, clip_on=False, **looks)
        for state, looks in CENTROIDS.items():
            which = np.intersect1d(view.of_state(state), view.drawn)
            axes.plot(*view.xy_px[which].T, zorder=3, clip_on=False, **self.scaled(looks))
        named = view.xy_px[view.solution.identification.state > 0]
        axes.plot(*named.T, zorder=4, clip_on=False, **self.scaled(_DOT))
        for start, step in zip(*view.arrows(StarState.DISPLACED), strict=True):
            axes.annotate(
                "", start + step, start, zorder=5, annotation_clip=False,
                arrowprops={
                    "arrowstyle": "-|>", "color": VERMILION, "shrinkA": 0, "shrinkB": 0,
                    "mutation_scale": 6, "linewidth": 1.2,
                },
            )
        if self.residual_scale > 0:
            start, step = view.arrows(StarState.IDENTIFIED)
            axes.quiver(
                *start.T, *(step * self.residual_scale).T, angles="xy", scale_units="xy", scale=1,
                units="inches", width=0.016, headwidth=4, headlength=5, headaxislength=4.5,
                minlength=0, minshaft=1, color="black", zorder=5, clip_on=False,
            )

    def boxes(self, axes: Axes) -> Floats:
        """Return the boxes (k, 4) of all symbols in display units, for labels to keep clear of."""
        view = self.view
        index, places = view.guide_stars
        arrows = np.concatenate([
            _along(*view.arrows(StarState.DISPLACED)),
            _along(*view.arrows(StarState.IDENTIFIED), self.residual_scale),
        ])
        at = axes.transData.transform(np.concatenate([view.xy_px[view.drawn], places, arrows]))
        half_pt = np.concatenate([
            self.reach_pt(view.drawn), self.disc_pt(view.catalog.v_mag[index]) / 2,
            np.full(len(arrows), _ARROW_PT),
        ])
        half = half_pt[:, None] * axes.figure.dpi / 72
        return np.hstack([at - half, at + half])


def round_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a number > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(digit for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-9)) * power)


def _along(start: Floats, step: Floats, scale: float = 1.0) -> Floats:
    """Return points (k, 2) along arrows from `start` (m, 2) by `step` (m, 2) times a scale."""
    share = np.linspace(0, scale, 7)[:, None, None]
    return np.asarray((start + share * step).reshape(-1, 2))
